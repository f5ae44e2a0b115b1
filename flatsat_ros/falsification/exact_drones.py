"""Drones that are exactly what a flight certificate says of them: linear plants between its bounds, in closed form.

Every drone has a plant of its own for x and y and one for z. A command acts after the delay, in the middle of a period
perhaps; the disturbance changes evenly within a period, and what is pushed in at the input is constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import exponential
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Plant, split

_CHANGING = ("lag", "frequency", "damping")


def draw_plants(random: np.random.Generator, box: PlantBox, count: int, *, lag_varies: bool) -> list[Plant]:
    """Draw plants of a box, most figures at an end of their interval and the others inside.

    Args:
        random: of the random numbers.
        box: the plants.
        count: how many.
        lag_varies: whether lag, frequency and damping change in flight; then the plants differ in nothing else.
    """
    same = random.integers(3, size=len(fields(Plant))), random.random(len(fields(Plant)))
    plants = []
    for _ in range(count):
        figures = {}
        choices = random.integers(3, size=len(fields(Plant))), random.random(len(fields(Plant)))
        for i, field in enumerate(fields(Plant)):
            where, inside = same if lag_varies and field.name not in _CHANGING else choices
            low, high = getattr(box.low, field.name), getattr(box.high, field.name)
            share = (0.0, 1.0, float(inside[i]))[int(where[i])]
            figures[field.name] = min(low + share * (high - low), high)
        plants.append(Plant(**figures))
    return plants


class ExactDrones:
    """N drones.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        middle: (N, 3) position in the middle of the last period, m.
        seen: (2, N, 3) position at the last tick and `age` seconds before it, m.
    """

    def __init__(self, kinds: Sequence[Sequence[Plant]], period: float, age: float, position: FloatArray) -> None:
        """Begin at rest, without commands.

        Args:
            kinds: plants for x and y, and for z.
            period: h, s.
            age: s, of the older of two positions that are seen; at most h.
            position: (N, 3) m.
        """
        count = len(position)
        self._maps = [np.array([_map(plant, period, age) for plant in plants]) for plants in kinds]
        self._whole = [np.array([split(plant.delay, period)[0] for plant in plants]) for plants in kinds]
        depth = max(int(whole.max()) for whole in self._whole) + 2
        self._commands = np.zeros((depth, count, 3))
        self._states = [np.zeros((count, maps.shape[1] - 2, 3)) for maps in self._maps]
        self.position, self.velocity = position.copy(), np.zeros_like(position)
        self.middle, self.seen = position.copy(), np.array([position, position])
        self.plants = np.zeros((2, count), dtype=int)

    def choose(self, plants: np.ndarray) -> None:
        """Take plants (2, N), numbers among those for x and y and for z, from now on."""
        self.plants = plants
        self._chosen = [maps[own] for maps, own in zip(self._maps, plants, strict=True)]
        every = np.arange(plants.shape[1])
        self._acting = [(whole[own], every) for whole, own in zip(self._whole, plants, strict=True)]

    def advance(self, command: FloatArray, push: FloatArray, rate: FloatArray, drive: FloatArray) -> None:
        """Move on by a period.

        Args:
            command: (N, 3) given at its beginning, m/s^2.
            push: (N, 3) disturbance there, m/s^2.
            rate: (N, 3) its change during the period, m/s^3.
            drive: (N, 3) added to the commands that act, m/s^2.
        """
        self._commands[1:] = self._commands[:-1]
        self._commands[0] = command
        middle, old = np.empty_like(self.position), np.empty_like(self.position)
        for axes, chosen, (whole, every), state in zip(
            (slice(0, 2), slice(2, 3)), self._chosen, self._acting, self._states, strict=True
        ):
            state[:, 0], state[:, 1] = self.position, self.velocity
            earlier, later = self._commands[whole + 1, every, axes], self._commands[whole, every, axes]
            acting = np.stack([earlier, later, drive[:, axes], push[:, axes], rate[:, axes]], axis=1)
            moved = chosen @ np.concatenate([state[..., axes], acting], axis=1)
            state[..., axes] = moved[:, :-2]
            middle[:, axes], old[:, axes] = moved[:, -2], moved[:, -1]
        self.position = np.concatenate([self._states[0][:, 0, :2], self._states[1][:, 0, 2:]], axis=1)
        self.velocity = np.concatenate([self._states[0][:, 1, :2], self._states[1][:, 1, 2:]], axis=1)
        self.middle, self.seen = middle, np.array([self.position, old])


def _map(plant: Plant, period: float, age: float) -> FloatArray:
    """Return rows (n + 2, n + 5): x after a period, its position in the middle, and that `age` before the end.

    They are on (x, command that acts until the rest of the delay is over, the one after it, drive, push, rate).
    """
    A, B, E = plant.system
    n = len(A)
    held = np.zeros((n + 4, n + 4))  # x, command, drive, push, rate
    held[:n, :n], held[:n, n], held[:n, n + 1], held[:n, n + 2] = A, plant.gain * B, plant.gain * B, E
    held[n + 2, n + 3] = 1.0
    begin, change = np.zeros((n + 4, n + 5)), np.eye(n + 4)
    begin[:n, :n], begin[n, n], begin[n + 1 :, n + 2 :] = np.eye(n), 1.0, np.eye(3)
    change[n, n] = 0.0
    after = np.zeros((n + 4, n + 5))
    after[n, n + 1] = 1.0
    rest = split(plant.delay, period)[1]

    def at(time: float) -> FloatArray:
        if time < rest:
            return np.asarray((exponential(held * time) @ begin)[:n])
        switched = change @ exponential(held * rest) @ begin + after
        return np.asarray((exponential(held * (time - rest)) @ switched)[:n])

    return np.concatenate([at(period), at(period / 2.0)[:1], at(period - age)[:1]])
