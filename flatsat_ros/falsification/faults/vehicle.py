"""Faults of the drone, of the air and of the radio: thrust, weight, battery, emergency, wind, lost commands."""

from __future__ import annotations

import math
from dataclasses import replace

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.falsification.faults.criteria import Criteria, End
from flatsat_ros.falsification.faults.fault import ALL, EARLY, ONE, Action, Fault, commands, end, from_the_start, poses
from flatsat_ros.falsification.faults.phases import Phase
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.sim import faults
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.power import Battery

_CLOSE = Criteria(End.DONE, distance=0.5)
_HELD = Criteria(End.DONE, distance=0.5, arrival=0.03)
# whoever stops the motors in the air lets the drone fall: only what follows can be judged
_FALLS = Criteria(End.DOWN, impact=math.inf, told=r"climb|motors|fall|rise|emergency|lock|reboot|tumble")
# it may be down before the motors stop
_DOWN_UNTOLD = Criteria(End.DOWN, impact=math.inf)
_BLOWN = r"wind|disturb|away|limit|tilt"
_MARKERS = 0.029 / 0.032  # of the thrust for each kg: 3 g on a Crazyflie of 29 g


def _blow(wind: Wind) -> Action:
    def act(scene: Scene) -> None:
        scene.fleet.wind = wind

    return act


def _wind(name: str, meaning: str, wind: Wind, bounds: Criteria, watched: float = 10.0) -> Fault:
    return Fault(name, meaning, ((0.0, _blow(wind)),), bounds, victims=ALL, watched=watched)


def _thrust(percent: int, height: float = 1.0) -> Fault:
    low = "" if height == 1.0 else f"_{height:g}m"
    return Fault(
        f"thrust_{'plus' if percent > 0 else 'minus'}_{abs(percent)}{low}",
        f"{abs(percent)} % of thrust {'too much' if percent > 0 else 'missing'}"
        + (f", flown {height:g} m high" if low else ""),
        (),
        _HELD,
        victims=ALL,
        fleet={"thrust_scale": 1.0 + percent / 100.0},
        height=height,
    )


def _blind(percent: int, height: float) -> Fault:
    return Fault(
        f"thrust_{'plus' if percent > 0 else 'minus'}_{abs(percent)}_poses_lost_{height:g}m",
        f"no pose of one drone for 15 s, {height:g} m above the floor, with {abs(percent)} % of thrust "
        f"{'too much' if percent > 0 else 'missing'}",
        ((0.0, poses(lambda _: faults.lost)), (15.0, end)),
        Criteria(End.DOWN, told=r"pose"),
        # before the thrust has been learnt
        {Phase.TAKE_OFF: Criteria(End.DOWN, impact=2.0, distance=0.1, told=r"pose")},
        fleet={"thrust_scale": 1.0 + percent / 100.0},
        height=height,
        watched=3.0,
    )


def _emergency(*drones: int) -> Action:
    def act(scene: Scene) -> None:
        for drone in set(drones) & set(range(scene.fleet.count)):
            scene.fleet.firmware.request_emergency(drone)

    return act


def _reboot(scene: Scene) -> None:
    scene.fleet.reboot(0)


def _unlock(scene: Scene) -> None:
    """Send what another controller or a joystick sends first."""
    scene.fleet.command(0, *WireSetpoint(0.0, 0.0, 0.0, 0.0))


