"""What of a flight log can be used: faults are masked and counted, wrong units and signs refused, the rest resampled.

Faults of the on-board columns of real logs are lines that connect far samples (a block of the log that arrived late or
not at all, and was interpolated or extrapolated) and numbers that no command can have; of motion capture, poses that
stand still while the drone flies, jumps and gaps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.crazyflie.vehicle import PWM_FULL
from flatsat_ros.identification.log import FlightLog

BoolArray = NDArray[np.bool_]

STEP = 0.01  # s, of the grid that logs are resampled to
_ROUNDING = 1e-6  # s, by which a stamp may be after the point of the grid that it belongs to
SHORTEST = 5.0  # s of usable flight
LONGEST = 3600.0  # s of a log
_STRAIGHT = 5  # samples of a command on one line that is not level: more are damage
_LEVEL = 1e-3  # relative change of the slope up to which samples are on one line
_FROZEN = 0.1  # s for which a pose may stay the same to the last digit in flight
_GAP = 0.05  # s between poses over which they are not interpolated
_SPEED = 8.0  # m/s, above which a pose has jumped
_TORN = 0.2  # s around a jump in which the velocity is not to be had from the poses
_SETTLING = 0.6  # s after a fault of the commands during which the attitude still answers to it
_HEIGHT = 0.15  # m above the ground from which the drone flies, out of the ground effect of take-off
_MARGIN = 0.3  # s left out at each end of a flight
_DENSE = 0.025  # s between poses, up to which the motion is nothing to third differences
_EXCITED = math.radians(0.5)  # rad, standard deviation of the commands from which their response can be compared


@dataclass(frozen=True, eq=False)
class Samples:
    """One flight on a grid of STEP.

    Attributes:
        name: of the log.
        position: (M, 3) m, interpolated.
        angles: (M, 3) roll, pitch, yaw of the markers, rad, interpolated, yaw without jumps.
        command: (M, 3) roll and pitch, rad, and thrust, PWM, held.
        voltage: (M,) V, smoothed over 1 s; empty where it is not known.
        poses_good: (M,) whether position and angles are measured, in flight.
        commands_good: (M,) whether the commands are those sent, now and for _SETTLING before.
        noise: (K, 3) third differences of measured positions in flight, which are noise but for a factor, as large as
            the noise of one position, m; none where poses come too seldom for that.
        faults: what was masked, by name, in rows of the log, in the order found.
        notes: what is to be said, one line each.
    """

    name: str
    position: FloatArray
    angles: FloatArray
    command: FloatArray
    voltage: FloatArray
    poses_good: BoolArray
    commands_good: BoolArray
    noise: FloatArray
    faults: Mapping[str, int]
    notes: tuple[str, ...] = ()

    @property
    def usable(self) -> BoolArray:
        """Whether a sample (M,) is measured and commanded."""
        return self.poses_good & self.commands_good

    @property
    def pose_noise(self) -> float:
        """Standard deviation of the bulk of the noise of a measured coordinate, m; NaN: not told."""
        squares = self.noise**2
        return float(np.sqrt(np.mean(np.median(squares, axis=0)) / 0.4549)) if len(squares) else math.nan

    @property
    def mean_voltage(self) -> float:
        """Mean of the battery's voltage where the flight is usable, V; NaN: not known."""
        return float(np.mean(self.voltage[self.usable])) if len(self.voltage) else math.nan

    @property
    def seconds(self) -> float:
        """Usable time, s."""
        return float(np.count_nonzero(self.usable)) * STEP


