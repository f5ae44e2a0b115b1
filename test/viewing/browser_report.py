"""The page of a recorded flight as a person uses it: `make test-browser`."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import DESKTOP, PHONE, Page, browser
from selenium.webdriver.common.keys import Keys

from flatsat_ros.cli.demo import main
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.flight import POSE_FIELDS, Channel, Flight, LoggedEvent, Track
from flatsat_ros.viewing.page import report

WIDTHS = {"desktop": DESKTOP, "phone": PHONE}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a swap on simulated time."""
    folder = tmp_path_factory.mktemp("demo")
    assert main(["--headless", "--seconds", "4", "--output", str(folder)]) == 0
    return folder / "report.html"


def ready(page: Page) -> None:
    page.wait(lambda: page.run("return document.body.dataset.ready") == "yes", "the flight in the page")


def now(page: Page) -> float:
    return float(page.run("return report.time"))


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_is_whole_readable_and_fits(flown: Path, width: str, theme: str) -> None:
    with browser(f"{flown.as_uri()}#9", WIDTHS[width]) as page:
        ready(page)
        if theme == "dark":
            page.find("#theme").click()
        assert page.text("#title") == "Swap on simulated time"
        assert now(page) == 9.0
        assert page.run("return document.documentElement.scrollWidth") <= WIDTHS[width][0]
        assert len(page.driver.find_elements("css selector", ".plot canvas")) >= 10
        page.screenshot(f"report_{width}_{theme}")
        page.require_sound()


def test_curves_of_any_size_have_two_numbers_beside_them_that_tell_their_scale(flown: Path) -> None:
    with browser(flown.as_uri()) as page:
        ready(page)
        for size in np.geomspace(0.01, 1000.0, 41):
            numbers = page.run(
                f"return report.plots.plots.map((plot) => {{ plot.setData([[0, 1], [-{size}, {size}], [0, 0], [0, 0]]);"
                " return plot.axes[1]._values.length })"
            )
            assert min(numbers) >= 2, size


def test_a_battery_that_is_told_once_a_second_is_one_line(tmp_path: Path) -> None:
    times = np.arange(0.0, 20.0, 1.0)
    poses = np.column_stack([times, np.zeros((times.size, 6)), np.ones(times.size)])
    channels = {
        "pose": Channel(POSE_FIELDS, poses),
        "battery": Channel(("voltage",), np.column_stack([times, np.full(times.size, 4.0)])),
    }
    file = tmp_path / "battery.html"
    file.write_text(report(Flight("battery", [Track("cf1", channels)], [], {}, [])), encoding="utf-8")
    with browser(file.as_uri()) as page:
        ready(page)
        drawn = page.run(
            "const k = report.plots.quantities.findIndex((one) => one.title === 'Battery');"
            " return report.plots.plots[k].data[1]"
        )
        assert set(drawn) == {4.0}


def test_every_control_does_what_it_says(flown: Path) -> None:
    with browser(flown.as_uri()) as page:
        ready(page)
        page.find("#play").click()
        page.wait(lambda: now(page) > 0.3, "the flight to play")
        page.find("#play").click()
        stopped = now(page)
        page.find("#title").click()
        page.driver.switch_to.active_element.send_keys(Keys.ARROW_RIGHT)
        assert now(page) == pytest.approx(stopped + 0.1, abs=1e-6)
        page.driver.switch_to.active_element.send_keys(Keys.SPACE)
        page.wait(lambda: now(page) > stopped + 0.5, "the space bar to play")
        page.driver.switch_to.active_element.send_keys(Keys.SPACE)

        page.run("const s = document.getElementById('slider'); s.value = 8; s.dispatchEvent(new Event('input'))")
        assert now(page) == 8.0
        assert page.text("#clock") == "0:08.00"

        strip = page.find(".strips canvas")
        page.run("document.querySelector('.strips').scrollIntoView()")
        strip.click()
        end = float(page.run("return report.flight.end"))
        assert end / 3 < now(page) < 2 * end / 3

        for box in page.driver.find_elements("css selector", "#drones input")[1:]:
            box.click()
        assert page.run("return report.view.models.map((model) => model.group.visible)") == [True, False, False]

        for number, title in enumerate(("Figures", "Events", "Set-up", "Data")):
            tab = page.find(f"#tab{number}")
            assert tab.text.startswith(title)
            tab.click()
            assert page.find(f"#panel{number}").is_displayed()
        page.find("#tab1").click()
        page.find("#panel1 .events button").click()
        first = page.run("return report.flight.events[0].time")
        assert now(page) == pytest.approx(first)
        page.require_sound()