VEHICLE_FAULTS = (
    _wind("wind_2", "wind of 2 m/s", Wind(mean=(2.0, 0.0, 0.0)), Criteria(End.DONE, distance=0.5, arrival=0.25)),
    # tilted by 10 degrees the drone holds against 3.8 m/s
    _wind("wind_4", "wind of 4 m/s", Wind(mean=(4.0, 0.0, 0.0)), Criteria(End.SAFE, told=_BLOWN), watched=15.0),
    _wind(
        "wind_6",
        "wind of 6 m/s: more than the tilt can hold against",
        Wind(mean=(6.0, 0.0, 0.0)),
        # for the 4 s of noticing and landing it is blown away with 1 m/s^2, which drag limits to 2.2 m/s
        Criteria(End.DOWN, impact=2.5, distance=8.0, told=_BLOWN),
    ),
    _wind("gusts_1", "gusts of 1 m/s", Wind(gust=1.0), _CLOSE),
    _wind("gusts_2", "gusts of 2 m/s", Wind(gust=2.0), Criteria(End.SAFE)),
    *(_thrust(percent) for percent in (-20, -10, 10, 20)),
    *(_thrust(percent, 0.5) for percent in (-20, -12, 20)),
    Fault(
        "markers",
        "3 g of markers",
        (),
        _HELD,
        victims=ALL,
        fleet={"thrust_scale": _MARKERS},
    ),
    *(_blind(percent, height) for percent in (-10, 10) for height in (1.0, 3.0)),
    Fault(
        "battery_sagging",
        "the battery empties in flight: low after 8 s, off 14 s later",
        (),
        Criteria(End.DOWN, told=r"battery"),
        victims=ALL,
        fleet={"battery": Battery(voltage=3.55, sag=0.2, drain=0.04)},
        watched=20.0,
    ),
    Fault(
        "battery_empty",
        "the battery is empty from the beginning",
        (),
        Criteria(End.GROUNDED, told=r"battery"),
        victims=ALL,
        fleet={"battery": Battery(voltage=3.05, sag=0.2)},
        since_take_off=EARLY,
    ),
    Fault("emergency", "emergency stop of one drone", ((0.0, _emergency(0)),), _FALLS),
    Fault("emergency_all", "emergency stop of all drones", ((0.0, _emergency(*ALL)),), _FALLS, victims=ALL),
    Fault(
        "emergency_reboot",
        "emergency stop, 3 s later a reboot",
        ((0.0, _emergency(0)), (3.0, _reboot), (4.0, _unlock)),
        _FALLS,
    ),
    Fault(
        "emergency_early",
        "the drone was stopped before the flight and not rebooted",
        (),
        Criteria(End.GROUNDED, told=r"climb|motors|emergency|lock|reboot"),
        fleet={"stopped": ONE},
        since_take_off=EARLY,
    ),
    Fault("reboot", "the drone boots in flight", ((0.0, _reboot),), _FALLS),
    Fault(
        "propeller",
        "a propeller breaks: the drone tumbles",
        ((0.0, commands(lambda _: faults.roll_uncontrolled(0))),),
        # tilted by 60 degrees after 0.55 s it has 1.9 m/s sideways, and falls for 0.45 s
        replace(_FALLS, distance=1.5),
    ),
    Fault("table", "start on a table, 0.75 m high", (), _CLOSE, victims=ALL, fleet={"floor": 0.75}),
    Fault("step", "start on a step, 0.2 m high", (), _CLOSE, victims=ALL, fleet={"floor": 0.2}),
    Fault("low_floor", "the floor is at z = -0.4 m", (), _CLOSE, victims=ALL, fleet={"floor": -0.4}),
    Fault(
        "commands_half",
        "half of the commands are lost",
        ((0.0, commands(lambda s: faults.commands_lost(0.5, s.seed, 0))),),
        _CLOSE,
    ),
    Fault(
        "commands_lost_1s",
        "no command arrives for 1 s",
        ((0.0, commands(lambda s: faults.commands_lost(1.0, s.seed, 0))), (1.0, end)),
        Criteria(End.DONE),
    ),
    Fault(
        "commands_lost_5s",
        "no command arrives for 5 s: after 2 s the firmware stops the motors",
        ((0.0, commands(lambda s: faults.commands_lost(1.0, s.seed, 0))), (5.0, end)),
        _FALLS,
        {Phase.LANDING: _DOWN_UNTOLD},
    ),
    *(
        Fault(
            f"commands_late_{late:g}s",
            f"commands arrive {late:g} s late",
            ((0.0, commands(lambda _, late=late: faults.commands_delayed(late, 0))),),  # type: ignore[misc]
            bounds,
            watched=10.0 if late < 0.3 else 40.0,  # until it is down
        )
        for late, bounds in (
            (0.1, _CLOSE),
            # more than certified: the drone sways, but near its place
            (0.2, Criteria(End.SAFE, distance=0.25, speed=1.0)),
            (0.3, Criteria(End.SAFE)),
        )
    ),
    *(
        from_the_start(
            f"commands_late_{late:g}s",
            f"commands arrive {late:g} s late",
            commands(lambda _, late=late: faults.commands_delayed(late, *ALL)),  # type: ignore[misc]
            Criteria(End.DOWN, distance=distance),
        )
        for late, distance in ((0.1, 0.5), (0.2, 0.5), (0.3, 1.0))
    ),
    Fault(
        "pitch_negated",
        "the pitch has the sign of the other back end",
        ((0.0, commands(lambda _: faults.pitch_negated(0))),),
        Criteria(End.SAFE, told=r"pitch|axis|sign|command|innovation|predict|yaw"),
        since_take_off=EARLY,
    ),
)  # fmt: skip
