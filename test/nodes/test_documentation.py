"""docs/interfaces.md says what the nodes offer, no more and no less, and by which thresholds they fly."""

from __future__ import annotations

import math
import os
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import rclpy
import yaml
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from flatsat_ros.flight import (
    astray,
    detectors,
    estimator,
    monitors,
    orientation,
    plausibility,
    supervisor,
    waiting,
    yielding,
)
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.identification.recording import COLUMNS
from flatsat_ros.nodes import last_resort, rivals
from flatsat_ros.nodes.cflib_bridge import CflibBridge
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.mocap_player import MocapPlayer
from flatsat_ros.nodes.recorder import RecorderNode
from flatsat_ros.nodes.ros import cdr, faults, interfaces
from flatsat_ros.nodes.server_commands import COMMANDS
from flatsat_ros.nodes.server_parameters import FIRMWARE
from flatsat_ros.nodes.sim_drone import SimDrone
from flatsat_ros.nodes.sim_server import SimServer

pytestmark = pytest.mark.in_process

NODES = {
    "controller": ControllerNode,
    "sim_drone": SimDrone,
    "sim_server": SimServer,
    "mocap_player": MocapPlayer,
    "record": RecorderNode,
    **({"cflib_bridge": CflibBridge} if find_spec("cflib") else {}),
}
# what a node does not start without, as {folder} of the test's, and what makes it offer all that it can offer
GIVEN = {
    "mocap_player": {"file": "{folder}/recording.csv"},
    "record": {"output": "{folder}/bag"},
    "cflib_bridge": {
        "pose_rate": "50.0",
        "external_pose": "pose",
        "uris": f"['udp://127.0.0.1:{1024 + os.getpid() * 7919 % 64000}']",  # which no other run has claimed
    },
    "sim_server": {"odom_rate": "10.0"},
}
# defaults that are put into words
COMPUTED = {"start_positions", "uris"}
# what rclpy declares and offers by itself
OWN_PARAMETER = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")
OWN_TOPICS = {"parameter_events", "rosout"}
ABSOLUTE = {interfaces.DIAGNOSTICS, interfaces.NAMED_POSES, interfaces.TF}
# of the simulated firmware
FIRMWARE_PARAMETER = re.compile(r"(cf1|all)\.params\.(.+)")
OWN_SERVICE = re.compile(r".*/(\w+_parameters\w*|get_parameter_types|list_parameters|get_type_description)")


class Offer(NamedTuple):
    """What one program offers.

    Attributes:
        node: name of its node.
        parameters: default or given value, type and whether it may change in flight, by name.
        topics: of (direction, name, type, quality of service); <robot> stands for the robot.
        services: of (name, type).
    """

    node: str
    parameters: dict[str, tuple[Any, str, bool]]
    topics: set[tuple[str, str, str, str]]
    services: set[tuple[str, str]]


def kind(interface: Any) -> str:
    """A type as the page writes it."""
    return f"{interface.__module__.partition('.')[0]}/{interface.__name__}"


def quality(profile: QoSProfile) -> str:
    """A quality of service as the page writes it."""
    kept = ", transient local" if profile.durability is DurabilityPolicy.TRANSIENT_LOCAL else ""
    return f"{profile.reliability.name.lower().replace('_', ' ')}{kept}, depth {profile.depth}"


def offer_of(node: Node) -> Offer:
    """What a node offers."""

    def name(resolved: str) -> str:
        relative = resolved.removeprefix("/")
        return re.sub("^cf1/", "<robot>/", relative) if resolved not in ABSOLUTE else resolved

    parameters = {
        name: (value.value, value.type_.name.lower().replace("_", " "), not node.describe_parameter(name).read_only)
        for name, value in node._parameters.items()
        if not OWN_PARAMETER.fullmatch(name)
    }
    ends = [("out", end) for end in node.publishers] + [("in", end) for end in node.subscriptions]
    topics = {(way, name(end.topic_name), kind(end.msg_type), quality(end.qos_profile)) for way, end in ends}
    services = {(name(service.service_name), kind(service.srv_type)) for service in node.services}
    return Offer(
        node.get_name(),
        parameters,
        {topic for topic in topics if topic[1].strip("/") not in OWN_TOPICS},
        {(name.removeprefix("/"), what) for name, what in services if not OWN_SERVICE.fullmatch(name)},
    )


@pytest.fixture(scope="module")
def offers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Offer]:
    """What every program offers, from its node."""
    folder, found = tmp_path_factory.mktemp("given"), {}
    (folder / "recording.csv").write_text(f"{','.join(COLUMNS)}\n0,0,0,1,0,0,0,1\n", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        for program, make in NODES.items():
            given = [f"{name}:={value.format(folder=folder)}" for name, value in GIVEN.get(program, {}).items()]
            rclpy.init(args=["--ros-args", *(part for value in given for part in ("-p", value))])
            node = make()
            found[program] = offer_of(node)
            node.finish()
            node.destroy_node()
            rclpy.shutdown()
    return found


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / "docs" / "interfaces.md").read_text(encoding="utf-8")