@np.errstate(invalid="ignore", over="ignore")  # what is not finite is masked
def screen(log: FlightLog) -> Samples:
    """Mask what is wrong in a log, and put the rest on a grid.

    Raises:
        FlatsatError: less than SHORTEST of the flight is usable, most rows are out of order, or most poses jump; or a
            set-point seems to be in the wrong unit or to have the wrong sign, by the attitude that answers.
    """
    faults: dict[str, int] = {"damaged": log.damaged}
    poses, commands = _increasing(log.pose_time), _increasing(log.command_time)
    faults["duplicated or out of order"] = max(_left(poses), _left(commands))
    for what, times in (("poses", log.pose_time), ("commands", log.command_time)):
        early = int((times < np.maximum.accumulate(times)).sum())
        if 2 * early > len(times):
            raise FlatsatError(
                f"{log.name}: {early} of {len(times)} {what} are earlier than one before: must be in the order of time"
            )
    time, position, angles = log.pose_time[poses], log.position[poses], log.angles[poses].copy()
    sent, command = log.command_time[commands], log.command[commands]

    missing = ~np.isfinite(position).all(axis=1)
    faults["without a position"] = int(missing.sum())
    frozen = _frozen(time, position) & ~missing
    faults["with a pose that stands still"] = int(frozen.sum())
    jumped = _jumped(time, position)
    faults["with a pose that jumps"] = int(jumped.sum())
    if 2 * faults["with a pose that jumps"] > len(time):
        raise FlatsatError(
            f"{log.name}: {faults['with a pose that jumps']} of {len(time)} poses are faster than {_SPEED:g} m/s: "
            "must have positions in m; of others a column map says the unit"
        )
    bad = ~np.isfinite(command).all(axis=1) | (np.abs(command[:, :2]) > math.pi / 2).any(axis=1)
    bad |= ~((command[:, 2] >= 0.0) & (command[:, 2] <= PWM_FULL))
    faults["with an impossible command"] = int(bad.sum())
    straight, connected = _straight(sent, command)
    faults["with commands on a straight line"] = int((straight & ~bad).sum())
    bad |= straight

    if bad.all() or not np.ptp(command[~bad, 2]) > 0.0:
        raise FlatsatError(
            f"{log.name}: the commanded thrust never changes: the commands of this flight were not logged, must be"
        )
    begin, end = max(time[0], sent[0]), min(time[-1], sent[-1])
    if not end - begin <= LONGEST:
        raise refusal(f"{log.name}: duration", end - begin, "s", f"at most {LONGEST:g} s")
    grid = np.arange(begin, end, STEP)
    if len(grid) < SHORTEST / STEP:
        raise FlatsatError(f"{log.name}: poses and commands have less than {SHORTEST} s in common")
    if not np.isfinite(angles).all(axis=1).any():
        raise FlatsatError(f"{log.name}: it has no orientation: must have poses with roll, pitch and yaw")
    good = ~(missing | jumped)
    angles[:, 2] = _unwrapped(angles[:, 2])
    placed = _interpolated(grid, time[good], position[good])
    turned = _interpolated(grid, time[good], angles[good])
    spacing = _spacing(grid, time[good])
    held = np.searchsorted(sent, grid + _ROUNDING, side="right") - 1
    flying = _flying(placed[:, 2], np.where(bad, np.nan, command[:, 2])[held])
    torn = _at(grid, time, jumped) | _at(grid, time, np.append(jumped[1:], False))
    torn = _spread(torn, _TORN) | _spread(torn[::-1], _TORN)[::-1]
    poses_good = flying & ~torn & (spacing <= _GAP) & np.isfinite(turned).all(axis=1) & ~_at(grid, time, frozen)
    unknown = bad[held]
    unknown[0] = True  # what was commanded before
    commands_good = ~_spread(unknown, _SETTLING)
    level = _interpolated(grid, log.voltage_time, log.voltage[:, None])[:, 0] if _reads(log) else np.empty(0)
    notes = []
    if connected > 0.05:
        notes.append(f"{connected:.0%} of the commands were interpolated between others before they came here")
    samples = Samples(
        log.name,
        placed,
        turned,
        np.nan_to_num(command[held]),
        _smoothed(level),
        poses_good,
        commands_good,
        position_noise(time, position, good & _at(time, grid, flying)),
        {name: count for name, count in faults.items() if count},
        tuple(notes),
    )
    if samples.seconds < SHORTEST:
        counted = ", ".join(f"{count} rows {name}" for name, count in samples.faults.items()) or "no faults"
        raise FlatsatError(
            f"{log.name}: only {samples.seconds:.1f} s of flight are usable ({counted}): must be at least {SHORTEST} s"
        )
    _check_units(samples)
    return samples


def smooth_velocity(position: FloatArray) -> FloatArray:
    """Return the velocity (M, 3), m/s, of positions (M, 3) on the grid: the slope of a cubic through 0.3 s."""
    return np.asarray(savgol_filter(position, 31, 3, deriv=1, delta=STEP, axis=0))


def _increasing(time: FloatArray) -> NDArray[np.intp]:
    """Return the indices of the samples whose time is later than all before."""
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], time[:-1]]))
    return np.flatnonzero(time > latest)


def position_noise(time: FloatArray, position: FloatArray, use: BoolArray) -> FloatArray:
    """Return third differences of evenly spaced positions, for which what moves is at rest, over sqrt(20).

    Args:
        time: (M,) s.
        position: (M, 3) m.
        use: (M,) which may be used.

    Returns:
        (K, 3) m, as large as the noise of one position; none if poses come less often than each _DENSE.
    """
    interval = float(np.median(np.diff(time)))
    even = np.abs(np.diff(time) - interval) < 0.1 * interval
    good = even[2:] & even[1:-1] & even[:-2] & use[3:] & use[2:-1] & use[1:-2] & use[:-3]
    return np.asarray(np.diff(position, 3, axis=0)[good & (interval <= _DENSE)] / math.sqrt(20.0))


def _left(kept: NDArray[np.intp]) -> int:
    return int(kept[-1]) + 1 - len(kept)


