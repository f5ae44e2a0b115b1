"""From wishes to the certificate that meets them: nominal, or robust where a disturbance is to be withstood."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.goals import rate_covering, robust_rate_covering, start_corners
from flatsat_ros.synthesis.nominal import synthesize
from flatsat_ros.synthesis.robust_design import synthesize_robust


@dataclass(frozen=True, eq=False)
class CertificateWishes:
    """What a certificate is asked for.

    Attributes:
        limits: the input set V_c.
        timing: period, lag and delay of the loop.
        rate: alpha, of a robust certificate beta, 1/s; None for the largest that covers `cover` or, without that, for
            the largest beta.
        cover: magnitudes of the start errors to cover, m and m/s, see `goals.start_corners`; None for none.
        drift: (2,) of the position in x and y, and in z, m/s, to withstand; None for none.
        push: (2,) on x and y, and on z, m/s^2, to withstand; None for none.
        lowest: smallest kappa of the kappa-sets, in (0, 1]; with lag or delay only.
        highest: cap wanted of the gain, at least 1.
    """

    limits: InputSet
    timing: Timing
    rate: float | None = None
    cover: Sequence[float] | None = None
    drift: FloatArray | None = None
    push: FloatArray | None = None
    lowest: float = 1.0
    highest: float = math.inf

    def certificate(self, name: str, inputs: Mapping[str, str]) -> Certificate:
        """Compute the certificate.

        Args:
            name: what it is called.
            inputs: how the user stated the wishes, for the provenance.

        Raises:
            FlatsatError: there is none, or it does not cover the start errors.
        """
        disturbed = self.drift is not None or self.push is not None
        made = self._robust(name, inputs) if disturbed else self._nominal(name, inputs)
        if self.cover is not None:
            _require_covered(made, start_corners(self.cover))
        return made

    def _nominal(self, name: str, inputs: Mapping[str, str]) -> Certificate:
        timing, rate = self.timing, self.rate
        if rate is None:
            if self.cover is None:
                raise FlatsatError("rate (alpha) is None: must be given where no start errors are to be covered")
            rate = rate_covering(self.limits, self.cover, timing, self.lowest, self.highest)
        return synthesize(
            self.limits,
            rate,
            timing.period,
            name,
            inputs,
            lag=timing.lag,
            delay=timing.delay,
            lowest=self.lowest,
            highest=self.highest,
        )

    def _robust(self, name: str, inputs: Mapping[str, str]) -> Certificate:
        drift, push = (np.zeros(2) if bound is None else bound for bound in (self.drift, self.push))
        period, rate = self.timing.period, self.rate
        if not self.timing.immediate:
            raise FlatsatError(
                f"drift, push: certified for the plain hold only; lag (tau) = {self.timing.lag:.6g} s and "
                f"delay (d) = {self.timing.delay:.6g} s must be 0"
            )
        if rate is None and self.cover is not None:
            rate = robust_rate_covering(self.limits, self.cover, period, drift, push)
        return synthesize_robust(self.limits, drift, push, period, name, inputs, rate)


def _require_covered(certificate: Certificate, starts: FloatArray) -> None:
    """Refuse a certificate that does not guarantee all of the start errors (..., 6)."""
    if not certificate.sets.classify(starts).guaranteed.all():
        kappa = float(certificate.sets.kappa(starts).min())
        raise FlatsatError(
            f"these start errors need kappa = {kappa:.4g}, certified is {certificate.gain_min:.4g} and more"
            + (", or the disturbance lifts them out of D" if certificate.robust else "")
            + ": the largest rate that covers them is chosen where none is asked for"
        )
