"""The console's page in a browser, fed with what no node of ours would tell: `make test-browser`."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import pytest
from browser import PHONE
from console_page import ConsolePage, opened

from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.page import page_of_console
from flatsat_ros.viewing.server import Broadcast, ConsoleServer

EVIL = "<img src=x onerror=document.title=1>"
SETUPS: tuple[dict[str, Any], ...] = (
    {},
    {"certificate": EVIL, "period": "x", "box": 3, "floor": None, "mu": "x", "nu": [1], "tube_m": EVIL},
    {"certificate": ["<b>"], "period": 0, "box": ["a", None], "v_inf": -1.0, "gamma_max": 1e300, "gain_max": None},
)
ROWS: tuple[list[float | None], ...] = ([], [None] * len(FIELDS), [1e300] * len(FIELDS), [-1.5] * len(FIELDS))


class Teller:
    """Tells pages whatever it is given, and refuses what they ask for."""

    def __init__(self) -> None:
        self.stream = Broadcast(lambda _: None)
        self.server = ConsoleServer(0, page_of_console(), self.stream, self._refuse)
        self.server.serve()
        self._line, self._began = 0, 0.0

    def _refuse(self, wanted: dict[str, Any]) -> Future[str]:
        answer: Future[str] = Future()
        answer.set_exception(ValueError(f"{EVIL} {wanted}"))
        return answer

    def begin_again(self) -> None:
        """Be a console that has just started, on the same port."""
        self._line, self._began = 0, self._began + 1.0

    def tell(self, names: list[str], setup: dict[str, Any], row: list[float | None]) -> None:
        """Show drones."""
        self._line += 1
        drones = [
            {
                "name": name,
                "pose": {
                    "age": 0.01,
                    "stamp": 0.0,
                    "values": [0.1 * k, None if k == 3 else 1e30 if k == 4 else 0.2 * k, 1.0, 0, 0, 0, 0],
                },
                "flatsat/telemetry".rpartition("/")[2]: {"age": 0.01, "values": row},
                "battery": {"age": 0.5, "values": [None]},
                "link": {"age": 0.5, "severity": 2, "text": EVIL},
            }
            for k, name in enumerate(names)
        ]
        lines = {"began": self._began, "lines": [{"number": self._line, "level": 40, "text": EVIL}]}
        picture = {"time": time.time(), "setup": setup, "drones": drones, **lines}
        self.stream.publish(json.dumps(picture).encode())


@contextmanager
def told(size: tuple[int, int]) -> Iterator[tuple[Teller, ConsolePage]]:
    teller = Teller()
    try:
        with opened(teller.server.address, size) as page:
            yield teller, page
    finally:
        teller.server.close()


@pytest.mark.parametrize("size", [(1280, 900), PHONE])
def test_whatever_is_told_the_page_stays_usable(size: tuple[int, int]) -> None:
    names = [f"{EVIL}{number}" if number < 3 else f"cf{number}" for number in range(50)]
    names[3:5] = ["x" * 120, "crazyflie_" * 12]  # no place to break
    with told(size) as (teller, console_page):
        page = console_page.page
        for setup in SETUPS:
            for row in ROWS:
                for _ in range(3):
                    teller.tell(names, setup, row)
                    time.sleep(0.05)
        page.wait(lambda: len(console_page.modes()) == 50, "fifty drones")
        assert page.driver.find_elements("css selector", "img") == []
        assert page.driver.title.startswith("Console")
        assert page.text("#log li") == EVIL
        console_page.press(1, "land")
        console_page.await_words(EVIL)
        assert page.run("return console_.view.camera.position.length()") < 100.0
        assert page.run("return document.documentElement.scrollWidth") <= size[0]
        teller.tell(names[::-1], {}, [])
        page.wait(lambda: page.text(".card h3") != "", "other drones")
        assert page.run("return document.querySelectorAll('#scene canvas').length") == 1
        page.screenshot(f"console_fifty_{size[0]}")
        page.require_sound()


def test_many_changes_of_the_drones_leave_one_scene_that_is_drawn() -> None:
    with told((1280, 900)) as (teller, console_page):
        page = console_page.page
        for number in range(24):  # browsers take the graphics away from the oldest of sixteen
            teller.tell([f"cf{number}"], {}, [])
            page.wait(lambda n=number: page.run("return console_.flight?.drones[0].name") == f"cf{n}", "the next drone")
        assert page.run("return console_.view.renderer.getContext().isContextLost()") is False
        page.require_sound()


def test_a_console_that_starts_again_finds_the_page_as_it_was() -> None:
    with told((1280, 900)) as (teller, console_page):
        page = console_page.page
        flying = [0.0] * len(FIELDS)
        flying[FIELDS.index("mode")] = 2.0
        setup = {"certificate": "mine", "period": 0.02}
        teller.tell(["cf1"], setup, flying)
        console_page.await_modes("FLY")
        page.run("console_.view.isTheSame = true")
        logged = page.run("return document.querySelectorAll('#log li').length")
        teller.begin_again()
        # it has not heard from the controller yet: to build the page again would take longer than that does
        teller.tell([], {}, [])
        page.wait(lambda: "no controller" in page.text("#subtitle"), "that no controller is heard")
        assert len(console_page.modes()) == 1
        teller.tell(["cf1"], setup, flying)
        page.wait(lambda: "mine" in page.text("#subtitle"), "the controller")
        console_page.await_modes("FLY")
        assert page.run("return console_.view.isTheSame") is True
        assert page.run("return document.querySelectorAll('#log li').length") == logged + 2
        page.require_sound()


def test_a_key_that_is_held_down_asks_once() -> None:
    with told((1280, 900)) as (_, console_page):
        page = console_page.page
        for key in (" ", "Escape"):
            before = page.run("return console_.sent")
            for repeat in ("false", "true", "true"):
                how = f"{{key: '{key}', repeat: {repeat}, bubbles: true}}"
                page.run(f"document.body.dispatchEvent(new KeyboardEvent('keydown', {how}))")
            assert page.run("return console_.sent") == before + 1
