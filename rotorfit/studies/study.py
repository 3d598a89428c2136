"""A study: the files, the model and every setting of one identification; and what it gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.data.experiments import Experiment
from rotorfit.data.findings import Finding, error_sentence, errors_in
from rotorfit.fitting.fit import DATA_ERROR
from rotorfit.fitting.refine import Refinement
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.settings import PhaseOffsets
from rotorfit.studies.data_files import DataFile
from rotorfit.studies.recording_files import RecordingFiles

if TYPE_CHECKING:
    from rotorfit.uncertainty.bootstrap import Bootstrap
    from rotorfit.uncertainty.posterior import Posterior
    from rotorfit.uncertainty.profile import Profile


@dataclass(frozen=True, kw_only=True)
class Study:
    """What to identify from which files; the names are those of the TOML keys."""

    files: tuple[DataFile | RecordingFiles, ...]  # test files and recordings, all of which inform one parameter vector
    model: str  # name of the model, a key of :data:`rotorfit.models.MODELS`
    out: Path | None = None  # folder for the results, nothing is written without one
    planes: tuple[str, ...] = ()  # plane names of the data in the model's order, by default the model's own
    blocks: tuple[str, ...] = ()  # options of the model
    two_lam: bool = False  # options of the model
    orthotropic: tuple[str, ...] = ()
    modes: int = 0  # options of the model modal; by default (0, empty) one mode, gains as the data need them
    gains: str = ""  # options of the model modal; by default (0, empty) one mode, gains as the data need them
    apart: bool = False  # options of the model modal; by default (0, empty) one mode, gains as the data need them
    law: str = ""  # name of a law of eccentricity, a key of :data:`rotorfit.models.LAWS`, for models that carry a fluid
    clearance_um: float | None = None  # radial clearance at the fluid, micrometres; needed by a law
    known: Mapping[str, float | None] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, Any] = field(default_factory=dict)
    per: Mapping[str, str] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    runout_um: float | None = None  # plausible run-out of a shaft that is not round, see :func:`rotorfit.shaft_lines`
    loss: str = "linear"
    phase_offsets: PhaseOffsets = False
    max_iterations: int = 200
    calibration: Mapping[str, Any] = field(default_factory=dict)
    assumptions: Mapping[str, float] = field(default_factory=dict)
    refine: bool = False  # add structural blocks while the data ask for them
    sample: bool = False  # draw from the posterior
    seed: int | None = None  # of random numbers; by default one is drawn, and told in the results
    ess: float = 4000
    max_steps: int = 20_000
    profile: tuple[str, ...] = ()  # parameters to profile, or "threshold_speed"
    bootstrap: int = 0  # number of data sets to simulate and fit, none by default


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a study gave."""

    study: Study  # the settings
    experiments: tuple[Experiment, ...]  # the data
    findings: tuple[tuple[Finding, ...], ...]  # what the data check found, file by file
    closed: FitResult | str  # the closed form, or the reason why there is none
    fit: FitResult  # the fit of the model as asked for
    ladder: Refinement | None = None  # the structural refinement, if asked for
    posterior: Posterior | None = None  # further measures of uncertainty of the result to act on, if asked for
    profiles: tuple[Profile, ...] = ()  # further measures of uncertainty of the result to act on, if asked for
    bootstrap: Bootstrap | None = None  # further measures of uncertainty of the result to act on, if asked for

    @property
    def best(self) -> FitResult:
        """The result to act on: the refined one where there is one."""
        return self.fit if self.ladder is None else self.ladder.best

    @property
    def data_errors(self) -> tuple[str, ...]:
        """What the check of the data, or the fit, calls an error in them."""
        checked = errors_in(self.findings, [experiment.source for experiment in self.experiments])
        told = (w.removeprefix(DATA_ERROR) for w in self.fit.warnings if w.startswith(DATA_ERROR))
        return tuple(dict.fromkeys((*told, *checked)))  # a slip that a trial fit found comes first: it explains others

    @property
    def failure(self) -> str:
        """What is wrong with the data or did not converge, in words; empty where all is well."""
        if self.data_errors:
            return error_sentence(self.data_errors)
        if not self.best.success:
            return f"the fit did not converge: {self.best.message}"
        if self.posterior is not None and not self.posterior.converged:
            return f"the posterior's sampling has {self.posterior.message}"
        return ""
