"""The console's page while nodes and browsers come and go, and how late it is: `make test-browser`."""

from __future__ import annotations

import json
import signal
import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from browser import SCREENS
from console_page import address_of, opened

from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.viewing.bag import read_flight

if TYPE_CHECKING:
    from conftest import Lab

RIGHT_AGAIN = 1.0  # s, after the first message of a node that has come back


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def test_nodes_and_browsers_come_and_go(lab: Lab) -> None:
    port = free_port()
    console_node = lab.start("console", port=port)
    address = address_of(lab, console_node)

    with opened(address) as console, opened(address) as other:
        page = console.page
        # no controller
        page.wait(lambda: "no controller" in page.text("#subtitle"), "that there is no controller")
        console.press("all", "land")
        console.await_words("is its node running?")
        assert console.is_refused()

        lab.start("sim_drone", robot_names=["cf1"])
        controller = lab.fly("cf1")
        for one in (console, other):
            one.await_modes("IDLE")
        other.press(1, "takeoff")
        for one in (console, other):
            one.await_modes("FLY")

        # a browser is closed, the other is loaded again: both show the flight
        other.page.driver.close()
        page.driver.refresh()
        console.await_modes("FLY")

        # the console is killed in flight and comes back: the drone flies on, and the same page is right again
        console_node.send(signal.SIGKILL)
        console_node.wait()
        page.wait(lambda: "is the console running?" in page.text("#subtitle"), "that nothing is heard")
        assert console.page.text("#log")
        page.run(
            "window.first = null; const show = console_.show.bind(console_);"
            "console_.show = (picture) => {"
            " if (picture.setup.certificate) first ??= Date.now() / 1000; show(picture); }"
        )
        console_node = lab.start("console", port=port)
        address_of(lab, console_node)
        began = time.time()
        page.wait(
            lambda: "certificate" in page.text("#subtitle") and console.modes() == ["FLY"], "the page to be right"
        )
        right = time.time()
        # DDS takes up to 3 s to let a node that was killed and back hear from others: told, not asked for
        console_back, with_discovery = right - page.run("return first"), right - began

        # the controller is killed and comes back
        controller.send(signal.SIGKILL)
        controller.wait()
        console.await_modes("no telemetry")
        ticks = lab.watch(interfaces.TELEMETRY, "cf1")
        lab.fly("cf1")
        lab.wait(lambda: ticks, "the first message of the new controller")
        began = time.monotonic()
        page.wait(lambda: console.modes()[:1] not in ([], ["no telemetry"]), "the page to be right again")
        controller_back = time.monotonic() - began
        page.require_sound("net::ERR_")  # while there was no console

    # a port that is taken
    second = lab.start("console", port=port)
    assert second.wait() == 2
    assert f"port = {port}: must be one on which nobody listens" in second.output
    back = {"console": console_back, "console, discovery included": with_discovery, "controller": controller_back}
    note("right_again_s", back)
    assert max(console_back, controller_back) < RIGHT_AGAIN


def test_the_page_shows_what_a_bag_has_and_soon(lab: Lab, tmp_path: Path) -> None:
    lab.start("sim_drone", robot_names=["cf1", "cf2"])
    lab.fly("cf1", "cf2", certificate="cf21_50hz")
    address = address_of(lab, lab.start("console", port=0))
    bag = tmp_path / "bag"
    recorder = lab.start("record", robot_names=["cf1", "cf2"], output=bag)
    with opened(address, flat=True) as console:
        page = console.page
        console.await_modes("IDLE", "IDLE")
        console.press("all", "takeoff")
        console.await_modes("FLY", "FLY")
        page.run(
            "window.lags = { told: [], drawn: [] };"
            "const draw = console_.draw.bind(console_), show = console_.show.bind(console_);"
            "const note = (list) => { for (const { pose } of newest.drones)"
            " if (pose) list.push(Date.now() / 1000 - pose.stamp); };"
            "console_.show = (picture) => { window.newest = picture; show(picture); note(lags.told); };"
            "console_.draw = () => { draw(); note(lags.drawn); }"
        )
        page.wait(lambda: page.run("return lags.told.length > 200 && lags.drawn.length > 4"), "some pictures")
        lags = {what: np.array(found) for what, found in page.run("return lags").items()}
        shown = {
            kind: page.run(
                f"const c = console_.flight.drones[0].channel('{kind}');"
                "return c.times.map((_, k) => c.columns.map((column) => column[k]))"
            )
            for kind in ("pose", "tick")
        }
    assert recorder.stop(signal.SIGINT) == 0
    (track,) = (track for track in read_flight(bag).tracks if track.name == "cf1")
    for kind, rows in shown.items():
        samples = track.channels[kind].samples[:, 1:]
        recorded = {tuple(row) for row in np.where(np.isfinite(samples), samples, 0.0).tolist()}
        told = [tuple(0.0 if value is None else value for value in row) for row in rows]
        # the recorder may have begun after the page
        found = [row in recorded for row in told[len(told) // 4 :]]
        assert len(found) > 50
        assert all(found), f"{kind}: {found.count(False)} of {len(found)} are not in the bag"
    # told, not asked for: what else the machine does counts
    for what, values in lags.items():
        median, worst = (float(value) for value in np.quantile(values, [0.5, 0.99]))
        note(f"stamp_to_page_{what}_s", {"median": median, "99 %": worst, "samples": len(values)})
        print(
            f"from a pose's stamp to the page, {what}: median {median:.3f} s, 99 % {worst:.3f} s; goals 0.1 and 0.2 s"
        )


def note(name: str, figures: dict[str, Any]) -> None:
    """Keep what was measured beside the screenshots."""
    SCREENS.mkdir(parents=True, exist_ok=True)
    file = SCREENS / "measured.json"
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    file.write_text(json.dumps(known | {name: figures}, indent=2) + "\n", encoding="utf-8")
