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
    """What to identify from which files; the names are those of the TOML keys.

    Attributes:
        files: test files and recordings, all of which inform one parameter vector.
        model: name of the model, a key of :data:`rotorfit.models.MODELS`.
        out: folder for the results, nothing is written without one.
        planes: plane names of the data in the model's order, by default the model's own.
        blocks, two_lam: options of the model.
        orthotropic: planes whose supports differ in two directions, see :class:`rotorfit.models.Orthotropic`.
        modes, gains, apart: options of the model modal; by default (0, empty) one mode, gains as the data need them.
        law: name of a law of eccentricity, a key of :data:`rotorfit.models.LAWS`, for models that carry a fluid.
        clearance_um: radial clearance at the fluid, micrometres; needed by a law.
        known, bounds, priors, per, start, loss, phase_offsets, max_iterations: see :func:`rotorfit.fit`.
        runout_um: plausible run-out of a shaft that is not round, see :func:`rotorfit.shaft_lines`.
        calibration: uncertainties by name, see :class:`rotorfit.Calibration`.
        assumptions: standard uncertainties of what the model leaves out or takes as known, see :func:`rotorfit.fit`.
        refine: add structural blocks while the data ask for them.
        sample: draw from the posterior.
        seed: of random numbers; by default one is drawn, and told in the results.
        ess, max_steps: effective samples to reach, and steps to stop at in any case; see :func:`rotorfit.sample`.
        profile: parameters to profile, or "threshold_speed".
        bootstrap: number of data sets to simulate and fit, none by default.
    """

    files: tuple[DataFile | RecordingFiles, ...]
    model: str
    out: Path | None = None
    planes: tuple[str, ...] = ()
    blocks: tuple[str, ...] = ()
    two_lam: bool = False
    orthotropic: tuple[str, ...] = ()
    modes: int = 0
    gains: str = ""
    apart: bool = False
    law: str = ""
    clearance_um: float | None = None
    known: Mapping[str, float | None] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, Any] = field(default_factory=dict)
    per: Mapping[str, str] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    runout_um: float | None = None
    loss: str = "linear"
    phase_offsets: PhaseOffsets = False
    max_iterations: int = 200
    calibration: Mapping[str, Any] = field(default_factory=dict)
    assumptions: Mapping[str, float] = field(default_factory=dict)
    refine: bool = False
    sample: bool = False
    seed: int | None = None
    ess: float = 4000
    max_steps: int = 20_000
    profile: tuple[str, ...] = ()
    bootstrap: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a study gave.

    Attributes:
        study: the settings.
        experiments: the data.
        findings: what the data check found, file by file.
        closed: the closed form, or the reason why there is none.
        fit: the fit of the model as asked for.
        ladder: the structural refinement, if asked for.
        posterior, profiles, bootstrap: further measures of uncertainty of the result to act on, if asked for.
    """

    study: Study
    experiments: tuple[Experiment, ...]
    findings: tuple[tuple[Finding, ...], ...]
    closed: FitResult | str
    fit: FitResult
    ladder: Refinement | None = None
    posterior: Posterior | None = None
    profiles: tuple[Profile, ...] = ()
    bootstrap: Bootstrap | None = None

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
