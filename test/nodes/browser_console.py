"""Every control of the console's page, as a person uses it, against live simulated drones: `make test-browser`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from browser import DESKTOP, PHONE
from console_page import address_of, opened
from selenium.webdriver.common.keys import Keys

if TYPE_CHECKING:
    from conftest import Lab

ROBOTS = ("cf1", "cf2")
TUNED = {"mu": 20.0, "v_inf": 1e-6, "gamma_max": 2.5, "nu": 0.02}
WIDTHS = {"desktop": DESKTOP, "phone": PHONE}


def lab_with_console(lab: Lab) -> str:
    """Start two drones, a controller whose certificate has tubes, and a console; return its address."""
    lab.start("sim_drone", robot_names=list(ROBOTS))
    lab.fly(*ROBOTS, certificate="cf21_adaptive_50hz")
    return address_of(lab, lab.start("console", port=0))


def test_the_buttons_of_one_drone_and_of_all_do_what_they_say(lab: Lab) -> None:
    with opened(lab_with_console(lab)) as console:
        page = console.page
        console.await_modes("IDLE", "IDLE")
        assert page.text("#subtitle") == "2 drones, certificate cf21_adaptive_50hz, 50 Hz"

        # one click is not enough where it could be an accident, and is forgotten
        page.find("#takeoff-all").click()
        page.wait(lambda: page.text("#takeoff-all") == "Take off all", "the first click to be forgotten")
        assert console.modes() == ["IDLE", "IDLE"]

        console.press(1, "takeoff")
        console.await_modes("FLY", "IDLE")
        console.press(1, "hold")
        console.await_words("hold cf1:")
        console.press(1, "land")
        page.wait(lambda: console.modes()[0] in ("REST", "IDLE"), "the landing of one")
        console.await_modes("IDLE", "IDLE")
        console.press(1, "disarm")
        console.await_words("disarm cf1:")
        console.press(1, "takeoff")
        console.await_words("disarmed: arm it first")
        assert console.is_refused()
        console.press(1, "arm")
        console.await_words("arm cf1:")
        page.wait(lambda: "ready to fly" in page.text(".card:nth-child(1)"), "the thrust lock to open")
        console.await_modes("IDLE", "IDLE")

        console.press("all", "disarm")
        console.await_words("disarm all:")
        console.press("all", "takeoff")
        console.await_words("cf2: takeoff refused: the drone is disarmed")
        console.press("all", "arm")
        console.await_words("arm all:")
        console.await_modes("IDLE", "IDLE")
        console.press("all", "takeoff")
        console.await_modes("FLY", "FLY")
        console.press("all", "hold")
        console.await_words("hold all:")
        console.press("all", "hand_over")
        console.await_words("hand_over refused")
        assert console.modes() == ["FLY", "FLY"]
        console.press("all", "land")
        page.wait(lambda: set(console.modes()) <= {"REST", "IDLE"}, "the landing of all")

        # the keyboard: space lands all also where a button has the focus, but not where somebody types
        console.await_modes("IDLE", "IDLE")
        console.press("all", "takeoff")
        console.await_modes("FLY", "FLY")
        page.find("#height").send_keys(" ")
        page.find("#hold-all").click()
        console.await_words("hold all:")
        assert console.modes() == ["FLY", "FLY"]
        page.driver.switch_to.active_element.send_keys(Keys.SPACE)
        console.await_words("land all:")
        page.wait(lambda: set(console.modes()) <= {"REST", "IDLE"}, "the space bar to land all")

        # handed over to nobody: silence
        console.await_modes("IDLE", "IDLE")
        assert lab.set_parameters({"hand_over_force": True}) == [(True, "")]
        console.press("all", "takeoff")
        console.await_modes("FLY", "FLY")
        console.press(2, "hand_over")
        console.await_words("hand_over cf2:")
        page.wait(lambda: console.modes()[1] != "FLY", "the controller to fall silent")
        assert console.modes()[0] == "FLY"

        console.press(1, "emergency")
        page.wait(lambda: console.modes()[0] == "FALLEN", "the emergency stop of one")
        page.require_sound()


@pytest.mark.parametrize("stop", ["button", "key"])
def test_an_emergency_stops_all(lab: Lab, stop: str) -> None:
    with opened(lab_with_console(lab)) as console:
        console.await_modes("IDLE", "IDLE")
        console.press("all", "takeoff")
        console.await_modes("FLY", "FLY")
        console.page.wait(
            lambda: console.value(0, "z", "pose") > 0.2 < console.value(1, "z", "pose"), "the drones to rise"
        )
        if stop == "button":
            console.press("all", "emergency")
        else:
            console.page.find("#height").send_keys(Keys.ESCAPE)  # also where somebody types
        console.await_modes("FALLEN", "FALLEN")
        entries = console.page.driver.find_elements("css selector", "#log li.error")
        assert any("FALLEN" in entry.text for entry in entries)


def test_tuning_and_goals_are_taken_or_refused_with_the_reason(lab: Lab) -> None:
    address = lab_with_console(lab)
    with opened(address) as console:
        page = console.page
        console.await_modes("IDLE", "IDLE")
        console.press("all", "takeoff")
        console.await_modes("FLY", "FLY")

        # of all by numbers: gamma answers to mu; of one by sliders, the other keeps what it has
        for name, value in TUNED.items():
            console.tune(name, f"{value:f}")
            page.wait(lambda n=name, v=value: console.setup(n) == v, f"{name} to be in force")
        before = console.value(0, "gamma")
        page.wait(lambda: console.value(0, "gamma") > before, "gamma to grow")
        asked = page.run("return console_.sent")
        page.find("#tune-mu").clear()
        assert page.run("return console_.sent") == asked  # nothing was typed, nothing is set
        console.choose_tuning("cf2")
        for name, (low, high) in {
            "mu": (0.01, 100),
            "v_inf": (1e-4, 10),
            "gamma_max": (1, 100),
            "nu": (0.001, 10),
        }.items():
            console.drag(name, 0.15)
            own = f"robots.cf2.{name}"
            page.wait(lambda n=own: console.setup(n) is not None, f"{own} to be in force")
            share = math.log(console.setup(own) / low) / math.log(high / low)
            assert share == pytest.approx(0.15, abs=0.06), name
            assert console.setup(name) == TUNED[name]
            assert console.setup(f"robots.cf1.{name}") is None
        console.drag("gamma_max", 0.9)
        console.await_words("must be at most the certificate's")
        assert console.is_refused()
        in_force = f"{console.setup('robots.cf2.gamma_max'):.4g}"
        page.wait(
            lambda: f"{float(page.find('#tune-gamma_max').get_attribute('value') or 0):.4g}" == in_force,
            "the value in force to come back",
        )

        # goals by clicks on the floor, at the height that is given; without the tick a click sends nobody anywhere
        console.click_floor()
        assert "goal" not in console.said()
        page.find("#aim").click()
        height = page.find("#height")
        height.clear()
        height.send_keys("0.7")
        console.click_floor()
        console.await_words("cf1 flies to")
        assert console.said().endswith(", 0.70 m")
        place = [float(word) for word in console.said().removesuffix(" m").partition("flies to ")[2].split(",")]
        page.wait(
            lambda: all(
                abs(console.value(0, axis, "pose") - there) < lab.near for axis, there in zip("xyz", place, strict=True)
            ),
            f"cf1 at {place}",
        )
        page.find(".card:nth-child(2) h3 button").click()
        assert page.text("#aimed") == "cf2"
        height.clear()
        height.send_keys("99")
        console.click_floor()
        console.await_words("cf2/goal_pose: z of the goal = 99.0 m: must be in the box")
        assert console.is_refused()

        # the same by the keyboard alone; where no place is given nobody is sent anywhere
        sent = page.run("return console_.sent")
        for part in ("goal-x", "goal-y"):
            page.find(f"#{part}").clear()
        height.clear()
        height.send_keys("0.6", Keys.ENTER)
        assert page.run("return console_.sent") == sent
        for part, words in (("goal-x", "0.9"), ("goal-y", "0.2")):
            page.find(f"#{part}").send_keys(words)
        page.find("#go").send_keys(Keys.ENTER)
        console.await_words("cf2 flies to 0.90, 0.20, 0.60 m")

        # what a card says is what is told
        page.wait(lambda: "sim_drone" in page.text(".card:nth-child(1)"), "the link")
        card = page.text(".card:nth-child(1)")
        assert f"battery {console.value(0, 'voltage', 'battery'):.3g} V" in card
        assert "guaranteed" in card
        age = page.run("return console_.flight.drones[0].ages.pose")
        assert 0.0 <= age < 1.0
        page.find("#look").click()
        page.find("#theme").click()
        page.require_sound()

    for width, size in WIDTHS.items():
        for theme in ("light", "dark"):
            with opened(address, size) as console:
                console.await_modes("FLY", "FLY")
                if theme == "dark":
                    console.page.find("#theme").click()
                console.page.wait(lambda: console.page.run("return console_.flight.end") > 6.0, "some curves")
                assert console.page.run("return document.documentElement.scrollWidth") <= size[0]
                console.page.screenshot(f"console_{width}_{theme}")
                console.page.require_sound()
