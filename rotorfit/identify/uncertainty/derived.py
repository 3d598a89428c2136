"""Quantities that follow from the parameters, with the spread that draws leave them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import interval, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.matching import matched
from rotorfit.base.text_table import Printed, Tabled
from rotorfit.identify.fitting.onset import is_extrapolated, onset_by_causes, onset_note
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import RotorModel, eigenvalues
from rotorfit.models.motion.stability import counted, mode_vectors, threshold_speeds

DERIVED_DRAWS = 2000
"""Draws from which derived quantities are computed, evenly spaced over the chain; a quantile of so many is within a
twentieth of a standard deviation."""
SHAFT_DRAWS = 100  # the same for models with the matrices of a whole shaft


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Derived(ByValue, Printed):
    """A quantity of the rotor, one value (or array of values) for each draw of a posterior."""

    name: str  # what it is
    unit: str  # SI unit
    samples: Float  # shape ``(N, ...)``; infinite or NaN for draws that have no such value
    note: str = ""  # what limits it, in words; empty where there is nothing

    @property
    def value(self) -> Any:
        """Median, a number or an array."""
        return self._quantiles([0.5])[0]

    @property
    def stderr(self) -> Any:
        """Standard deviation of the draws that have a value."""
        samples = np.where(np.isfinite(self.samples), self.samples, np.nan)
        if not np.isfinite(samples).all():
            samples = samples[np.isfinite(samples)] if samples.ndim == 1 else samples
        return np.std(samples, axis=0, ddof=1)[()] if len(samples) > 1 else np.nan

    @property
    def missing(self) -> float:
        """Share of the draws without a value, for instance of rotors without a threshold speed."""
        return float(1 - np.isfinite(self.samples).mean())

    def interval(self, probability: float = 0.95) -> tuple[Any, Any]:
        """Bounds between which the value lies with a probability, equal shares of the rest on both sides."""
        if not 0 < probability < 1:
            raise ValueError(f"probability is {probability}; it lies between 0 and 1")
        low, high = self._quantiles([(1 - probability) / 2, (1 + probability) / 2])
        return low, high

    def _quantiles(self, at: list[float]) -> Any:
        samples = self.samples
        if samples.ndim == 1:
            samples = samples[~np.isnan(samples)]
            if not samples.size:
                return np.full(len(at), np.nan)
        # Between two infinities there is nothing to interpolate.
        method: Any = "linear" if np.isfinite(samples).all() else "inverted_cdf"
        return np.quantile(samples, at, axis=0, method=method)

    def __str__(self) -> str:
        if np.ndim(self.samples) > 1:
            return f"{self.name}: {self.samples.shape[0]} draws of shape {self.samples.shape[1:]} {self.unit}"
        ends = interval(*(float(end) for end in self.interval()))
        text = f"{self.name}: {with_error(float(self.value), float(self.stderr))[0]} {ends} {self.unit}"
        return f"{text}; {self.note}" if self.note else text


class Draws(Tabled, ABC):
    """Draws of parameters: a posterior, an average of posteriors, a bootstrap."""

    @abstractmethod
    def parameter(self, name: str) -> Derived:
        """One parameter with its spread."""

    def summary(self) -> str:
        """Table for a terminal."""
        return str(self)

    def interval(self, name: str, probability: float = 0.95) -> tuple[float, float]:
        """Central interval of one entry, equal shares of the rest on both sides."""
        low, high = self.parameter(name).interval(probability)
        return float(low), float(high)


@dataclass(frozen=True, eq=False, kw_only=True)
class Mode:
    """One mode of free vibration at one rotative speed."""

    frequency: Derived  # damped natural frequency, rad/s, signed: negative is backward whirl
    damping_ratio: Derived  # share of critical damping; negative is unstable
    decay_rate: Derived  # ``-Re s``, 1/s
    # amplitude, phase: of the mode shape at each coordinate relative to the one that moves most at the median, samples
    # of shape ``(N, n)``, phase in rad
    amplitude: Derived
    phase: Derived


@dataclass(frozen=True, eq=False, kw_only=True)
class StiffnessBand:
    """Dynamic stiffness at some frequencies."""

    frequency: Float  # rad/s, shape ``(F,)``
    direct: Derived  # direct, quadrature: real and imaginary part, N/m, samples of shape ``(N, F, n, n)``
    quadrature: Derived


def modes(model: RotorModel, theta: Float, speed: float, band: float) -> list[Mode]:
    """Modes of many rotors alike at one speed, each draw's matched with those of the median rotor."""
    middle = np.median(theta, axis=0)
    reference = eigenvalues(model, middle, speed)
    reference = reference[counted(model, reference, band)]
    at: Any = slice(None) if model.shaft is None else model.shaft.at
    s = matched(eigenvalues(model, theta, speed), reference)
    coefficients = model.motion(theta, speed)
    result = []
    for k in range(reference.size):
        leading = int(np.argmax(np.abs(mode_vectors(model.motion(middle, speed), reference[k])[1][at])))
        vectors = mode_vectors(coefficients, s[:, k])[1][:, at]
        vectors = vectors / vectors[:, leading : leading + 1]
        rate, decay = np.abs(s[:, k]), -s[:, k].real
        ratio, shape = decay / np.where(rate > 0, rate, np.nan), f"mode shape {k + 1}"
        result.append(
            Mode(
                frequency=Derived(name=f"natural frequency {k + 1}", unit="rad/s", samples=s[:, k].imag),
                damping_ratio=Derived(name=f"damping ratio {k + 1}", unit="1", samples=ratio),
                decay_rate=Derived(name=f"decay rate {k + 1}", unit="1/s", samples=decay),
                amplitude=Derived(name=f"{shape}, amplitude", unit="1", samples=np.abs(vectors)),
                phase=Derived(name=f"{shape}, phase", unit="rad", samples=np.angle(vectors)),
            )
        )
    return result


