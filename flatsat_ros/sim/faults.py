"""What goes wrong between a fleet and its pilot: faults of motion capture, of clocks and of the radio link.

A `FaultyLink` takes the place of the fleet in `fly`. Its faults are functions, applied one after the other in the order
in which they were put in:

    fleet -> pose faults -> pilot -> command faults -> fleet

A pose fault gets the time (s) and the samples that arrive, and returns those that arrive instead. A
command fault gets the time, a drone and its set-point, and returns what is sent instead, each with the delay, s, after
which it leaves. Both may keep a memory, so each is made anew for every flight.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode
from flatsat_ros.sim.dynamics import STEP
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import Sample

PoseFault = Callable[[float, list[Sample]], list[Sample]]
CommandFault = Callable[[float, int, WireSetpoint], Sequence[tuple[float, WireSetpoint]]]

# poses that wait for a pilot that does not come to read them: the depth of the pose subscription's queue
_QUEUE = 10


class FaultyLink:
    """A fleet as its pilot sees and reaches it.

    Attributes:
        fleet: what is flown.
        poses: the pose faults in force.
        commands: the command faults in force.
    """

    def __init__(
        self,
        fleet: SimulatedFleet,
        look: Callable[[], None] = lambda: None,
        read: Callable[[list[Sample]], list[Sample]] = lambda samples: samples,
    ) -> None:
        """Begin without faults.

        Args:
            fleet: what is flown.
            look: called after every STEP of the fleet.
            read: what the pilot's process makes of the samples that arrive there.
        """
        self.fleet = fleet
        self.poses: list[PoseFault] = []
        self.commands: list[CommandFault] = []
        self._look, self._read = look, read
        self._numbers = itertools.count()  # so that set-points of the same time keep their order
        self._under_way: list[tuple[float, int, int, WireSetpoint]] = []
        self._now = 0.0

    @property
    def count(self) -> int:
        """Number of drones, N."""
        return self.fleet.count

    @property
    def yaw_mode(self) -> YawMode:
        """What the yaw of a set-point means."""
        return self.fleet.yaw_mode

    def advance_to(self, time: float) -> None:
        """Let the fleet fly to a time, s; set-points leave at the first STEP when they are due."""
        self._now = time
        while self.fleet.time + STEP <= time + 1e-3 * STEP:
            self.fleet.advance_to(self.fleet.time + STEP)
            while self._under_way and self._under_way[0][0] <= self.fleet.time:
                _, _, index, setpoint = heapq.heappop(self._under_way)
                self.fleet.command(index, *setpoint)
            self._look()

    def measurements(self, time: float) -> list[Sample]:
        """Return what arrives at the pilot until a time, s: at most the newest ten poses of a drone."""
        samples = self.fleet.measurements(time)
        for fault in self.poses:
            samples = fault(time, samples)
        kept: list[deque[int]] = [deque(maxlen=_QUEUE) for _ in range(self.count)]
        for number, sample in enumerate(samples):
            kept[sample.drone].append(number)
        return self._read([samples[number] for number in sorted(itertools.chain.from_iterable(kept))])

    def command(self, index: int, roll: float, pitch: float, yaw: float, thrust_pwm: float) -> None:
        """Send a set-point, see `Uplink.command`."""
        setpoints: list[tuple[float, WireSetpoint]] = [(0.0, WireSetpoint(roll, pitch, yaw, thrust_pwm))]
        for fault in self.commands:
            setpoints = [
                (delay + more, changed)
                for delay, setpoint in setpoints
                for more, changed in fault(self._now, index, setpoint)
            ]
        for delay, setpoint in setpoints:
            if delay <= 0.0:
                self.fleet.command(index, *setpoint)
            else:
                heapq.heappush(self._under_way, (self._now + delay, next(self._numbers), index, setpoint))


def of_drones(fault: PoseFault, *drones: int) -> PoseFault:
    """Return the fault for some drones only; the others' samples arrive as they are, before those."""

    def apply(time: float, samples: list[Sample]) -> list[Sample]:
        others = [sample for sample in samples if sample.drone not in drones]
        return others + fault(time, [sample for sample in samples if sample.drone in drones])

    return apply


