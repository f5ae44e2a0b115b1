"""Ordinary flights: a sample of them raises no alarm, and one in which something is broken does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE
from flatsat_ros.falsification.ordinary.drawn import CERTIFICATES, Drawn, drawn
from flatsat_ros.falsification.ordinary.flight import Flown, OrdinaryFlight, Said
from flatsat_ros.falsification.ordinary.sayings import alarms

SECONDS = 1.0  # s, for which there is something to do: one thing


def small(seed: int) -> Drawn:
    return replace(drawn(seed, [DEFAULT_CERTIFICATE]), seconds=SECONDS)


@pytest.mark.parametrize("seed", [1, 2])
def test_of_an_ordinary_flight_nothing_is_said_but_what_is_true(seed: int) -> None:
    flight = small(seed)
    assert list(alarms(flight, OrdinaryFlight(flight).fly())) == []


def test_of_commands_that_come_too_late_something_is_said() -> None:
    flight = replace(small(1), delay=0.2)
    assert any("too late" in said.text for said in alarms(flight, OrdinaryFlight(flight).fly()))


def test_what_is_allowed_in_gusts_is_an_alarm_in_air_that_is_as_assumed() -> None:
    said = Said(20.0, 0, "tube not claimed: it is disturbed, 0.6 m/s^2, bound 0.5 m/s^2", "turn")
    flights = [drawn(seed, [DEFAULT_CERTIFICATE]) for seed in range(30)]
    assert {(flight.blows, flight.disturbs) for flight in flights} == {(False, False), (True, False), (True, True)}
    for flight in flights:
        found = list(alarms(flight, Flown(30.0, 0.1, [said], [], ["turn"])))
        assert found == ([] if flight.disturbs else [said])


def test_every_certificate_fits_what_is_drawn_for_it() -> None:
    """It is drawn inside the intervals, or `drawn` refuses it."""
    assert drawn(3, ["cf21_tight_10hz"]).certificate.period == 0.1
    assert {name.rpartition("hz")[1] for name in CERTIFICATES} == {"hz"}