@dataclass(frozen=True, eq=False, kw_only=True)
class Onsets:
    """Onset of instability of each draw."""

    speed: Float  # rad/s, shape ``(N,)``
    whirl_ratio: Float  # frequency of the whirl over the speed, NaN without an onset, shape ``(N,)``
    note: str  # what limits the numbers, in words; empty where there is nothing


def onsets_of(fit: FitResult, theta: Float, group: int, seed: int, sizes: Float | None = None) -> Onsets:
    """Threshold speeds of draws of one parameter group.

    After refinement candidates differ by more than the draws of one of them do, where the onset lies beyond the
    tested speeds or frequencies. As in :meth:`~rotorfit.FitResult.threshold_speed` that difference is an error of the
    result: extrapolated draws are scattered by it, and those whose onset lies outside the band of a model that holds in
    the band only are drawn from the onset of the candidate that holds beyond. ``sizes`` of causes beside the model,
    shape ``(N, k)``, move it by their slopes at the fit.
    """
    speed, whirl = threshold_speeds(fit.model, theta, band=fit.stability_band)
    if sizes is not None:
        moved, slopes = onset_by_causes(fit, group)
        speed = speed + moved + sizes @ slopes
    ratio = whirl / np.where(speed > 0, speed, np.nan)
    found = np.isfinite(speed)
    candidate = fit.settings.onsets[group] if fit.settings.onsets else None
    limited = math.isfinite(fit.stability_band)
    if limited and candidate is None and math.isnan(fit.threshold_of(group).value):
        speed = np.full_like(speed, np.nan)
    if candidate is not None:
        normal = np.random.default_rng(seed).standard_normal(speed.size)
        beyond = found & is_extrapolated(fit, speed, whirl)
        speed[beyond] += candidate.difference * normal[beyond]
        if limited and math.isfinite(candidate.speed):
            speed[~found] = candidate.speed + math.hypot(candidate.stderr, candidate.difference) * normal[~found]
            ratio[~found] = candidate.whirl_ratio
    return Onsets(speed=speed, whirl_ratio=ratio, note=onset_note(fit, group))
