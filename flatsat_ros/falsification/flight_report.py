"""What attacks on a flight section came to, as text."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields
from itertools import islice

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.certificate.flight_tube import box_tube
from flatsat_ros.falsification.flight import PERIODS, AttackOutcome, section_of
from flatsat_ros.falsification.flight_claims import AXES, KINDS, Breach, Found
from flatsat_ros.falsification.worst_gains import worst_gains
from flatsat_ros.falsification.worst_inputs import SIGNALS, exact_bound

_SHOWN = 3  # breaches of each claim
_UNITS = {"position": (100.0, "cm"), "velocity": (1.0, "m/s"), "nominal": (1.0, "m/s^2"), "disturbance": (1.0, "m/s^2")}


@dataclass
class FlightTally:
    """What the batches so far came to.

    Attributes:
        runs: how many.
        batches: how many.
        best: the largest of each axis, signal and kind of run.
        breaches: one for each drone of which a claim failed.
        told: sum of the batches' shares of ticks with a claimed tube.
    """

    runs: int = 0
    batches: int = 0
    best: dict[tuple[int, int, int], Found] = field(default_factory=dict)
    breaches: list[Breach] = field(default_factory=list)
    told: float = 0.0

    def add(self, outcome: AttackOutcome) -> None:
        """Count one batch."""
        self.runs += outcome.runs
        self.batches += 1
        self.breaches += outcome.breaches
        self.told += outcome.told
        for one in outcome.found:
            key = one.axis, one.signal, one.kind
            if key not in self.best or one.ratio > self.best[key].ratio:
                self.best[key] = one

    def text(self, certificate: Certificate, name: str, seconds: float, thorough: bool) -> str:
        """Return the report.

        Args:
            certificate: that was attacked.
            name: by which it was given, a name or a path.
            seconds: that the runs took.
            thorough: with the tubes for gains that rest, whose proof takes seconds.
        """
        flight = section_of(certificate)
        rate = f"{self.runs / seconds:.0f} a second"
        told = f"told as claimed in {100.0 * self.told / max(self.batches, 1):.1f} % of the ticks"
        lines = [f"certificate {certificate.name!r}: {self.runs} runs of {PERIODS} periods in {seconds:.1f} s, {rate}"]
        lines += [f"tubes {told}", "", f"{'the largest found':<42}{'found':>9}{'claimed':>10}{'ratio':>7}{'exact':>8}"]
        for key in sorted(self.best, key=lambda key: (key[2], key[0], key[1])):
            one = self.best[key]
            factor, unit = _UNITS[SIGNALS[one.signal]]
            exact = f"{one.value / exact_at(certificate, one):8.3f}" if one.kind == 0 else ""
            signal = f"{KINDS[one.kind]}: {AXES[one.axis]} {SIGNALS[one.signal]}"
            claimed = factor * one.value / one.ratio
            lines.append(f"  {signal:<40}{factor * one.value:>9.4g}{claimed:>10.4g}{one.ratio:>7.3f}{exact}  {unit}")
        lines += ["exact: over what no input can exceed on this plant at this gain"]
        for axis, part in enumerate(flight.axes):
            found = self.best.get((axis, 0, 0))
            if found is not None and thorough:
                tube = box_tube(
                    part.design, part.box, part.cuts, found.gain, found.gain, flight.assumptions, part.lag_varies
                )
                lines.append(
                    f"{AXES[axis]} tube for gains that rest at {found.gain:.4g}: {100.0 * tube.position:.4g} cm, of "
                    f"which {found.value / tube.position:.3f} was found, at {_words(found.plant)}"
                )
        if thorough:
            for sides, part in zip(AXES, flight.axes, strict=True):
                worst = worst_gains(flight, part, min(flight.gain_max, certificate.gain_max))
                shares = (f"{100.0 * each:.4g} cm, {each / part.tube.position:.3f} of the tube" for each in worst[1:3])
                lines.append(
                    f"{sides} position at the worst corner, {_words(worst.plant)}: at most {next(shares)}, with the "
                    f"least gain held; {next(shares)}, with gains and ages of poses as a search finds them"
                )
        for claim, count in Counter(breach.claim for breach in self.breaches).most_common():
            lines += ["", f"VIOLATED by {count} drones: {claim}"]
            for breach in islice((one for one in self.breaches if one.claim == claim), _SHOWN):
                where = f"drone {breach.drone}, run {breach.run}, period {breach.period}"
                again = f"falsify {name} --seed {breach.seed} --runs 1"
                lines.append(f"  {breach.value:.6g} over {breach.bound:.6g}, {where}: {again}")
        if not self.breaches:
            lines += ["", "no claim failed"]
        return "\n".join(lines)


def exact_at(certificate: Certificate, one: Found) -> float:
    """Return the exact bound of a signal on the plant of a run whose gain rests, for poses of the worst age."""
    flight = section_of(certificate)
    ages = {0.0, min(flight.pose_age, certificate.period) / 2.0, min(flight.pose_age, certificate.period)}
    return max(
        float(exact_bound(flight.axes[one.axis], one.plant, one.gain, flight.assumptions, age, True)[one.signal])
        for age in ages
    )


def _words(plant: Plant) -> str:
    """Return the figures of a plant that are not 0."""
    return ", ".join(f"{f.name} {getattr(plant, f.name):.4g}" for f in fields(plant) if getattr(plant, f.name))
