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
PATIENCE = 20.0  # s


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
        return self.find(selector).text

    def run(self, script: str) -> Any:
        """Return what a script returns."""
        return self.driver.execute_script(script)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Wait until the condition holds."""
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f"not within {PATIENCE:g} s: {what}")
            time.sleep(0.05)

    def screenshot(self, name: str) -> None:
        """Keep what the page looks like, from its top, at the present width."""
        SCREENS.mkdir(parents=True, exist_ok=True)
        self.run("window.scrollTo(0, 0)")
        self.driver.save_screenshot(str(SCREENS / f"{name}.png"))

    def require_sound(self) -> None:
        """Fail on what the page complained about, and on what people who see, hear or move otherwise cannot use."""
        complaints = [entry for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        assert complaints == []
        violations = Axe().run(self.driver)["violations"]
        serious = [entry for entry in violations if entry["impact"] in ("serious", "critical")]
        found = [f"{entry['id']}: {node['html']}" for entry in serious for node in entry["nodes"]]
        assert not found, "\n".join(found)


@contextmanager
def browser(address: str, size: tuple[int, int] = DESKTOP) -> Iterator[Page]:
    """Open a page; without Chromium the test says what to install."""
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.fail("Chromium is missing: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    for option in ("headless=new", "no-sandbox", "use-gl=angle", "use-angle=swiftshader", "enable-unsafe-swiftshader"):
        options.add_argument(f"--{option}")
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
