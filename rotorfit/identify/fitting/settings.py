"""Options and settings of a fit; keywords that are handed on to another function, and the refusal of others."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict

from rotorfit.base.chance import Seed
from rotorfit.base.names import unknown_name
from rotorfit.estimators.minimisation.objective import Method
from rotorfit.estimators.misfit.problem import Loss

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rotorfit.estimators.inference.ensemble_sampler import SamplerProgress
    from rotorfit.estimators.inference.log_posterior import Noise
    from rotorfit.identify.fitting.causes.calibration import Calibration
    from rotorfit.identify.fitting.causes.solution import SolvedCauses
    from rotorfit.identify.fitting.noise.record import FoundNoise
    from rotorfit.identify.fitting.quantities import Share
    from rotorfit.lab.data.experiments import PerturbationTest
    from rotorfit.lab.data.rows import Experiment


PhaseOffsets: TypeAlias = bool | Literal["common"]
"""An offset of the phase reference for every run but the first, one common to all, or none."""


@dataclass(frozen=True, kw_only=True)
class Onset:
    """Onset of instability by the best candidate model of a refinement."""

    speed: float  # threshold speed, rad/s
    stderr: float  # its standard error by the candidate itself, rad/s
    difference: float  # from it to the candidates beside it, rad/s; an error of its own where the onset is extrapolated
    whirl_ratio: float  # whirl frequency at onset over threshold speed


def option(default: Any, help: str, metavar: str = "", word: str = "") -> Any:
    """A field that is an option: its default, what it does, and how the command line shows and calls its value."""
    metadata = {"help": help, "metavar": metavar, "word": word}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Options of a fit as the user gives them, each described once: see :func:`rotorfit.fit`."""

    known: Mapping[str, float | tuple[float, float] | None] = option(
        {}, "hold NAME at VALUE (SI), known within +-ERROR; NAME=free fits it", "NAME=VALUE[+-ERROR]"
    )
    bounds: Mapping[str, tuple[float, float]] = option(
        {}, "limits of a parameter, either may be left out", "NAME=LO:HI"
    )
    priors: Mapping[str, Any] = option(
        {}, "Gaussian prior of a parameter (other distributions: `rotorfit run`)", "NAME=MEAN:SD", "--prior"
    )
    start: Mapping[str, float] = option({}, "start value instead of the one that is found", "NAME=VALUE")
    per: Mapping[str, str] = option(
        {},
        "one value for each value of a test attribute, or of several together: D=speed_rpm, K*=speed_rpm+pressure_bar",
        "NAME=ATTRIBUTE",
    )
    loss: Loss = option("linear", "linear, or soft_l1, huber, cauchy against outliers", "NAME")
    phase_offsets: PhaseOffsets = option(
        False,
        "fit a phase reference offset for every run but the first; common: one angle between forces and responses",
        "common",
    )
    method: Method = option(
        "auto", "method of the search: auto, gauss-newton, or ipopt (on CasADi's graph if there is one)", "NAME"
    )
    stator_mass_kg: float | None = option(
        None,
        "mass of a floating stator, kg, which moves with the fluid's motion (instead of a dry run, --baseline)",
        "KG",
    )
    causes: Mapping[str, float] | None = option(
        {},
        "size (standard uncertainty) of a cause beside the model, which is solved with the fitted values: gain=0.005",
        "NAME=SIZE",
        "--cause",
    )
    max_iterations: int = option(200, "limit on the iterations of the search; 200 unless given", "N")

    @property
    def held(self) -> Mapping[str, float | None]:
        """Known values without their errors."""
        return {name: value[0] if isinstance(value, tuple) else value for name, value in self.known.items()}

    @property
    def sizes(self) -> Mapping[str, float]:
        """Sizes of causes that were given: by name, and the errors of known values."""
        errors = {name: value[1] for name, value in self.known.items() if isinstance(value, tuple)}
        return {**errors, **(self.causes or {})}


@dataclass(frozen=True, kw_only=True)
class FitSettings(FitOptions):
    """Options that the user gave, and choices made during the fit; they lay the problem out again."""

    noise_scale: Mapping[str, float] = field(default_factory=dict)  # factor on the noise of a response, by name
    force_spectrum: str = ""  # of a force that was not measured, by BIC
    onsets: tuple[Onset, ...] = ()
    baseline: PerturbationTest | None = None  # dry run, whose dynamic stiffness acts beside the model's
    calibration: Calibration | None = None  # uncertainties that enter as nuisance entries
    noise: FoundNoise | None = None
    solved: SolvedCauses | None = None
    refined: bool = False  # the model's blocks were chosen, of all that there are

    @property
    def asked(self) -> FitSettings:
        """Settings for another model of the same data: without choices of the fit."""
        return replace(self, noise_scale={}, force_spectrum="", onsets=(), noise=None, solved=None, refined=False)

    @property
    def rescaled(self) -> bool:
        """True if the noise was scaled to the residuals, or what runs differ by joined it."""
        return bool(self.noise_scale) or self.noise is not None


# ---- keywords, which an editor completes where they are handed on ----------------------------------------------------


class FitKeywords(TypedDict, total=False):
    """Keywords of :func:`rotorfit.fit` but for ``known``; see there."""

    bounds: Mapping[str, tuple[float | None, float | None]] | None
    priors: Mapping[str, Any] | None
    per: Mapping[str, str] | None
    loss: Loss
    start: Mapping[str, float] | None
    phase_offsets: PhaseOffsets
    baseline: Experiment | None
    stator_mass_kg: float | None
    calibration: Calibration | None
    causes: Mapping[str, float] | None
    method: Method
    max_iterations: int


class SamplerKeywords(TypedDict, total=False):
    """Keywords of :func:`rotorfit.sample` for one model or several; see there."""

    rng: Seed
    seed: Seed
    walkers: int | None
    ess: float
    max_steps: int
    noise: Noise | None
    progress: bool | Callable[[SamplerProgress], None] | None
    moves: Sequence[tuple[Any, float]] | None
    accelerate: bool | None


class SampleKeywords(SamplerKeywords, total=False):
    """All keywords of :func:`rotorfit.sample`; see there."""

    refine: bool
    checkpoint: str | os.PathLike[str] | None


class PredictKeywords(TypedDict, total=False):
    """Keywords of :meth:`rotorfit.FitResult.predict`; see there."""

    frequency_rpm: ArrayLike | None
    frequency_hz: ArrayLike | None
    speed_rpm: ArrayLike | None
    force_plane: str | None
    force: complex | None
    mr: complex | None
    plane: str | None
    direction: str | None
    level: float
    whole: bool
    share: Share
    at: Mapping[str, Any] | None


class JudgeKeywords(TypedDict, total=False):
    """Keywords of :meth:`rotorfit.FitResult.stability_report`; see there."""

    max_speed: float | None
    min_speed: float | None
    max_speed_rpm: float | None
    min_speed_rpm: float | None
    min_decrement: float
    min_threshold_ratio: float
    cross_coupling: Mapping[str, float] | None
    min_cross_coupling_ratio: float
    unbalance_g_mm: Mapping[str, float] | None
    plane: str | None
    max_amplitude_um: float | None
    sensitivity: str | None
    max_sensitivity: float
    cases: Mapping[str, Mapping[str, float]] | None
    level: float
    at: Mapping[str, Any] | None


def check_keywords(function: str, given: Iterable[str], keywords: type, *own: str) -> None:
    """Refuse a keyword that a function does not take."""
    allowed = (*own, *keywords.__annotations__)
    for name in given:
        if name not in allowed:
            raise TypeError(unknown_name(f"keyword of {function}", name, allowed))
