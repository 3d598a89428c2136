"""The way from a study to its results: read, check, solve in closed form, optimise, refine, sample."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles, StudyProgress, checked_again, read_files
from rotorfit.apps.study_files.study import ALL_LAWS, Outcome, Study, build_model, check_model
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.identify.diagnosis.data_errors import undone
from rotorfit.identify.fitting.causes.calibration import calibration_of
from rotorfit.identify.fitting.fit import closed_form, fit
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitOptions
from rotorfit.identify.fitting.structure.law_ranking import LawComparison, compare_laws
from rotorfit.identify.fitting.structure.refine import refine
from rotorfit.lab.data.findings import Finding, without_phases
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import LAWS, AnisotropicShaft, RotorModel

if TYPE_CHECKING:
    from rotorfit.estimators.inference.ensemble_sampler import SamplerProgress


def run_study(
    study: Study, progress: StudyProgress, checkpoint: Path | None = None, executor: Executor | None = None
) -> Outcome:
    """Read, check, solve in closed form, optimise and, if asked for, refine and sample."""
    check_model(study)  # before files are read, which may take long
    experiments, findings = read_files([for_model(study, file) for file in study.files], progress, executor)
    return identify(study, experiments, findings, progress, checkpoint, executor)


def with_errors_undone(
    names: Sequence[str], experiments: tuple[Experiment, ...], findings: tuple[tuple[Finding, ...], ...]
) -> tuple[tuple[Experiment, ...], tuple[tuple[Finding, ...], ...]]:
    """The data with errors undone by their names, looked over again."""
    if not names:
        return experiments, findings
    corrected = undone(experiments, names)
    return corrected, checked_again(experiments, corrected, findings)


def identify(
    study: Study,
    experiments: tuple[Experiment, ...],
    findings: tuple[tuple[Finding, ...], ...],
    progress: StudyProgress,
    checkpoint: Path | None = None,
    executor: Executor | None = None,
) -> Outcome:
    """The results of a study whose files have been read and looked over."""
    experiments, findings = with_errors_undone(study.undo, experiments, findings)
    if study.phase_offsets == "common":  # the fit judges by the zero that it finds
        findings = tuple(without_phases(found) for found in findings)
    model = build_model(study, experiments)
    baseline = None
    if study.baseline:  # read as the first test file is
        first = next((file for file in study.files if isinstance(file, DataFile)), DataFile(Path()))
        options = {name: value for name, value in first.options.items() if name not in ("where", "exclude")}
        recorded = [file for file in study.files if isinstance(file, RecordingFiles)][:1]
        options |= {name: value for f in recorded for name in ("casing", "stator") if (value := getattr(f, name))}
        baseline = DataFile(Path(study.baseline), options).read(progress=progress)
    ranking, known = None, study.known
    if study.laws:
        progress("comparing laws of eccentricity")
        ranking = _ranked(study, model, experiments, baseline)
        model = ranking.best.model
        known = {name: value for name, value in known.items() if name in model.parameter_names}
    progress("closed form")
    closed: FitResult | str
    try:
        closed = closed_form(
            model, experiments, known=study.held, per=study.per, baseline=baseline, stator_mass_kg=study.stator_mass_kg
        )
    except ClosedFormError as reason:
        closed = str(reason)
    progress("optimising")
    result = fit(
        model,
        experiments,
        baseline=baseline,
        calibration=calibration_of(study.calibration),
        **_settings(study) | {"known": known},
    )
    outcome = Outcome(
        study=study, experiments=experiments, findings=findings, closed=closed, fit=result, ranking=ranking
    )
    if study.refine and (study.despite_errors or not outcome.data_errors):
        progress("refining the structure")
        outcome = replace(outcome, refinement=refine(result))
    return _with_uncertainty(outcome, progress, checkpoint, executor) if outcome.best.success else outcome


def _settings(study: Study) -> dict[str, Any]:
    """Options of the fit itself."""
    return {option.name: getattr(study, option.name) for option in fields(FitOptions)}


def _ranked(
    study: Study, model: RotorModel, experiments: tuple[Experiment, ...], baseline: Experiment | None
) -> LawComparison:
    """The laws that the study names, or those that a ranking has by itself, by the same settings as the fit."""
    laws = None if ALL_LAWS in study.laws else [LAWS[name]() for name in study.laws]
    return compare_laws(
        model, experiments, laws, baseline=baseline, calibration=calibration_of(study.calibration), **_settings(study)
    )


def for_model(study: Study, file: DataFile | RecordingFiles) -> DataFile | RecordingFiles:
    """Recordings of a shaft that is not round are reduced to its combination lines, of operation to spectra."""
    if study.operating:
        if not isinstance(file, RecordingFiles):
            raise ValueError(
                "operating (operating=, --operating) belongs to recordings; tables of its spectra say it themselves"
            )
        return replace(file, operating=True)
    if study.model != AnisotropicShaft.name:
        if study.runout_um is not None:
            raise ValueError(
                f"run-out (runout_um=, --runout-um) belongs to recordings for the model "
                f"{AnisotropicShaft.name}, not {study.model}"
            )
        return file
    return replace(file, lines=True, runout_um=study.runout_um) if isinstance(file, RecordingFiles) else file


def _with_uncertainty(
    outcome: Outcome, progress: StudyProgress, checkpoint: Path | None, executor: Executor | None
) -> Outcome:
    """Profiles, simulated data and posterior, as far as the study asks for them."""
    study, best = outcome.study, outcome.best
    if study.profile:
        progress(f"profile likelihood of {', '.join(study.profile)}")
    nonlinear = best.model.eccentricity_dependent  # profiles of others are found sooner than a worker begins
    profiles = best.profiles(study.profile, executor=executor if nonlinear else None)
    simulated = None
    if study.bootstrap:
        progress(f"fitting {study.bootstrap} simulated tests")
        simulated = best.bootstrap(n=study.bootstrap, seed=study.seed or 0, executor=executor)
    posterior = None
    if study.sample:
        from rotorfit.identify.uncertainty.posterior_file import load_arviz

        load_arviz()  # what is wrong with it is met here, not after an hour of sampling
        progress("sampling the posterior", 0.0)

        def report(state: SamplerProgress) -> None:
            progress(f"sampling the posterior: {state.waiting}", state.done)

        posterior = best.sample(
            seed=study.seed, ess=study.ess, max_steps=study.max_steps, checkpoint=checkpoint, progress=report
        )
    return replace(outcome, posterior=posterior, profiles=profiles, bootstrap=simulated)
