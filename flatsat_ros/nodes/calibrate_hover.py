"""Measures in flight what the motors really lift and writes it to a vehicle profile."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from std_msgs.msg import Float64MultiArray
from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.base.files import check_writable, user_path
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml, write_yaml
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.identification.hover import thrust_scale
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare, declare_robot_name, require_known_parameters
from flatsat_ros.nodes.ros.runtime import ProgramNode, run

_SILENCE = 5.0  # s without telemetry after which it gives up


class CalibrateHover(ProgramNode):
    """Watches the telemetry of one hovering drone for a while.

    Attributes:
        done: whether it is over.
        exit_code: 0 when the profile was written.
    """

    def __init__(self) -> None:
        """Read the parameters, begin to listen."""
        super().__init__("calibrate_hover")
        self._robot = declare_robot_name(self, "the drone that hovers")
        vehicle = declare(self, "vehicle", "cf21", "profile that it flies with: packaged name or path of a YAML file")
        self._source = config_path(vehicle, "vehicles")
        output = declare(self, "output", "", "profile to write: path of a YAML file that does not exist yet")
        self._seconds = declare(self, "seconds", 10.0, "how long to measure", unit="s", bounds=(2.0, 600.0))
        self._gravity = declare(self, "gravity", GRAVITY, "as in the certificate", unit="m/s^2", bounds=(0.1, 100.0))
        require_known_parameters(self)
        if not output:
            raise FlatsatError("parameter output is empty: must be the path of a YAML file")
        self._output = user_path(output)
        check_writable(self._output)
        self._check_new()
        VehicleProfile.load(self._source)
        self.exit_code = 1
        self._rows: list[FloatArray] = []
        self._begin = self._heard = time.monotonic()
        self._bar = tqdm(
            total=self._seconds, unit="s", desc="hover", bar_format="{desc} {bar} {n:.1f}/{total:.1f} {unit}"
        )
        topic = interfaces.TELEMETRY
        self.create_subscription(topic.kind, topic.of(self._robot), self._on_telemetry, topic.subscribe)
        self.create_timer(0.5, self._on_timer)

    def finish(self) -> None:
        """Close the progress display."""
        self._bar.close()

    def _on_telemetry(self, message: Float64MultiArray) -> None:
        now = time.monotonic()
        if not self._rows:
            self._begin = now
        self._heard = now
        self._rows.append(messages.telemetry_from_message(message))
        elapsed = now - self._begin
        self._bar.update(min(elapsed, self._seconds) - self._bar.n)
        if elapsed >= self._seconds and not self.done:
            self._write()

    def _on_timer(self) -> None:
        silence = time.monotonic() - self._heard
        if silence > _SILENCE and not self.done:
            self._fail(f"no telemetry of {self._robot} for {silence:.0f} s: is the controller running?")

    def _check_new(self) -> None:
        if self._output.exists():
            raise refusal("parameter output", str(self._output), "", "a new file: this one exists already")

    def _require_profile(self) -> None:
        """Leave nothing behind that is no profile."""
        try:
            VehicleProfile.load(self._output)
        except FlatsatError:
            self._output.unlink()
            raise

    def _write(self) -> None:
        try:
            scale, error = thrust_scale(self._rows, self._gravity)
            content = read_yaml(self._source)
            content |= {"force_max": float(content["force_max"]) * scale, "name": self._output.stem}
            how = f"with force_max calibrated in a hover of {self._seconds:g} s: times {scale:.4f}"
            self._check_new()
            write_yaml(self._output, content, f"# {self._source.stem} {how}\n")
            self._require_profile()
        except FlatsatError as reason:
            self._fail(str(reason))
            return
        self._bar.close()
        print(
            f"{self._robot} lifts {scale:.4f} (standard error {error:.4f}) of what {self._source.stem} promises; "
            f"wrote {self._output}"
        )
        self.done, self.exit_code = True, 0

    def _fail(self, reason: str) -> None:
        self._bar.close()
        print(f"error: {reason}", file=sys.stderr)
        self.done = True


def main(argv: Sequence[str] | None = None) -> int:
    """Run the calibration."""
    return run(CalibrateHover, argv)


if __name__ == "__main__":
    sys.exit(main())
