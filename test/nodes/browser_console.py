"""The console's page as a person uses it, with live simulated drones: `make test-browser`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from browser import DESKTOP, PHONE, Page, browser
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

if TYPE_CHECKING:
    from conftest import Lab

ROBOTS = ("cf1", "cf2")


def modes(page: Page) -> list[str]:
    return [mode.text for mode in page.driver.find_elements("css selector", ".card .mode")]


def press(page: Page, drone: int, what: str) -> None:
    """Press a button of a drone's card, twice where it wants to be sure."""
    selector = f".card:nth-child({drone}) [data-what={what}]"
    page.find(selector).click()
    if page.text(selector) == "Click again":
        page.find(selector).click()


def tune(page: Page, name: str, value: str) -> None:
    field = page.find(f"#tune-{name}")
    field.clear()
    field.send_keys(value, Keys.TAB)


def test_every_control_reaches_the_drones(lab: Lab) -> None:
    lab.start("sim_drone", robot_names=list(ROBOTS))
    lab.fly(*ROBOTS)
    console = lab.start("console", port=0)
    lab.wait(lambda: "http://" in console.output, "the address")
    address = console.output.partition("open ")[2].split()[0]
    with browser(address, DESKTOP) as page:
        page.wait(lambda: modes(page) == ["IDLE", "IDLE"], "both drones on the page")
        assert "2 drones" in page.text("#subtitle")

        # one click is not enough where it could be an accident
        page.find("#takeoff-all").click()
        assert page.text("#takeoff-all") == "Click again"
        page.find("#takeoff-all").click()
        page.wait(lambda: modes(page) == ["FLY", "FLY"], "the take-off")

        # mu, and gamma that answers
        tune(page, "mu", "20")
        page.wait(lambda: "set all: done" in page.text("#said"), "the new value")
        tune(page, "v_inf", "0.000001")
        page.wait(lambda: page.run("return console_.flight.setup.v_inf") == 1e-6, "the value on the page")
        before = page.run("return console_.flight.drones[0].channel('tick').at('gamma', console_.flight.end)")
        page.wait(
            lambda: (
                page.run("return console_.flight.drones[0].channel('tick').at('gamma', console_.flight.end)") > before
            ),
            "gamma to grow",
        )
        tune(page, "gamma_max", "100000")
        page.wait(lambda: "must be at most the certificate's" in page.text("#said"), "why it is refused")
        page.wait(lambda: page.find("#tune-gamma_max").get_attribute("value") == "0", "the value in force")

        # a goal by a click on the floor, and one that is refused
        page.find("#aim").click()
        page.run("window.scrollTo(0, 0)")
        scene = page.find("#scene canvas")
        ActionChains(page.driver).move_to_element_with_offset(scene, -40, 60).click().perform()
        page.wait(lambda: "cf1 flies to" in page.text("#said"), "the goal to be taken")
        height = page.find("#height")
        height.clear()
        height.send_keys("99")
        page.run("window.scrollTo(0, 0)")
        ActionChains(page.driver).move_to_element_with_offset(scene, -40, 60).click().perform()
        page.wait(lambda: "must be in the box" in page.text("#said"), "why the goal is refused")
        assert "refused" in page.find("#said").get_attribute("class")

        press(page, 1, "hold")
        page.wait(lambda: page.text("#said").startswith("hold cf1"), "the hold")
        press(page, 2, "land")
        page.wait(lambda: modes(page)[1] in ("REST", "IDLE"), "the landing of one")
        assert modes(page)[0] == "FLY"
        page.screenshot("console_desktop")
        page.require_sound()

        # the keyboard, from where nothing is typed
        page.find("h1").click()
        page.driver.switch_to.active_element.send_keys(Keys.SPACE)
        page.wait(lambda: set(modes(page)) <= {"REST", "IDLE"}, "the space bar to land all")
        page.wait(lambda: set(modes(page)) == {"IDLE"}, "the end of the rest")
        press(page, 1, "disarm")
        page.wait(lambda: "disarm cf1" in page.text("#said"), "the disarming")
        press(page, 1, "takeoff")
        page.wait(lambda: "disarmed: arm it first" in page.text("#said"), "why it does not take off")
        press(page, 1, "arm")
        page.wait(lambda: page.text("#said").startswith("arm cf1:"), "the arming")
        page.wait(lambda: modes(page)[0] == "IDLE", "the unlocking to end")
        press(page, 1, "takeoff")
        page.wait(lambda: modes(page)[0] == "FLY", "the second take-off")
        page.driver.switch_to.active_element.send_keys(Keys.ESCAPE)
        page.wait(lambda: modes(page)[0] == "FALLEN", "the emergency stop")
        assert any("FALLEN" in entry.text for entry in page.driver.find_elements("css selector", "#log li"))

    with browser(address, PHONE) as page:
        page.wait(lambda: modes(page)[:1] == ["FALLEN"], "the drones on a phone")
        assert page.run("return document.documentElement.scrollWidth") <= PHONE[0]
        page.screenshot("console_phone")
        page.require_sound()
