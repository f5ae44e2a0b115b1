"""The page of the console in a browser: what is read off it, and how its controls are used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from browser import DESKTOP, Page, browser
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

if TYPE_CHECKING:
    from conftest import Lab, Process


def address_of(lab: Lab, console: Process) -> str:
    """Return what a console says is to be opened."""
    lab.wait(lambda: "http://" in console.output, "the address")
    return console.output.partition("open ")[2].split()[0]


class ConsolePage:
    """A page of the console."""

    def __init__(self, page: Page) -> None:
        self.page = page

    def modes(self) -> list[str]:
        """Modes of the drones on their cards."""
        found: list[str] = self.page.run(
            "return [...document.querySelectorAll('.card .mode')].map((mode) => mode.textContent)"
        )
        return found

    def await_modes(self, *modes: str) -> None:
        """Wait until the drones have these modes."""
        self.page.wait(lambda: self.modes() == list(modes), ", ".join(modes))

    def await_words(self, words: str) -> None:
        """Wait until the page says something of what was asked for."""
        self.page.wait(lambda: words in self.said(), words)

    def said(self) -> str:
        """What the page says of what was asked for."""
        return self.page.text("#said")

    def is_refused(self) -> bool:
        """Whether it is shown as refused."""
        return "refused" in str(self.page.find("#said").get_attribute("class"))

    def setup(self, name: str) -> Any:
        """A parameter as the controller told it."""
        return self.page.run(f"return console_.flight.setup['{name}']")

    def value(self, drone: int, field: str, kind: str = "tick") -> float:
        """The newest value of a drone's channel."""
        newest = f"console_.flight.drones[{drone}].channel('{kind}').at('{field}', console_.flight.end, 10)"
        return float(self.page.run(f"return Number({newest})"))

    def press(self, who: int | str, what: str) -> None:
        """Press a button of a drone's card, counted from 1, or of all; twice where one click must not be enough."""
        selector = f"#{what}-all" if who == "all" else f".card:nth-child({who}) [data-what={what}]"
        button = self.page.find(selector)
        wants_another = button.get_attribute("data-sure") is not None
        button.click()
        if wants_another:
            assert button.text == "Click again"
            button.click()
        assert button.text != "Click again"

    def choose_tuning(self, whose: str) -> None:
        """Choose whose tuning is shown and set."""
        self.page.run(
            f"const s = document.getElementById('whose'); s.value = '{whose}'; s.dispatchEvent(new Event('change'))"
        )

    def tune(self, name: str, value: str) -> None:
        """Type a value in the place of the one that is there."""
        self.page.find(f"#tune-{name}").send_keys(Keys.CONTROL, "a", Keys.NULL, value, Keys.TAB)

    def drag(self, name: str, share: float) -> None:
        """Drag a slider to a share of its width; again if the page moved away below the mouse."""
        before = self.page.run("return console_.sent")
        for _ in range(5):
            self._drag(name, share)
            if self.page.run("return console_.sent") != before:
                return
        pytest.fail(f"the slider of {name} sends nothing")

    def _drag(self, name: str, share: float) -> None:
        slider = self.page.find(f"label:has(#tune-{name}) input[type=range]")
        width = slider.size["width"]
        self.page.run(f"document.querySelector('#tune-{name}').scrollIntoView({{block: 'center'}})")
        chain = ActionChains(self.page.driver).move_to_element(slider).click_and_hold()
        chain.move_by_offset(round((share - 0.5) * width), 0).release().perform()

    def click_floor(self) -> None:
        """Click on the floor of the scene."""
        self.page.run("window.scrollTo(0, 0)")
        scene = self.page.find("#scene canvas")
        ActionChains(self.page.driver).move_to_element_with_offset(scene, -40, 60).click().perform()

    def key(self, key: str) -> None:
        """Press a key where nothing is typed."""
        self.page.find("h1").click()
        self.page.driver.switch_to.active_element.send_keys(key)


@contextmanager
def opened(address: str, size: tuple[int, int] = DESKTOP, *, flat: bool = False) -> Iterator[ConsolePage]:
    """Open a page of the console."""
    with browser(address, size, flat=flat) as page:
        yield ConsolePage(page)
