"""A study: the files, the model and every setting of one identification; and what it gave."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from rotorfit.data.experiments import Experiment
from rotorfit.data.findings import Finding, attributed, error_sentence, errors_in, warnings_in
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.structure.refine import Refinement
from rotorfit.options.table import StudyOptions
from rotorfit.studies.data_files import DataFile
from rotorfit.studies.recording_files import RecordingFiles
from rotorfit.uncertainty.bootstrap import Bootstrap
from rotorfit.uncertainty.posterior import Posterior
from rotorfit.uncertainty.profile import Profile


@dataclass(frozen=True, kw_only=True)
class Study(StudyOptions):
    """Files, model and options of one identification; the names are those of the TOML keys."""

    files: tuple[DataFile | RecordingFiles, ...]  # test files and recordings, all of which inform one parameter vector
    model: str  # name of the model, a key of :data:`rotorfit.models.MODELS`
    out: Path | None = None  # folder for the results, nothing is written without one


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """Result of a study."""

    study: Study  # the settings
    experiments: tuple[Experiment, ...]  # the data
    findings: tuple[tuple[Finding, ...], ...]  # what the data check found, file by file
    closed: FitResult | str  # the closed form, or the reason why there is none
    fit: FitResult  # the fit of the model as asked for
    refinement: Refinement | None = None  # the structural refinement, if asked for
    posterior: Posterior | None = None  # of the result to act on, if asked for, as the two below
    profiles: tuple[Profile, ...] = ()
    bootstrap: Bootstrap | None = None

    @property
    def best(self) -> FitResult:
        """The result to act on: the refined one where there is one."""
        return self.fit if self.refinement is None else self.refinement.best

    @cached_property
    def data_errors(self) -> tuple[str, ...]:
        """Errors of the data in words, those that explain the misfit of the fit first."""
        sources = [test.source or test.title for test in self.experiments]
        return errors_in((*self.fit.findings, *attributed(self.findings, sources)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of the data check and of the fit, in words."""
        sources = [test.source or test.title for test in self.experiments]
        return (*warnings_in(attributed(self.findings, sources)), *(f"warning: {text}" for text in self.best.warnings))

    @property
    def failure(self) -> str:
        """Errors of the data and searches that did not converge, in words; empty where all is well."""
        if self.data_errors:
            return error_sentence(self.data_errors)
        if not self.best.success:
            return f"the fit did not converge: {self.best.message}"
        if self.posterior is not None and not self.posterior.converged:
            return f"the posterior's sampling has {self.posterior.message}"
        return ""
