"""The law in flight: the gains of N drones, when they restart, and who may adapt them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.law.controller import Controller, Memory, Output
from flatsat_ros.law.gain import Tuning


class Steering:
    """The law and what it remembers.

    Attributes:
        memory: the gains.
    """

    def __init__(self, certificate: Certificate, tuning: Tuning, count: int) -> None:
        """Begin with initial gains; tuning has one entry a drone or one for all."""
        self._certificate, self._count = certificate, count
        self._controller = Controller(certificate, self._spread(tuning))
        self.memory = self._controller.start()
        self._restarts = np.zeros(count, dtype=bool)  # a new reference may restart the gain

    def retune(self, tuning: Tuning) -> None:
        """Take a new tuning from the next step on. Gains stay where they are, below the new cap."""
        self._controller = controller = Controller(self._certificate, self._spread(tuning))
        self.memory = Memory(np.minimum(self.memory.gain, controller.tuning.gain_max))

    def note_reference(self, index: int) -> None:
        """Note that drone index has a new reference: if it is far, it restarts the gain."""
        self._restarts[index] = True

    def reset(self, *drones: int) -> None:
        """Set the gains of drones back to the initial ones."""
        if drones:
            gain = self.memory.gain.copy()
            gain[list(drones)] = self._controller.tuning.gain_initial[list(drones)]
            self.memory = Memory(gain)

    def step(
        self, state: FloatArray, yaw: FloatArray, base: FloatArray, flying: np.ndarray, adapting: np.ndarray
    ) -> Output:
        """Step the law; a new reference that is far restarts the gain first, and not all drones adapt theirs.

        Args:
            state: (N, 6) m, m/s.
            yaw: (N,) rad.
            base: (N, 9) reference, its acceleration without the disturbance that is compensated.
            flying: (N,) who is steered.
            adapting: (N,) who adapts its gain: of those none whose thrust is not known, which no gain makes up for.
        """
        tuning = self._controller.tuning
        memory, output = self._controller.step(self.memory, state, yaw, base)
        if any_of(self._restarts):
            anew = self._restarts & flying & tuning.restart & (output.lyapunov > tuning.threshold)
            if anew.any():
                self.memory = Memory(np.where(anew, tuning.gain_initial, self.memory.gain))
                memory, output = self._controller.step(self.memory, state, yaw, base)
            self._restarts &= ~flying
        if not all_of(adapting):
            memory = Memory(np.where(adapting, memory.gain, self.memory.gain))
        self.memory = memory
        return output

    def _spread(self, tuning: Tuning) -> Tuning:
        """Return the tuning with one entry a drone."""
        return Tuning(*(np.broadcast_to(getattr(tuning, entry.name), (self._count,)) for entry in fields(tuning)))