def changed(change: Callable[[Sample], Sample]) -> PoseFault:
    """Change every sample by itself."""
    return lambda _, samples: [change(sample) for sample in samples]


def lost(_time: float, _samples: list[Sample]) -> list[Sample]:
    """Lose every sample."""
    return []


def thinned(share: float, seed: int) -> PoseFault:
    """Lose a share of the samples, each independently of the others."""
    generator = np.random.default_rng(seed)
    return lambda _, samples: [sample for sample in samples if generator.random() >= share]


def slowed(rate: float) -> PoseFault:
    """Let the samples of each drone through at no more than a rate, Hz, evenly."""
    newest: dict[int, float] = {}

    def apply(_time: float, samples: list[Sample]) -> list[Sample]:
        kept = []
        for sample in samples:
            if sample.stamp - newest.get(sample.drone, -math.inf) >= 1.0 / rate - STEP:
                newest[sample.drone] = sample.stamp
                kept.append(sample)
        return kept

    return apply


def delayed(seconds: float) -> PoseFault:
    """Let samples arrive so much later than they do; their stamps stay."""
    waiting: deque[tuple[float, Sample]] = deque()

    def apply(time: float, samples: list[Sample]) -> list[Sample]:
        waiting.extend((time + seconds, sample) for sample in samples)
        arrived = []
        while waiting and waiting[0][0] <= time + STEP:
            arrived.append(waiting.popleft()[1])
        return arrived

    return apply


def moved(offset: Sequence[float]) -> PoseFault:
    """Shift positions by an offset (3,), m."""
    shift = np.array(offset)
    return changed(lambda sample: sample._replace(position=sample.position + shift))


def jumping(offset: Sequence[float], period: float) -> PoseFault:
    """Shift one sample of each drone in every period, s, by an offset (3,), m."""
    shift, latest = np.array(offset), dict[int, float]()

    def change(sample: Sample) -> Sample:
        if sample.stamp - latest.get(sample.drone, -math.inf) < period:
            return sample
        latest[sample.drone] = sample.stamp
        return sample._replace(position=sample.position + shift)

    return changed(change)


def doubled(offset: Sequence[float], burst: float, pause: float) -> PoseFault:
    """Add a second source that sees the drones shifted by an offset (3,), m: for a burst, s, after every pause, s.

    Its samples are stamped half a millisecond after those of the first.
    """
    shift = np.array(offset)

    def apply(time: float, samples: list[Sample]) -> list[Sample]:
        if math.fmod(time, burst + pause) < pause:
            return samples
        pairs = ((s, s._replace(stamp=s.stamp + 5e-4, position=s.position + shift)) for s in samples)
        return list(itertools.chain.from_iterable(pairs))

    return apply


def noisy(deviation: float, seed: int) -> PoseFault:
    """Add noise of a standard deviation, m, to every coordinate."""
    generator = np.random.default_rng(seed)
    return changed(lambda sample: sample._replace(position=sample.position + deviation * generator.standard_normal(3)))


def scaled(factor: float) -> PoseFault:
    """Multiply positions by a factor, as a wrong unit does."""
    return changed(lambda sample: sample._replace(position=factor * sample.position))


def without_position() -> PoseFault:
    """Replace positions by NaN."""
    return changed(lambda sample: sample._replace(position=np.full(3, np.nan)))


def without_orientation() -> PoseFault:
    """Replace orientations by NaN."""
    return changed(lambda sample: sample._replace(quaternion=np.full(4, np.nan)))


def zeroed() -> PoseFault:
    """Report position 0 and quaternion 0, as some systems do of a body that they do not see."""
    return changed(lambda sample: sample._replace(position=np.zeros(3), quaternion=np.zeros(4)))