def section(page: str, title: str) -> str:
    """The part below one heading."""
    _, found, rest = page.partition(f"{title}\n")
    assert found, title
    return re.split(r"^#", rest, flags=re.MULTILINE)[0]


def tables(text: str) -> list[list[list[str]]]:
    """The rows of every table, without its head, as cells."""
    blocks = re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE)
    return [[[cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines()[2:]] for block in blocks]


def names(cell: str) -> list[str]:
    """The names that a cell puts into code."""
    return re.findall(r"`([^`]+)`", cell)


def test_every_program_is_documented_with_its_node(page: str, root: Path, offers: dict[str, Offer]) -> None:
    (table,) = tables(section(page, "## Programs"))
    documented = {names(program)[0]: names(node) for program, node, _ in table}
    scripts = re.findall(r'"(\w+) = flatsat_ros[.\w]+:\w+"', (root / "setup.py").read_text(encoding="utf-8"))
    assert sorted(documented) == sorted(scripts)
    assert {program: documented[program] for program in offers} == {
        program: [offer.node] for program, offer in offers.items()
    }
    named = {name for nodes in documented.values() for name in nodes}
    assert named == {*interfaces.NODES, "flatsat_demo"}, "that of the demo is given no file of parameters"


@pytest.mark.parametrize("program", NODES)
def test_every_parameter_is_documented_with_its_type_and_default(
    program: str, page: str, offers: dict[str, Offer]
) -> None:
    every, text = offers[program].parameters, section(page, f"## Parameters of `{program}`")
    declared = {name: what for name, what in every.items() if not FIRMWARE_PARAMETER.fullmatch(name)}
    common = {name for name in declared if not name.startswith("robots.")}
    (table, *_) = tables(text)
    if program in ("sim_drone", "sim_server"):
        table = tables(section(page, "### Ground effect and downwash"))[0] + table
    if program == "sim_server":  # its own defaults go over those of sim_drone
        own = {tuple(names(row[0])) for row in tables(text)[0]}
        table += tables(section(page, "## Parameters of `sim_drone`"))[0]
        table = [row for row in table if row in tables(text)[0] or tuple(names(row[0])) not in own]
    assert {name for row in table for name in names(row[0])} == common
    for name in {name.rpartition(".")[2] for name in declared} - common:
        assert f"`.{name}`" in text or f"`robots.<name>.{name}`" in text
    for row in table:
        own = names(row[0])
        for name, default in zip(own, row[2].split(", ") if len(own) > 1 else [row[2]], strict=True):
            value, what, changeable = declared[name]
            assert row[1] == what, name
            if name not in {*COMPUTED, *GIVEN.get(program, ())}:
                assert yaml.safe_load(default.strip("`") or "''") == value, name
            assert changeable == (program == "controller" and row[4] == "yes"), name


def test_every_firmware_parameter_is_documented_and_may_change(page: str, offers: dict[str, Offer]) -> None:
    declared = {
        found.groups(): changeable
        for name, (_, _, changeable) in offers["sim_server"].parameters.items()
        if (found := FIRMWARE_PARAMETER.fullmatch(name))
    }
    assert set(declared) == {(who, name) for who in ("cf1", interfaces.ALL) for name in FIRMWARE}
    assert all(declared.values())
    _, table = tables(section(page, "## Parameters of `sim_server`"))
    assert sorted(name for row in table for name in names(row[0])) == sorted(FIRMWARE)


def test_every_telemetry_entry_is_documented(page: str) -> None:
    (table,) = tables(page.partition("**telemetry.**")[2].partition("## ")[0])
    assert [name for entry, *_ in table for name in names(entry)] == list(FIELDS)


def test_every_topic_is_documented_with_its_ends_type_and_quality(page: str, offers: dict[str, Offer]) -> None:
    documented = set()
    for name, kinds, ends, qos in tables(section(page, "## Topics"))[0]:
        what, *condition = kinds.split(", ")
        if condition == ["where that is installed"] and find_spec(what.partition("/")[0]) is None:
            continue
        way = ""
        for word in re.findall(r"in:|out:|[a-z_]+", ends):
            way = word.removesuffix(":") if word in ("in:", "out:") else way
            if word in offers:
                verb = {"in": "subscribed", "out": "published"}[way]
                (own,) = re.findall(rf"{verb} ([^;]*)", qos) or [qos]
                documented |= {(word, way, one, what, own) for one in names(name)}
    assert documented == {(program, *topic) for program, offer in offers.items() for topic in offer.topics}


def test_every_service_is_documented_with_its_type(page: str, offers: dict[str, Offer]) -> None:
    controllers, plans, drones, commanders, logging = tables(section(page, "## Services"))
    installed = find_spec("crazyflie_interfaces") is not None
    documented = {
        ("controller", interfaces.service_of(who, names(name)[0]), what)
        for name, what, *_ in controllers
        for who in ("<robot>", interfaces.ALL)
    }
    documented |= {("controller", names(cell)[0], "std_srvs/Trigger") for cell, *_ in plans}
    for program in {"sim_drone", "sim_server", "cflib_bridge"} & set(offers):
        for cell, what, _ in drones:
            own, *crazyswarms = re.findall(r"\w+/\w+", what)
            for name in names(cell):
                if program != "cflib_bridge" or name not in ("<robot>/reboot", "all/arm"):
                    documented.add((program, name, crazyswarms[0] if crazyswarms and installed else own))
    for programs, table in ((("sim_drone", "sim_server"), commanders), (("sim_server",), logging)):
        if installed:
            offered = {(name, re.findall(r"\w+/\w+", what)[0]) for cell, what in table for name in names(cell)}
            documented |= {(program, *service) for program in programs for service in offered}
    assert documented == {(program, *service) for program, offer in offers.items() for service in offer.services}
    # installed or not, these are the names that we use
    commands = {interfaces.drone_service_of(who, name) for who in ("<robot>", interfaces.ALL) for name in COMMANDS}
    assert {name for cell, _ in commanders for name in names(cell)} == commands
    blocks = (interfaces.ADD_LOGGING, interfaces.REMOVE_LOGGING)
    assert {name for cell, _ in logging for name in names(cell)} == {f"<robot>/{name}" for name in blocks}


# what the page says of thresholds, with those of the code
THRESHOLDS = {
    "later than {:g} s from now, it is taken": (yielding.SOON,),
    "References that would come too near within {:g} s after all are not flown": (yielding._FORESIGHT,),
    "After {:g} s with nobody in the way but drones at rest the goal is given up": (waiting._PATIENCE,),
    "level with thrust {:g} g in the air": (Policy.level_thrust,),
    "Poses and goals have at most {} bytes. Lines about a drone come at most once a second each": (cdr._SIZE_MAX,),
    "at once and then at most every {:g} s. The other drones fly on": (faults._SILENCE,),
    "from {:g} s on if all are so old for half a second, from {:g} s on at once": (
        plausibility._LATE, plausibility._BEHIND,
    ),
    "by more than {:g} m beyond every motion are not followed in the air": (estimator._FAR,),
    "unless within a second they are back within {:g} m of where it should be": (estimator._NEAR_AGAIN,),
    "flies by poses again when these have been usable for {:g} s": (supervisor._STEADY_TIME,),
    "With `yaw_source: measured` it lands after {:g} s": (orientation._PATIENCE,),
    "by {:g} rad and {:g} rad/s of the time since the last one, or {:g} rad in any time, is none": (
        plausibility._TURN, plausibility._TURN_RATE, plausibility._TURN_MOST,
    ),
    "when for {:.1f} s the changes of its motion are explained by its commands": (astray._WRONG_TIME,),
    "but turned by more than {:.0f} degrees": (math.degrees(math.atan(astray._TURNED)),),
    "it is pushed back by more than {:g} times what it commands": (detectors._OPPOSED,),
    "One that slides {:g} m before it has risen {:g} m": (detectors._SLID, detectors.LIFTED_OFF),
    "at the limit of its tilt for {:g} s, more than {:g} m off its reference": (detectors._BLOWN_TIME, detectors._OFF),
    "or up and down, {:g} m/s^2 each way": (detectors._BOBBING,),
    "level, {:g} of the mean thrust of the last {:g} s and {:g} less every second, for {:g} s": (
        last_resort._SHARE, last_resort._MEMORY, last_resort._FALL, last_resort._DESCENT,
    ),
    "then zero thrust for {:g} s and silence": (last_resort._REST,),
    "two that send within {:g} s of each other are named": (rivals._HOLD,),
}  # fmt: skip


@pytest.mark.parametrize("sentence", THRESHOLDS)
def test_the_page_names_the_thresholds_of_the_code(page: str, sentence: str) -> None:
    assert sentence.format(*THRESHOLDS[sentence]) in " ".join(page.split())


def test_the_page_names_the_thresholds_that_it_puts_into_words(page: str) -> None:
    text = " ".join(page.split())
    words = {
        "so old for half a second": plausibility._LATE_FOR == 0.5,
        "unless within a second they are back": estimator._AGAIN_TIME == 1.0,
        "less a fifth of the time between": supervisor._FORGOTTEN == 1.0 / 5.0,
        "outside its tube for half a second": monitors._OUTSIDE == 0.5,
        "half of the limit each way": detectors._SWINGING_SHARE == 0.5,
        "at most once a second each": faults._REFUSAL_SILENCE == 1.0,
    }
    assert {name: name in text and holds for name, holds in words.items()} == dict.fromkeys(words, True)
