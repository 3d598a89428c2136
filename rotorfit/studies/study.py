"""A study: the files, the model and every setting of one identification, and the way from there to the results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rotorfit.data.experiments import Experiment, LineTest
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.fitting.calibration import calibration_of
from rotorfit.fitting.fit import closed_form, fit
from rotorfit.fitting.refine import Refinement, refine
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.settings import PhaseOffsets
from rotorfit.io.files import read, table_suffix
from rotorfit.io.tidy_csv import lines_of
from rotorfit.models import LAWS, MODELS, AnisotropicShaft, Modal, Orthotropic, RotorModel
from rotorfit.models.parameters import unknown_name
from rotorfit.studies.modal_options import modal_options
from rotorfit.studies.recording_files import RecordingFiles

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rotorfit.data.findings import Finding
    from rotorfit.estimators.inference.ensemble_sampler import SamplerProgress
    from rotorfit.uncertainty.bootstrap import Bootstrap
    from rotorfit.uncertainty.posterior import Posterior
    from rotorfit.uncertainty.profile import Profile


class StudyProgress(Protocol):
    """Called when a stage begins, and while it goes on where it can say how far it is."""

    def __call__(self, stage: str, done: float | None = None) -> None:
        """Take notice of a stage in a few words and of the share of it that is done."""
        ...


def no_progress(stage: str, done: float | None = None) -> None:
    """Show nothing.

    Args:
        stage, done: as of any :class:`StudyProgress`.
    """


@dataclass(frozen=True)
class DataFile:
    """A test file and the options to read it with, see :func:`rotorfit.read`."""

    path: Path
    options: Mapping[str, Any] = field(default_factory=dict)

    def read(
        self, on_finding: Callable[[Finding], None] | None = None, progress: Callable[[str], None] = no_progress
    ) -> Experiment:
        """Read the test.

        Args:
            on_finding: called with what was found odd while reading.
            progress: called with a few words.
        """
        progress(f"reading {self.path.name}")
        return read(self.path, **{"on_finding": on_finding, **self.options})


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
        known, bounds, priors, per, start, loss, phase_offsets: see :func:`rotorfit.fit`.
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
        """What the check of the data calls an error."""
        return tuple(f.message for findings in self.findings for f in findings if f.severity == "error")

    @property
    def failure(self) -> str:
        """What is wrong with the data or did not converge, in words; empty where all is well."""
        if self.data_errors:
            return f"the check of the data calls these an error: {' '.join(self.data_errors)}"
        if not self.best.success:
            return f"the fit did not converge: {self.best.message}"
        if self.posterior is not None and not self.posterior.converged:
            return f"the posterior's sampling has {self.posterior.message}"
        return ""


def run_study(study: Study, progress: StudyProgress, checkpoint: Path | None = None) -> Outcome:
    """Read, check, solve in closed form, optimise and, if asked for, refine and sample.

    Args:
        study: the settings.
        progress: called when a stage begins.
        checkpoint: file of the sampler's, from which a run that was stopped goes on.

    Raises:
        OSError: a file that cannot be read.
        KeyError: unknown parameter or plane names.
        ValueError: data or settings that make no sense; the message says which.
    """
    check_model_name(study.model)  # before files are read, which may take long
    experiments, findings = read_files([_for_model(study, file) for file in study.files], progress)
    model = build_model(study, experiments)
    progress("closed form")
    closed: FitResult | str
    try:
        closed = closed_form(model, experiments, known=study.known, per=study.per)
    except ClosedFormError as reason:
        closed = str(reason)
    progress("optimising")
    result = fit(
        model,
        experiments,
        known=study.known,
        bounds=study.bounds,
        priors=study.priors,
        per=study.per,
        loss=study.loss,  # type: ignore[arg-type]
        start=study.start,
        phase_offsets=study.phase_offsets,
        calibration=calibration_of(study.calibration),
        assumptions=study.assumptions,
    )
    ladder = None
    if study.refine:
        progress("refining the structure")
        ladder = refine(result)
    outcome = Outcome(study=study, experiments=experiments, findings=findings, closed=closed, fit=result, ladder=ladder)
    return _with_uncertainty(outcome, progress, checkpoint) if outcome.best.success else outcome


def _for_model(study: Study, file: DataFile | RecordingFiles) -> DataFile | RecordingFiles:
    """Recordings of a shaft that is not round are reduced to its combination lines."""
    if study.model != AnisotropicShaft.name:
        if study.runout_um is not None:
            raise ValueError(
                f"runout_um belongs to recordings for the model {AnisotropicShaft.name}, not {study.model}"
            )
        return file
    return replace(file, lines=True, runout_um=study.runout_um) if isinstance(file, RecordingFiles) else file


def read_files(
    files: Sequence[DataFile | RecordingFiles], progress: StudyProgress, executor: Executor | None = None
) -> tuple[tuple[Experiment, ...], tuple[tuple[Finding, ...], ...]]:
    """The tests, and what was found odd in each, errors first.

    Args:
        files: test files and recordings.
        progress: called for each file.
        executor: reduces recordings beside each other.

    Raises:
        OSError: a file that cannot be read.
        ValueError: what is wrong in a file.
    """
    from rotorfit.checks.checklist import check

    experiments: list[Experiment] = []
    findings: list[tuple[Finding, ...]] = []
    for file in files:
        found: list[Finding] = []
        if isinstance(file, RecordingFiles):
            tests = file.read(found.append, progress, executor)
        else:
            tests = (file.read(found.append, progress),)
        for test in tests:
            found += check(test)
            found = _with_lines(found, file, len(test))
            order = ("error", "warning", "note")
            findings.append(tuple(sorted(found, key=lambda finding: order.index(finding.severity))))
            found = []  # what was found odd in recordings of several kinds is told with the first
        experiments += tests
    return tuple(experiments), tuple(findings)


def _with_lines(findings: list[Finding], file: DataFile | RecordingFiles, count: int) -> list[Finding]:
    """Findings with the lines of the file that their rows stand in, where each row is a line of a table."""
    if not isinstance(file, DataFile) or not any(f.rows for f in findings) or not table_suffix(file.path):
        return findings
    options = {name: file.options[name] for name in ("sheet", "columns", "constants") if name in file.options}
    lines = lines_of(file.path, **options)
    if len(lines) != count:  # runs were differenced, or rows chosen
        return findings
    return [replace(f, lines=tuple(lines[row] for row in f.rows)) for f in findings]


def _with_uncertainty(outcome: Outcome, progress: StudyProgress, checkpoint: Path | None) -> Outcome:
    """Profiles, simulated data and posterior, as far as the study asks for them."""
    study, best = outcome.study, outcome.best
    profiles = []
    for i, name in enumerate(study.profile):
        progress(f"profile likelihood of {name}", i / len(study.profile))
        profiles.append(best.profile(name))
    simulated = None
    if study.bootstrap:
        progress(f"fitting {study.bootstrap} simulated tests")
        simulated = best.bootstrap(n=study.bootstrap, seed=study.seed or 0)
    posterior = None
    if study.sample:
        progress("sampling the posterior", 0.0)

        def report(state: SamplerProgress) -> None:
            progress(f"sampling the posterior: {state.waiting}", state.done)

        posterior = best.sample(
            seed=study.seed, ess=study.ess, max_steps=study.max_steps, checkpoint=checkpoint, progress=report
        )
    return replace(outcome, posterior=posterior, profiles=tuple(profiles), bootstrap=simulated)


def check_model_name(name: str) -> None:
    """Refuse an unknown model.

    Raises:
        ValueError: names the nearest model.
    """
    if name not in MODELS:
        raise ValueError(unknown_name("model", name, MODELS))


def _has_twist(experiment: Experiment) -> bool:
    return isinstance(experiment, LineTest) and bool((experiment.direction == "twist").any())


def _has_start_up(experiment: Experiment) -> bool:
    """Whether 1x and 2x were read over the speeds of a start-up, where run-out shows."""
    if not isinstance(experiment, LineTest):
        return False
    speeds = [set(experiment.speed[experiment.line == line].tolist()) for line in ("1x", "2x")]
    return min(map(len, speeds)) >= LineTest.START_UP


def build_model(study: Study, experiments: Sequence[Experiment]) -> RotorModel:
    """The model of a study.

    Raises:
        ValueError: unknown model or law, or an option that the model does not have.
    """
    check_model_name(study.model)
    options: dict[str, Any] = {}
    if study.planes:
        options["planes"] = study.planes
    elif study.model == "anisotropic":  # has as many planes as the data, whatever they are called
        options["planes"] = tuple(dict.fromkeys(plane for experiment in experiments for plane in experiment.planes))
    if study.model == AnisotropicShaft.name and not any(_has_twist(experiment) for experiment in experiments):
        options["torsion"] = None
    if study.model == AnisotropicShaft.name and any(_has_start_up(experiment) for experiment in experiments):
        options["runout"] = True
    if study.model == Modal.name:
        options |= modal_options(study.planes, experiments)
    options |= {name: given for name in ("modes", "gains", "apart") if (given := getattr(study, name))}
    if study.blocks:
        options["blocks"] = study.blocks
    if study.two_lam:
        options["two_lam"] = True
    if study.law:
        if study.law not in LAWS:
            raise ValueError(unknown_name("law", study.law, LAWS))
        options["law"] = LAWS[study.law]()
    if study.clearance_um is not None:
        options["clearance_um"] = study.clearance_um
    model = MODELS[study.model]().variant(**options)
    return Orthotropic(model, study.orthotropic) if study.orthotropic else model
