"""The certificate: the one file in which everything that makes the controller's answer trustworthy travels.

Synthesis writes it, `Certificate.verify` proves it again with numpy alone, and the controller loads nothing unverified.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal, require, require_fields, require_positive
from flatsat_ros.base.files import located
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml, write_yaml
from flatsat_ros.certificate import flight as flight_section
from flatsat_ros.certificate import form
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.form import symmetric_matrix
from flatsat_ros.certificate.inequalities import ideal_margins
from flatsat_ros.certificate.lyapunov import feedback_slope
from flatsat_ros.certificate.robust import Robust
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.certificate.sets import Sets
from flatsat_ros.certificate.verified import is_verified, remember
from flatsat_ros.law.input_set import InputSet

# What is flown and planned for by default: for the vehicle profile and the link that a controller takes by default, and
# what the flight layer's reactions to faults were flown with.
DEFAULT_CERTIFICATE = "cf21_adaptive_50hz"

# A failure that is smaller, relatively, is one of the rounding with which a figure was written down.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proved about one closed loop.

    Attributes:
        name: what the user calls it.
        limits: the input set V_c.
        rate: alpha, 1/s; in continuous time V' <= -alpha V on the invariant set for every gain gamma >= 1.
        block: (2, 2) symmetric block of P for x and for y; V in (m, m/s).
        ball: rho, m^2/s^4; the ball |v|^2 <= rho lies in V_c.
        level: eps; E = { V <= eps } is invariant and the constraints hold.
        period: h, s; the command is held constant in between.
        gain_min, gain_max: applied gains for which V does not increase at or between samples or, with a lag or a
            delay, the function of `loop` does not at samples.
        provenance: how the certificate was computed: package version, method, inputs, solver. Nothing reads it but
            people.
        block_vertical: (2, 2) block of P for z; None for the same as `block`.
        lag: tau, s, of the achieved acceleration.
        delay: d, s, from the command to its first effect.
        loop: (n, n) W for x and for y, see `certificate.sampled_loop`; None without lag and delay, where P serves.
        loop_vertical: (n, n) W for z; None for the same as `loop`.
        robust: what holds under disturbances, if anything is claimed.
        flight: what holds of the whole loop with estimator, predictor and compensation, if anything is claimed. The
            other claims are then of the predicted state, which knows neither lag nor delay.

    Raises:
        FlatsatError: a value is missing, of the wrong shape or not finite, or the flight section is of another loop.
            Inequalities are checked by `verify`.
    """

    name: str
    limits: InputSet
    rate: float
    block: FloatArray
    ball: float
    level: float
    period: float
    gain_min: float
    gain_max: float
    provenance: Mapping[str, Any] = field(default_factory=dict)
    block_vertical: FloatArray | None = None
    lag: float = 0.0
    delay: float = 0.0
    loop: FloatArray | None = None
    loop_vertical: FloatArray | None = None
    robust: Robust | None = None
    flight: FlightSection | None = None

    def __post_init__(self) -> None:
        units = {"rate": "1/s", "ball": "m^2/s^4", "level": "", "period": "s", "gain_min": "", "gain_max": ""}
        require_fields(self, require_positive, **units)
        timing = self.timing
        if timing.immediate and (self.loop is not None or self.loop_vertical is not None):
            raise FlatsatError(
                "loop is given, but neither lag nor delay: must be left out, P itself proves the gains then"
            )
        if not timing.immediate and self.loop is None:
            raise FlatsatError(f"loop is missing: must be given for lag = {timing.lag} s and delay = {timing.delay} s")
        sizes = {"block": 2, "block_vertical": 2, "loop": timing.size, "loop_vertical": timing.size}
        for name, size in sizes.items():
            if name == "block" or getattr(self, name) is not None:
                matrix = symmetric_matrix(name, getattr(self, name), size)
                matrix.setflags(write=False)
                object.__setattr__(self, name, matrix)
        if self.flight is not None:
            self._require_the_loop_of(self.flight)

    def _require_the_loop_of(self, flight: FlightSection) -> None:
        """Refuse a flight section whose law or period is another one."""
        if not self.timing.immediate:
            raise FlatsatError("lag, delay: must be 0 with a flight section, whose predictor takes care of them")
        period = flight.horizontal.design.period
        require(period == self.period, "period of the flight section", period, "s", f"{self.period:g}, that of the law")
        for axis, block in zip(flight.axes, self.blocks, strict=True):
            found, gains = (axis.design.stiffness, axis.design.rate), (float(block[0, 1]), float(block[1, 1]))
            require(found == gains, "stiffness and rate", found, "", f"{gains}, the lower row of the block of P")

    @property
    def blocks(self) -> tuple[FloatArray, FloatArray]:
        """The blocks of P: of x and of y, and of z."""
        return self.block, self.block if self.block_vertical is None else self.block_vertical

    @property
    def loops(self) -> tuple[FloatArray, FloatArray]:
        """The matrices whose quadratic forms never grow at samples, (n, n) for x and for y, and for z: W, else P."""
        if self.loop is None:
            return self.blocks
        return self.loop, self.loop if self.loop_vertical is None else self.loop_vertical

    @property
    def matrix(self) -> FloatArray:
        """The Lyapunov matrix P, (6, 6), for xi = (x, y, z, xdot, ydot, zdot)."""
        sides, upright = self.blocks
        matrix = np.kron(sides, np.diag([1.0, 1.0, 0.0])) + np.kron(upright, np.diag([0.0, 0.0, 1.0]))
        return np.asarray(matrix, dtype=np.float64)

    @cached_property
    def timing(self) -> Timing:
        """Period, lag and delay."""
        return Timing(self.period, self.lag, self.delay)

    @cached_property
    def sets(self) -> Sets:
        """The certified sets: of xi, and with a lag or a delay of z."""
        (sides, upright), (loop, loop_vertical) = self.blocks, self.loops
        return Sets(
            limits=self.limits,
            horizontal=loop,
            vertical=loop_vertical,
            slope_horizontal=feedback_slope(loop, sides),
            slope_vertical=feedback_slope(loop_vertical, upright),
            level=self.level,
            gain_min=self.gain_min,
            floor=self.robust.floor if self.robust is not None else 0.0,
        )

    def margins(self) -> dict[str, float]:
        """Return by how much, relatively, each inequality of the certificate holds; negative ones and NaN fail."""
        with np.errstate(all="ignore"):  # absurd figures overflow, which no inequality survives
            margins = ideal_margins(self)
            if self.flight is not None:
                margins |= self.flight.margins(self.limits, self.gain_max)
            return margins

    def verify(self) -> dict[str, float]:
        """Check every inequality: in rational arithmetic, those of the flight section in numbers rounded outwards.

        Returns:
            The relative margin of each inequality, at least 0.

        Raises:
            FlatsatError: an inequality does not hold; the text names it and by how much it fails.
        """
        margins = self.margins()
        self.check(margins)
        return margins

    def check(self, margins: Mapping[str, float]) -> None:
        """Refuse the certificate if one of its margins is too small.

        Raises:
            FlatsatError: as `verify`.
        """
        for name, margin in margins.items():
            if not margin >= 0.0 or ("is positive definite" in name and margin <= 0.0):
                rounded = -_ROUNDING <= margin <= 0.0
                again = ", or be claimed a little weaker: synthesize it again" if rounded else ""
                raise FlatsatError(
                    f"certificate {self.name!r}: '{name}' fails by {-margin:.6g} (relative): must hold{again}"
                )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Certificate:
        """Read a certificate and verify it, unless its content was verified on this machine before.

        Args:
            path: of a YAML file; `load_certificate` takes the names of packaged certificates too.

        Raises:
            FlatsatError: the file cannot be read, a key is unknown or missing, a value has the wrong shape or sign, or
                an inequality does not hold.
        """
        document = read_yaml(path)
        try:
            certificate = cls.from_document(document)
            if certificate.flight is None:
                certificate.verify()
            elif not is_verified(document):  # seconds, for which nobody wants to wait at every start
                certificate.verify()
                remember(document)
        except FlatsatError as error:
            raise located(path, error) from error
        return certificate

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Certificate:
        """Read a certificate of which nothing is proved.

        Args:
            path: of the file.

        Raises:
            FlatsatError: the file cannot be read, or its form is another.
        """
        document = read_yaml(path)
        try:
            return cls.from_document(document)
        except FlatsatError as error:
            raise located(path, error) from error

    @classmethod
    def from_document(cls, document: object) -> Certificate:
        """Build a certificate from the parsed YAML document, refusing whatever is not exactly its form."""
        figures, matrix = form.read(document)
        certificate = cls(**figures)
        difference = float(np.abs(matrix - certificate.matrix).max())
        if difference > 0.0:
            raise refusal("difference of lyapunov.matrix from that of its blocks", difference, "", "0")
        return certificate

    def to_document(self) -> dict[str, Any]:
        """Return the certificate as plain lists, numbers and strings, the form of the YAML file."""

        def plain(matrix: FloatArray | None) -> list[list[float]] | None:
            return None if matrix is None else matrix.tolist()

        loop = {"horizontal": plain(self.loop), "vertical": plain(self.loop_vertical)}
        values: dict[str, Any] = {
            "limits": {key: getattr(self.limits, key) for key in form.SCHEMA["limits"]},
            "lyapunov": {
                "rate": self.rate,
                "block": self.block.tolist(),
                "block_vertical": plain(self.block_vertical),
                "matrix": self.matrix.tolist(),
            },
            "invariant_set": {key: getattr(self, key) for key in form.SCHEMA["invariant_set"]},
            "sampling": {key: getattr(self, key) for key in form.SCHEMA["sampling"]},
            "loop": None if self.loop is None else loop,
            "robust": None if self.robust is None else self.robust.to_document(),
        }
        if self.flight is not None:
            values["flight"] = self.flight.to_document()
        version = form.FORMATS[self.flight is not None]
        return {"flatsat_certificate": version, "name": self.name, **values, "provenance": dict(self.provenance)}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Verify and write the certificate; the file is replaced in one step, never left half written.

        Args:
            path: of the YAML file, in a folder that exists.

        Raises:
            FlatsatError: an inequality does not hold, or the file cannot be written.
        """
        self.verify()
        header = form.HEADER if self.flight is None else form.HEADER + flight_section.HEADER
        write_yaml(path, self.to_document(), header)


def load_certificate(name_or_path: str | os.PathLike[str]) -> Certificate:
    """Read and verify a certificate that the package ships, by its name, or one of the user's own.

    Args:
        name_or_path: such as `cf21_50hz`, or a path; see `base.resources.config_path`.

    Raises:
        FlatsatError: there is none, the text lists the names that exist; or as `Certificate.load`.
    """
    return Certificate.load(config_path(name_or_path))