def test_the_page_shows_what_was_flown(flown: Path) -> None:
    with browser(flown.as_uri()) as page:
        ready(page)
        rows: list[dict[str, Any]] = page.run("return report.flight.figures.rows")
        shown = [row.text.split()[0] for row in page.driver.find_elements("css selector", "#panel0 tbody tr")]
        assert shown == [row["drone"] for row in rows] == ["cf1", "cf2", "cf3"]
        page.run("report.seek(9)")
        drawn = page.run("return report.view.models[0].body.position.toArray()")
        told = page.run("return report.flight.drones[0].poseAt(9).position")
        assert drawn == pytest.approx(told, abs=1e-6)


def test_the_data_are_saved_as_files_that_others_read(flown: Path, tmp_path: Path) -> None:
    with browser(flown.as_uri()) as page:
        ready(page)
        page.find("#tab3").click()
        buttons = page.driver.find_elements("css selector", "#panel3 button")
        names = [button.text for button in buttons]
        assert names == [
            f"{drone}_{kind}.csv" for drone in ("cf1", "cf2", "cf3") for kind in ("pose", "tick", "command")
        ]
        for kind, fields in (("pose", POSE_FIELDS), ("tick", FIELDS)):
            name = f"cf2_{kind}.csv"
            text = page.downloaded(buttons[names.index(name)].click, name, tmp_path)
            lines = list(csv.reader(io.StringIO(text)))
            assert lines[0] == ["time_s", *fields]
            rows = np.array([[float(cell or "nan") for cell in line] for line in lines[1:]])
            told = page.run(
                f"const c = report.flight.drones[1].channel('{kind}');"
                "return [c.times, ...c.columns].map((column) => Array.from(column))"
            )
            expected = np.array(told, dtype=float).T
            np.testing.assert_allclose(rows, expected, rtol=1e-6)
            assert max(len(cell) for line in lines[1:] for cell in line) <= 15  # nobody wants 0.10000000149011612


@pytest.mark.parametrize("width", WIDTHS)
def test_a_recording_that_cannot_be_true_is_shown_all_the_same(tmp_path: Path, width: str) -> None:
    times = np.arange(0.0, 10.0, 0.05)
    wild = np.resize([np.nan, np.inf, -1e30, 1e30, 0.5], (times.size, len(FIELDS)))
    tracks = []
    for number in range(50):
        place = np.column_stack([times, np.sin(times + number), 0.1 * number * np.ones((times.size, 2))])
        place[::7, 1:] = np.nan
        place[5, 1:] = 1e30
        turn = np.resize([0.0, np.nan, 0.0, 0.0], (times.size, 4))
        ticks = np.column_stack([times, wild])
        channels = {"pose": Channel(POSE_FIELDS, np.column_stack([place, turn])), "tick": Channel(FIELDS, ticks)}
        name = f"<img src=x onerror=document.title=1>{number}" if number else "crazyflie_" * 12
        tracks.append(Track(name, channels))
    setup = {
        f"robots.{tracks[0].name}.mu": 1.0,
        "box": "<b>",
        "floor": math.nan,
        "period": "x",
        "tube_m": [1],
        "gain_max": "</script>",
    }
    events = [
        LoggedEvent(1.0, "<i>", "error", "<script>document.title=1</script>" * 50),
        LoggedEvent(math.nan, "", "odd", ""),
    ]
    file = tmp_path / "wild.html"
    file.write_text(report(Flight("<b>wild</b>", tracks, events, setup, ["<b>"])), encoding="utf-8")
    with browser(f"{file.as_uri()}#5", WIDTHS[width]) as page:
        ready(page)
        assert page.text("#title") == "<b>wild</b>"
        assert page.driver.title == "<b>wild</b> \N{EN DASH} flight report"
        assert page.driver.find_elements("css selector", "img") == []
        for number in range(4):
            page.find(f"#tab{number}").click()
            assert page.run("return document.documentElement.scrollWidth") <= WIDTHS[width][0]
        page.find("#play").click()
        page.wait(lambda: now(page) > 5.2, "the flight to play")
        page.find("#play").click()
        assert page.run("return report.view.camera.position.length()") < 100.0
        page.find("#tab0").click()
        page.screenshot(f"report_wild_{width}")
        page.require_sound()


def test_without_network_nothing_is_asked_for(flown: Path) -> None:
    with browser(flown.as_uri()) as page:
        ready(page)
        asked = page.run("return performance.getEntriesByType('resource').map((entry) => entry.name)")
        assert [name for name in asked if not name.startswith(("data:", "blob:"))] == []
