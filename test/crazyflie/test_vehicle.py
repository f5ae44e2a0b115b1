"""Laws of vehicle profiles."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.intervals import Intervals
from flatsat_ros.crazyflie.vehicle import VehicleProfile

VEHICLES = Path(__file__).parents[2] / "config" / "vehicles"
NAMES = ("cf21", "cf21_markers", "cf21_markers_light", "cf21_plus", "cf2x_2025", "thrust_kit", "brushless")


def profile(name: str = "cf21") -> VehicleProfile:
    return VehicleProfile.load(VEHICLES / f"{name}.yaml")


@pytest.mark.parametrize("path", sorted(VEHICLES.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_packaged_profile_loads_under_its_own_name(path: Path) -> None:
    assert VehicleProfile.load(path).name == path.stem
    assert path.stem in NAMES


@pytest.mark.parametrize(
    ("name", "ratio"),
    [
        ("cf21", 1.55),
        ("cf21_plus", 1.55),
        ("cf2x_2025", 1.45),
        ("thrust_kit", 2.07),
        ("brushless", 1.90),
        ("cf21_markers", 1.007),
        ("cf21_markers_light", 1.307),
    ],
)
def test_thrust_to_weight_ratio_at_pwm_60000(name: str, ratio: float) -> None:
    assert profile(name).thrust_max / GRAVITY == pytest.approx(ratio, abs=0.006)


@pytest.mark.parametrize(("name", "hover"), [("cf21", 42593), ("cf2x_2025", 45432)])
def test_hover_pwm_of_a_drone_of_31_8_grams(name: str, hover: int, tmp_path: Path) -> None:
    document = yaml.safe_load((VEHICLES / f"{name}.yaml").read_text())
    path = tmp_path / "heavier.yaml"
    path.write_text(yaml.safe_dump(document | {"mass": 0.0318}))
    assert VehicleProfile.load(path).pwm_from_thrust(GRAVITY) == pytest.approx(hover, abs=1.0)


@given(st.lists(st.floats(0.0, 20.0), min_size=1))
def test_pwm_and_thrust_are_linear_and_inverse(thrusts: list[float]) -> None:
    cf21 = profile()
    pwm = cf21.pwm_from_thrust(thrusts)
    np.testing.assert_allclose(cf21.thrust_from_pwm(pwm), thrusts, rtol=1e-14, atol=1e-12)
    np.testing.assert_allclose(cf21.pwm_from_thrust(2.0 * np.array(thrusts)), 2.0 * pwm, rtol=1e-14, atol=1e-12)
    assert cf21.pwm_from_thrust(cf21.thrust_max) == pytest.approx(cf21.pwm_max, rel=1e-14)


@given(st.floats(0.3, 3.0), st.lists(st.floats(-20.0, 20.0), min_size=1))
def test_a_thrust_map_with_a_slope_is_inverted_and_changes_thrust_by_that_share(
    slope: float, thrusts: list[float]
) -> None:
    bent = replace(profile(), thrust_slope=slope, force_max=0.5)
    pwm = bent.pwm_from_thrust(thrusts)
    np.testing.assert_allclose(bent.thrust_from_pwm(pwm), thrusts, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(bent.force_from_pwm(pwm), bent.mass * np.array(thrusts), rtol=1e-12, atol=1e-12)
    assert bent.pwm_from_thrust(bent.thrust_max) == pytest.approx(bent.pwm_max, rel=1e-12)
    assert bent.thrust_from_pwm(65535.0) == pytest.approx(bent.force_max / bent.mass, rel=1e-14)
    hover = float(bent.pwm_from_thrust(GRAVITY))
    raised = float(bent.thrust_from_pwm(hover * 1.0001)) / GRAVITY
    assert raised - 1.0 == pytest.approx(slope * 0.0001, rel=1e-3)


def test_the_identified_profile_says_how_well_it_is_known() -> None:
    drone = profile("cf21_markers")
    known = drone.intervals
    assert known is not None
    figures = {
        "attitude_gain": drone.dynamics.attitude_gain,
        "natural_frequency": drone.dynamics.attitude.natural_frequency,
        "damping": drone.dynamics.attitude.damping,
        "velocity_tilt": drone.dynamics.velocity_tilt,
        "drag_xy": drone.dynamics.drag_xy,
        "thrust_slope": drone.thrust_slope,
        "thrust_available": drone.thrust_max,
    }
    for name, value in figures.items():
        least, most = getattr(known, name)
        assert least < value < most, name
    assert drone.dynamics.velocity_tilt < drone.dynamics.drag_xy / GRAVITY  # drag taken for tilt, not more


@given(st.sampled_from(NAMES), st.floats(GRAVITY + 0.1, 40.0))
def test_with_the_mass_for_a_thrust_that_is_the_most_it_makes(name: str, thrust: float) -> None:
    drone = profile(name)
    assert replace(drone, mass=drone.mass_for(thrust)).thrust_max == pytest.approx(thrust, rel=1e-12)


@given(st.floats(0.1, 2.0), st.floats(GRAVITY + 0.1, 40.0))
def test_at_the_voltage_for_a_thrust_the_motors_make_it(exponent: float, thrust: float) -> None:
    drone = replace(profile(), thrust_voltage=exponent, voltage=3.5)
    voltage = drone.voltage_for(thrust)
    assert voltage is not None
    assert drone.thrust_max * drone.voltage_factor(voltage) == pytest.approx(thrust, rel=1e-12)
    assert drone.voltage_factor(0.0) == 0.0


@pytest.mark.parametrize(("exponent", "interval"), [(0.0, None), (-0.2, None), (0.3, (-0.1, 0.7))])
def test_no_voltage_is_named_that_flights_do_not_tell(exponent: float, interval: tuple[float, float] | None) -> None:
    known = Intervals(thrust_voltage=interval)
    assert replace(profile(), thrust_voltage=exponent, intervals=known).voltage_for(14.0) is None


@pytest.mark.parametrize("name", sorted(set(NAMES) - {"cf21_markers", "cf21_markers_light"}))
def test_the_general_thrust_map_tends_to_the_linear_one(name: str) -> None:
    linear, nearly = profile(name), replace(profile(name), thrust_slope=1.0 + 1e-12)
    assert linear.thrust_slope == 1.0
    pwm = np.linspace(1000.0, 65535.0, 50)
    for method in ("thrust_from_pwm", "force_from_pwm"):
        np.testing.assert_allclose(getattr(nearly, method)(pwm), getattr(linear, method)(pwm), rtol=1e-10)
    np.testing.assert_allclose(nearly.pwm_from_thrust([5.0, 12.0]), linear.pwm_from_thrust([5.0, 12.0]), rtol=1e-10)
    assert nearly.thrust_max == pytest.approx(linear.thrust_max, rel=1e-10)


def test_a_drone_whose_bent_thrust_map_does_not_reach_its_weight_is_refused() -> None:
    with pytest.raises(FlatsatError, match="all that the motors lift"):
        replace(profile(), force_max=0.3, thrust_slope=1.5)  # 0.3 N (60000 / 65535)^1.5 lift 26.8 g


def test_intervals_are_read_and_those_left_out_are_not_known(tmp_path: Path) -> None:
    document = yaml.safe_load((VEHICLES / "cf21.yaml").read_text())
    (path := tmp_path / "known.yaml").write_text(
        yaml.safe_dump(document | {"intervals": {"damping": [0.4, 1], "lag_and_delay": [0.1, 0.2]}})
    )
    known = VehicleProfile.load(path).intervals
    assert known == Intervals(damping=(0.4, 1.0), lag_and_delay=(0.1, 0.2))
    assert known.drag_z is None
    assert profile().intervals is None


@pytest.mark.parametrize("name", NAMES)
def test_lag_is_the_slowest_of_attitude_and_thrust(name: str) -> None:
    dynamics = profile(name).dynamics
    mean_delay = 2.0 * dynamics.attitude.damping / dynamics.attitude.natural_frequency
    assert profile(name).lag == max(mean_delay, dynamics.thrust_lag_up, dynamics.thrust_lag_down)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"colour": "red"}, "colour"),
        ({"mass": None}, "number"),
        ({"mass": True}, "number"),
        ({"mass": "1e-3"}, "1.0e-3"),
        ({"mass": -0.03}, "mass"),
        ({"mass": float("nan")}, "mass"),
        ({"mass": 31.8}, "all that the motors lift"),
        ({"name": 7}, "str"),
        ({"pwm_max": 70000}, "65535"),
        ({"dynamics": 1.0}, "mapping"),
        ({"motors.bits": 8.0}, "int"),
        ({"motors.bits": 17}, "1 to 16"),
        ({"motors.idle_pwm": 1e6}, "65535"),
        ({"motors.force_min": -0.1}, "force_min"),
        ({"dynamics.attitude.actuator_lag": -0.1}, "actuator_lag"),
        ({"motors.arming_required": "no"}, "bool"),
        ({"motors.voltage_to_force": [0.0, 1.0]}, "list of 4"),
        ({"motors.voltage_to_force": [0.0, 0.1, -0.1, 0.01]}, "increases"),
        ({"dynamics.attitude.actuator_lag": 0.2}, "stable"),
        ({"dynamics.attitude.damping": 0.0}, "damping"),
        ({"dynamics.attitude.integral_zero": 0.4}, "integral_pole = 0.0 rad/s: must be above 0 with integral_zero"),
        ({"dynamics.yaw.actuator_lag": 5e-300}, "actuator_lag = 5e-300 s: must be 0, or a number from 1e-12 to"),
        ({"dynamics.drag_z": 1e-300}, "drag_z = 1e-300 1/s: must be 0, or a number from 1e-12 to"),
        ({"dynamics.dead_time": 1e300}, r"dead_time = 1e\+300 s: must be 0, or a number from"),
        (
            {"motors.voltage_to_force": [0.0, 0.1, 0.0, 2e-181]},
            "voltage_to_force.3. = 2e-181 N/V.3: must be a number above 0",
        ),
        ({"dynamics.attitude.integral_pole": 0.4}, "integral_pole = 0.4 rad/s: must be .* 0 without"),
        ({"dynamics.thrust_lag_up": 0.0}, "thrust_lag_up"),
        ({"dynamics.drag_z": -1.0}, "drag_z"),
        ({"dynamics.velocity_tilt": 1.1}, "velocity_tilt = 1.1 rad s/m: must be a number from -1 to 1"),
        ({"thrust_slope": 0.2}, "thrust_slope = 0.2: must be a number from 0.25 to 4"),
        ({"thrust_voltage": 4.1}, "thrust_voltage = 4.1: must be a number from -4 to 4"),
        ({"voltage": 0.0}, "voltage = 0.0 V: must be a number above 0"),
        ({"thrust_slope": "steep"}, "thrust_slope = 'steep': must be a number"),
        ({"intervals": None}, "intervals = None: must be a mapping"),
        ({"intervals": {"colour": [0.0, 1.0]}}, "colour"),
        ({"intervals": {"damping": [0.5]}}, "intervals.damping = .0.5.: must be a list of 2 numbers"),
        ({"intervals": {"damping": [0.6, 0.5]}}, "damping = .0.6, 0.5.: must be an interval, the smaller end first"),
        ({"intervals": {"drag_xy": [0.1, float("inf")]}}, "drag_xy = inf 1/s: must be a number"),
        ({"battery.critical_voltage": 3.5}, "low_voltage"),
        ({"battery.landing_voltage": 2.9}, "landing_voltage = 2.9 V: must be at least critical_voltage, 3.0 V"),
        ({"battery.warning_voltage": 3.2}, "warning_voltage = 3.2 V: must be above landing_voltage, 3.2 V"),
        ({"battery.landing_voltage": -3.2}, "landing_voltage = -3.2 V: must be 0, or a number from"),
        ({"battery.landing_voltage": float("nan")}, "landing_voltage = nan V: must be 0, or a number from"),
    ],
)
def test_a_wrong_profile_is_refused_by_name(change: dict[str, object], complaint: str, tmp_path: Path) -> None:
    document = yaml.safe_load((VEHICLES / "cf21.yaml").read_text())
    for dotted, value in change.items():
        *sections, key = dotted.split(".")
        target = document
        for section in sections:
            target = target[section]
        target[key] = value
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(FlatsatError, match=complaint) as refusal:
        VehicleProfile.load(path)
    assert str(path) in str(refusal.value)


def test_a_missing_key_is_refused(tmp_path: Path) -> None:
    document = yaml.safe_load((VEHICLES / "cf21.yaml").read_text())
    del document["dynamics"]["drag_z"]
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(FlatsatError, match="drag_z"):
        VehicleProfile.load(path)


@pytest.mark.parametrize("name", NAMES)
def test_a_profile_without_voltages_of_the_controller_lands_where_the_firmware_warns(name: str, tmp_path: Path) -> None:
    document = yaml.safe_load((VEHICLES / f"{name}.yaml").read_text())
    shipped = profile(name).battery
    assert shipped.critical_voltage < shipped.low_voltage == shipped.landing_voltage < shipped.warning_voltage
    for key in ("landing_voltage", "warning_voltage"):
        del document["battery"][key]
        (path := tmp_path / f"{key}.yaml").write_text(yaml.safe_dump(document))
        limits = VehicleProfile.load(path).battery
        assert limits.landing_voltage == document["battery"]["low_voltage"]
        assert limits.warning_voltage == pytest.approx(limits.landing_voltage + 0.1)


@pytest.mark.parametrize("text", ["", "- 1\n", "{", "\x80"])
def test_what_is_no_profile_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(FlatsatError):
        VehicleProfile.load(path)


def test_the_light_drone_is_the_one_with_markers_with_less_to_carry() -> None:
    heavy, light = profile("cf21_markers"), profile("cf21_markers_light")
    share = heavy.mass / light.mass
    assert (light.force_max, light.thrust_slope, light.pwm_max) == (heavy.force_max, heavy.thrust_slope, heavy.pwm_max)
    scaled = {name: getattr(heavy.dynamics, name) * share for name in ("drag_xy", "drag_z", "velocity_tilt")}
    rounded = {name: float(f"{value:.3g}") for name, value in scaled.items()}
    assert light.dynamics == replace(heavy.dynamics, **rounded)