def _frozen(time: FloatArray, position: FloatArray) -> BoolArray:
    """Return which poses (M,) belong to a run of equal ones that lasts longer than _FROZEN."""
    same = np.concatenate([[False], (np.diff(position, axis=0) == 0.0).all(axis=1)])
    begin = np.maximum.accumulate(np.where(same, 0, np.arange(len(same))))
    lasting = np.zeros(len(same), dtype=np.bool_)
    np.logical_or.at(lasting, begin, time - time[begin] > _FROZEN)
    frozen: BoolArray = lasting[begin]
    return frozen


def _jumped(time: FloatArray, position: FloatArray) -> BoolArray:
    """Return which poses (M,) are not to be reached from the one before or to the one behind at _SPEED."""
    fast = np.linalg.norm(np.diff(position, axis=0), axis=1) > _SPEED * np.diff(time) + 0.01
    return np.asarray(np.concatenate([[False], fast]) | np.concatenate([fast, [False]]))


def _straight(time: FloatArray, command: FloatArray) -> tuple[BoolArray, float]:
    """Return which commands (M,) are on a long line that is not level, and the share that connects two others."""
    slope = np.diff(command, axis=0) / np.diff(time)[:, None]
    even = np.abs(np.diff(slope, axis=0)) <= _LEVEL * np.abs(slope[1:])
    even &= slope[1:] != 0.0
    result = np.zeros(len(command), dtype=bool)
    for axis in even.T:
        ends = np.flatnonzero(np.diff(np.concatenate([[False], axis, [False]]).astype(int)))
        for begin, end in ends.reshape(-1, 2):  # samples begin + 1 to end are between two of the same line
            if end - begin > _STRAIGHT:
                result[begin : end + 2] = True
    return result, float(even.all(axis=1).mean()) if len(even) else 0.0


def _interpolated(grid: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(grid, time, column) for column in values.T], axis=-1)


def _spacing(grid: FloatArray, time: FloatArray) -> FloatArray:
    """Return the time between the measurements around each point of the grid, s; infinite outside them."""
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    return np.where((grid < time[0]) | (grid > time[-1]), np.inf, time[after] - time[after - 1])


def _at(grid: FloatArray, time: FloatArray, flags: BoolArray) -> BoolArray:
    """Return the flags of the measurements at or before the points of the grid."""
    return np.asarray(flags[np.clip(np.searchsorted(time, grid + _ROUNDING, side="right") - 1, 0, len(time) - 1)])


def _spread(flags: BoolArray, seconds: float) -> BoolArray:
    """Return whether a flag was set now or within some time before."""
    last = np.maximum.accumulate(np.where(flags, np.arange(len(flags)), -(10**9)))
    return np.asarray(np.arange(len(flags)) - last <= round(seconds / STEP))


def _unwrapped(yaw: FloatArray) -> FloatArray:
    """Return yaw without jumps by a turn; NaN stays."""
    result, finite = yaw.copy(), np.isfinite(yaw)
    result[finite] = np.unwrap(yaw[finite])
    return result


def _flying(height: FloatArray, thrust: FloatArray) -> BoolArray:
    """Return where (M,) the drone flies: clear of the ground it stood on without thrust (NaN: not known), or always."""
    off = thrust < 0.1 * np.nanmax(thrust)
    if not off.any():
        return np.ones(len(height), dtype=bool)
    aloft = ~off & (height > np.median(height[off]) + _HEIGHT)
    return np.asarray(~_spread(~aloft, _MARGIN) & ~_spread(~aloft[::-1], _MARGIN)[::-1])


def _reads(log: FlightLog) -> bool:
    return len(log.voltage) > 0 and bool(np.isfinite(log.voltage).all())


def _smoothed(voltage: FloatArray) -> FloatArray:
    """Return the mean of a second around each sample."""
    if len(voltage) == 0:
        return voltage
    half = min(50, (len(voltage) - 1) // 2)
    total = np.cumsum(np.concatenate([[0.0], np.pad(voltage, half, mode="edge")]))
    return np.asarray((total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1))


def _check_units(samples: Samples) -> None:
    """Refuse set-points that the attitude answers to with the wrong sign, or 57 times too much or too little."""
    delay = round(0.1 / STEP)
    for axis, name in enumerate(("roll", "pitch")):
        use = samples.usable[delay:]
        asked, got = samples.command[:-delay, axis][use], samples.angles[delay:, axis][use]
        asked, got = asked - asked.mean(), got - got.mean()
        spread = float(asked.std())
        correlation = float(np.mean(asked * got)) / max(spread * float(got.std()), 1e-12)
        ratio = float(got.std()) / max(spread, 1e-12)
        if float(got.std()) < _EXCITED or abs(correlation) < 0.5:
            continue
        if correlation < 0.0:
            raise FlatsatError(
                f"{samples.name}: {name} answers with the opposite sign (correlation {correlation:.2f}): the sign of "
                f"{name} or {name}_setpoint in the column map is wrong"
            )
        if not 0.2 < ratio < 5.0:
            raise FlatsatError(
                f"{samples.name}: {name} moves {ratio:.3g} times as much as its set-point: one of them is in degrees "
                "and read as radians, or the other way round"
            )
