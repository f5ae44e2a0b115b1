"""The console against real nodes: it shows what flies, commands it, and says what was refused."""

from __future__ import annotations

import http.client
import json
import re
import signal
from typing import TYPE_CHECKING, Any

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS

if TYPE_CHECKING:
    from conftest import Lab, Process


class Browser:
    """What a page of the console does, without one."""

    def __init__(self, lab: Lab, process: Process) -> None:
        self._lab = lab
        lab.wait(lambda: "http://" in process.output, "the address")
        found = re.search(r"http://([\d.]+:\d+)", process.output)
        assert found
        self.host = found[1]
        self._stream = http.client.HTTPConnection(self.host, timeout=10.0)
        self._stream.request("GET", "/events")
        self._news = self._stream.getresponse()

    def look(self) -> dict[str, Any]:
        """The newest picture."""
        while not (line := self._news.readline()).startswith(b"data: "):
            assert line
        picture: dict[str, Any] = json.loads(line[6:])
        return picture

    def mode(self) -> Mode | None:
        drones = self.look()["drones"]
        values = drones[0].get("telemetry", {}).get("values") if drones else None
        return Mode(int(values[FIELDS.index("mode")])) if values else None

    def send(self, **command: object) -> tuple[bool, str]:
        connection = http.client.HTTPConnection(self.host, timeout=10.0)
        headers = {"Content-Type": "application/json", "Origin": f"http://{self.host}"}
        connection.request("POST", "/command", json.dumps(command), headers)
        answer = json.loads(connection.getresponse().read())
        connection.close()
        return answer["done"], answer["text"]

    def leave(self) -> None:
        self._news.close()
        self._stream.close()


def test_a_flight_is_seen_and_steered_through_the_console(lab: Lab) -> None:
    console = lab.start("console", port=0)
    browser = Browser(lab, console)
    assert browser.look()["drones"] == []
    done, text = browser.send(do="takeoff", who="all")
    assert not done
    assert "no service" in text

    lab.start("sim_drone", robot_names=["cf1"])
    lab.fly("cf1")
    lab.wait(lambda: browser.mode() is Mode.IDLE, "the drone on the page")
    lab.wait(lambda: browser.send(do="takeoff", who="cf1")[0], "the take-off")
    lab.wait(lambda: browser.mode() is Mode.FLY, "the flight on the page")

    assert browser.send(do="set", who="cf1", name="mu", value=3.0) == (True, "")
    lab.wait(lambda: browser.look()["setup"].get("robots.cf1.mu") == 3.0, "the new value on the page")
    done, text = browser.send(do="set", who="all", name="gamma_max", value=1e5)
    assert not done
    assert "must be at most the certificate's" in text

    assert browser.send(do="goal", who="cf1", position=[0.3, 0.2, 0.7])[0]
    done, text = browser.send(do="goal", who="cf1", position=[0.3, 0.2, 70.0])
    assert not done
    assert "z of the goal = 70.0 m: must be in the box" in text
    refused = browser.send(do="goal", who="cf1", position=[1e99, 0.2, 0.7])
    assert refused == (False, "position = [1e+99, 0.2, 0.7] m: must be three numbers, each below 1e9")
    refused = browser.send(do="set", who="cf1", name="mu", value="3")
    assert refused == (False, "mu = '3': must be a number below 1e9")

    def arrived() -> bool:
        x, y, z = browser.look()["drones"][0]["pose"]["values"][:3]
        return abs(x - 0.3) < lab.near and abs(y - 0.2) < lab.near and abs(z - 0.7) < lab.near

    lab.wait(arrived, "the drone at its goal")
    for refused in (
        {"do": "fly", "who": "cf1"},
        {"do": "land", "who": "cf9"},
        {"do": "goal", "who": "all", "position": [0, 0, 1]},
        {"do": "goal", "who": "cf1", "position": [0, 0, "1"]},
        {"do": "set", "who": "cf1", "name": "certificate", "value": 1.0},
        {"do": "set", "who": "cf1", "name": "mu", "value": None},
        {},
    ):
        assert not browser.send(**refused)[0]

    # another page comes and goes, and the console itself: the drone flies on, and the new page shows it
    other = Browser(lab, console)
    assert other.mode() is Mode.FLY or other.mode() is None
    other.leave()
    browser.leave()
    assert console.stop(signal.SIGINT) == 0
    browser = Browser(lab, lab.start("console", port=0))
    lab.wait(lambda: browser.mode() is Mode.FLY, "the flight on the page of a new console")
    assert browser.send(do="land", who="all")[0]
    lab.wait(lambda: browser.mode() in (Mode.REST, Mode.IDLE), "the landing")
