"""One number of a result with its error: a fitted parameter, a derived quantity, the agreement of one response."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rotorfit.fitting.arithmetic import Number, Source, shown_unit
from rotorfit.units import si_factor

THRESHOLD = "threshold_speed"
"""Name of the threshold speed where a parameter could stand."""


@dataclass(frozen=True, kw_only=True, repr=False)
class FittedParameter(Number):
    """One parameter of a result. Sums, products and powers of parameters of one result know their covariance.

    Attributes:
        name: name, with the group in brackets where it was fitted per attribute.
        value: estimate or known value, SI.
        stderr: standard error, as wide as the residuals ask, see ``noise`` of a result; where they were not studied,
            by sqrt(redchi) if that is above one; zero for known parameters, infinite where the data do not determine
            the parameter, NaN where the search did not converge.
        stderr_noise: standard error from the noise alone.
        init_value: start of the optimisation.
        unit: SI unit.
        meaning: a few words.
        min, max: bounds.
        vary: whether it was fitted.
        resolved: whether the data determine it.
        at_bound: the estimate rests on a bound, so its error bar is not symmetric.
        freedom: degrees of freedom of ``stderr``, few where it rests on differences between few runs.
        fit: the result that it belongs to, which knows what the parameter rests on.
    """

    name: str
    value: float
    stderr: float
    stderr_noise: float
    init_value: float
    unit: str
    meaning: str
    min: float
    max: float
    vary: bool
    resolved: bool = True
    at_bound: bool = False
    freedom: float = math.inf
    fit: Source | None = field(default=None, init=False, compare=False, repr=False)

    @property
    def source(self) -> Source | None:
        """The result that it belongs to."""
        return self.fit

    @property
    def slopes(self) -> Mapping[str, float]:
        """Its derivative by itself."""
        return {self.name: 1.0}

    @property
    def alone(self) -> tuple[float, float]:
        """Standard error and systematic share."""
        return self.stderr, self.systematic

    @property
    def systematic(self) -> float:
        """Standard uncertainty by what the model leaves out or takes as known; see :meth:`FitResult.systematic`."""
        return 0.0 if self.fit is None else self.fit.systematic(self.name)

    @property
    def moved_by(self) -> str:
        """What leaves the number open, in words; empty where the number stands; see :meth:`FitResult.moved_by`."""
        return "" if self.fit is None or not self.vary else self.fit.moved_by(self.name)

    def interval(self, level: float = 0.95, *, statistical: bool = False) -> tuple[float, float]:
        """As :meth:`Quantity.interval`; that of a known parameter, or of one left open, has no systematic share."""
        return super().interval(level, statistical=statistical or not 0 < self.stderr < math.inf)

    def __str__(self) -> str:
        if self.moved_by:
            return f"not determined: {self.moved_by}"
        return super().__str__() if self.vary else f"{self.value:.6g} {shown_unit(self.unit)}".rstrip() + ", known"

    def __repr__(self) -> str:
        return f"<{self.name}: {self}>"


@dataclass(frozen=True, repr=False)
class Quantity(Number):
    """A derived quantity and its standard error, infinite where the data do not determine it, NaN for a stalled fit.

    Sums, products and powers keep the covariance with what else was derived from the same fit, and the unit.

    Attributes:
        value: in ``unit``.
        stderr: its standard error, likewise.
        unit: SI unit.
        freedom: degrees of freedom of ``stderr``.
        systematic: standard uncertainty by what the model leaves out or takes as known; zero where that was not asked.
        source: the result that it was derived from; None for a number on its own.
        slopes: derivatives by the parameters of the source, by name.
    """

    value: float
    stderr: float
    unit: str
    freedom: float = math.inf
    systematic: float = 0.0
    source: Source | None = field(default=None, compare=False, repr=False)
    slopes: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)

    @property
    def alone(self) -> tuple[float, float]:
        """Standard error and systematic share."""
        return self.stderr, self.systematic

    def to(self, unit: str) -> Quantity:
        """The quantity in another unit of frequency: rpm, Hz, cpm or rad/s; 1/s is rad/s.

        Args:
            unit: its name.

        Raises:
            ValueError: a quantity that is no frequency, or an unknown unit.

        Example:
            >>> print(fit.threshold_speed().to("rpm"))
            2667 +- 76 rpm (1.3 statistical, 76 systematic)
        """
        own = si_factor("frequency", "rad_s" if self.unit == "1/s" else self.unit.replace("/", "_"))
        other = si_factor("frequency", unit.replace("/", "_"))
        value, stderr, systematic = (part * own / other for part in (self.value, self.stderr, self.systematic))
        slopes = {name: slope * own / other for name, slope in self.slopes.items()}
        return replace(self, value=value, stderr=stderr, systematic=systematic, unit=unit, slopes=slopes)


@dataclass(frozen=True, kw_only=True)
class ResponseQuality:
    """Agreement of one measured response with the fit.

    Attributes:
        name: run and channel.
        nrmse: rms residual over rms response.
        frac: frequency response assurance criterion, 1 for responses of equal shape.
        redchi: mean squared whitened residual, 1 for noise alone.
        count: number of readings.
    """

    name: str
    nrmse: float
    frac: float
    redchi: float
    count: int