def repeated() -> PoseFault:
    """Report each drone's last pose over and over, with fresh stamps."""
    seen: dict[int, Sample] = {}

    def change(sample: Sample) -> Sample:
        return seen.setdefault(sample.drone, sample)._replace(stamp=sample.stamp)

    return changed(change)


def frozen(axis: int, seed: int = 0, noise: float = 0.0) -> PoseFault:
    """Report one coordinate of each drone as it was at first, or with noise of a standard deviation, m, about that."""
    generator, kept = np.random.default_rng(seed), dict[int, float]()

    def change(sample: Sample) -> Sample:
        position = sample.position.copy()
        position[axis] = kept.setdefault(sample.drone, float(position[axis])) + noise * generator.standard_normal()
        return sample._replace(position=position)

    return changed(change)


def rounded(step: float) -> PoseFault:
    """Round positions to whole steps, m."""
    return changed(lambda sample: sample._replace(position=step * np.round(sample.position / step)))


def mirrored(axis: int) -> PoseFault:
    """Report one coordinate with the other sign."""
    sign = np.where(np.arange(3) == axis, -1.0, 1.0)
    return changed(lambda sample: sample._replace(position=sign * sample.position))


def exchanged(first: int, second: int) -> PoseFault:
    """Report each of two drones under the other's name."""
    other = {first: second, second: first}
    return changed(lambda sample: sample._replace(drone=other.get(sample.drone, sample.drone)))


def turned(angle: float) -> PoseFault:
    """Report orientations that are turned counter-clockwise about the body's z by an angle, rad."""
    sin, cos = math.sin(angle / 2.0), math.cos(angle / 2.0)

    def change(sample: Sample) -> Sample:
        x, y, z, w = sample.quaternion
        return sample._replace(
            quaternion=np.array([cos * x + sin * y, cos * y - sin * x, cos * z + sin * w, cos * w - sin * z])
        )

    return changed(change)


def y_up() -> PoseFault:
    """Report in a frame whose y points up and whose z points where -y pointed: (x, y, z) becomes (x, z, -y)."""

    def turn(vector: FloatArray) -> FloatArray:
        return np.array([vector[0], vector[2], -vector[1]])

    def change(sample: Sample) -> Sample:
        return sample._replace(
            position=turn(sample.position), quaternion=np.append(turn(sample.quaternion[:3]), sample.quaternion[3])
        )

    return changed(change)


def restamped(shift: float) -> PoseFault:
    """Add a shift, s, to every stamp."""
    return changed(lambda sample: sample._replace(stamp=sample.stamp + shift))


def stamped(stamp: float) -> PoseFault:
    """Give every sample the same stamp, s."""
    return changed(lambda sample: sample._replace(stamp=stamp))


def commands_lost(share: float, seed: int, *drones: int) -> CommandFault:
    """Lose a share of the set-points of some drones, each independently of the others."""
    generator = np.random.default_rng(seed)
    return lambda _, index, setpoint: [(0.0, setpoint)] if index not in drones or generator.random() >= share else []


def commands_delayed(seconds: float, *drones: int) -> CommandFault:
    """Send the set-points of some drones so much later, s."""
    return lambda _, index, setpoint: [(seconds if index in drones else 0.0, setpoint)]


def pitch_negated(*drones: int) -> CommandFault:
    """Send the set-points of some drones as the other of crazyswarm2's back ends would take them."""
    return lambda _, index, setpoint: [(0.0, setpoint._replace(pitch=-setpoint.pitch) if index in drones else setpoint)]


def roll_uncontrolled(*drones: int) -> CommandFault:
    """Take the control of the roll axis from some drones, as a broken propeller does: they tumble."""
    return lambda _, index, setpoint: [(0.0, setpoint._replace(roll=math.nan) if index in drones else setpoint)]
