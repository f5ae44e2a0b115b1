"""Chromium without a window, for tests of pages; it draws three dimensions without a graphics card."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from axe_core_python.selenium import Axe
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

SCREENS = Path(__file__).resolve().parents[2] / "out" / "screens"
DESKTOP, PHONE = (1280, 900), (400, 860)
PATIENCE = 60.0  # s, of a busy machine


class Page:
    """A page in a browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def find(self, selector: str) -> WebElement:
        """Return the one element."""
        found: WebElement = self.driver.find_element(By.CSS_SELECTOR, selector)
        return found

    def text(self, selector: str) -> str:
        """Return the text of an element."""
        # in one step: between two of them the page may have built it anew
        script = "return document.querySelector(arguments[0]).innerText.trim()"
        return str(self.driver.execute_script(script, selector))

    def run(self, script: str) -> Any:
        """Return what a script returns."""
        return self.driver.execute_script(script)

    def downloaded(self, press: Callable[[], object], name: str, folder: Path) -> str:
        """Return the text of a file of this name that a press of a button saves."""
        behaviour = {"behavior": "allow", "downloadPath": str(folder)}
        self.driver.execute_cdp_cmd("Page.setDownloadBehavior", behaviour)
        press()
        self.wait((folder / name).exists, f"the file {name}")
        return (folder / name).read_text(encoding="utf-8")

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Wait until the condition holds."""
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                self.screenshot("failed")
                pytest.fail(f"not within {PATIENCE:g} s: {what}; see out/screens/failed.png")
            time.sleep(0.05)

    def screenshot(self, name: str) -> None:
        """Keep what the page looks like, from its top, at the present width."""
        SCREENS.mkdir(parents=True, exist_ok=True)
        self.run("window.scrollTo(0, 0)")
        self.driver.save_screenshot(str(SCREENS / f"{name}.png"))

    def require_sound(self, expected: str = "net::ERR_NOTHING") -> None:
        """Fail on what the page complained about unless expected, and on what some people could not see or use."""
        complaints = [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        assert [complaint for complaint in complaints if expected not in complaint] == []
        violations = Axe().run(self.driver)["violations"]
        serious = [entry for entry in violations if entry["impact"] in ("serious", "critical")]
        found = [f"{entry['id']}: {node['html']}" for entry in serious for node in entry["nodes"]]
        assert not found, "\n".join(found)


@contextmanager
def browser(address: str, size: tuple[int, int] = DESKTOP, *, flat: bool = False) -> Iterator[Page]:
    """Open a page; without Chromium the test says what to install; if flat, the browser has no three dimensions."""
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.fail("Chromium is missing: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    for option in ("headless=new", "no-sandbox", "use-gl=angle", "use-angle=swiftshader", "enable-unsafe-swiftshader"):
        options.add_argument(f"--{option}")
    if flat:
        options.add_argument("--disable-3d-apis")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        # a window of a desktop has a least width; what the page is told has not
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        driver.get(address)
        yield Page(driver)
    finally:
        driver.quit()
