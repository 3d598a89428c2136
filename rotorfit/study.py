"""A study: the files, the model and every setting of one identification, and the way from there to the results."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.estimators.closed_form import ClosedFormError
from rotorfit.experiments import Experiment
from rotorfit.fitting import closed_form, fit
from rotorfit.models import MODELS, RotorModel
from rotorfit.models.parameters import unknown_name
from rotorfit.readers import read
from rotorfit.refinement import Refinement, refine
from rotorfit.results import FitResult

if TYPE_CHECKING:
    from rotorfit.data_check import Finding

Progress = Callable[[str], None]


@dataclass(frozen=True)
class DataFile:
    """A test file and the options to read it with, see :func:`rotorfit.read`."""

    path: Path
    options: Mapping[str, Any] = field(default_factory=dict)

    def read(self) -> Experiment:
        """Read the test."""
        return read(self.path, **self.options)


@dataclass(frozen=True, kw_only=True)
class Study:
    """What to identify from which files; the names are those of the TOML keys.

    Attributes:
        files: test files, all of which inform one parameter vector.
        model: name of the model, a key of :data:`rotorfit.models.MODELS`.
        out: folder for the results, nothing is written without one.
        planes: plane names of the data in the model's order, by default the model's own.
        blocks, two_lam: options of the model.
        known, bounds, priors, per, start, loss, phase_offsets: see :func:`rotorfit.fit`.
        refine: add structural blocks while the data ask for them.
    """

    files: tuple[DataFile, ...]
    model: str
    out: Path | None = None
    planes: tuple[str, ...] = ()
    blocks: tuple[str, ...] = ()
    two_lam: bool = False
    known: Mapping[str, float | None] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, Any] = field(default_factory=dict)
    per: Mapping[str, str] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    loss: str = "linear"
    phase_offsets: bool = False
    refine: bool = False


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a study gave.

    Attributes:
        study: the settings.
        experiments: the data.
        findings: what the data check found, file by file.
        closed: the closed form, or the reason why there is none.
        fit: the fit of the model as asked for.
        ladder: the structural refinement, if asked for.
    """

    study: Study
    experiments: tuple[Experiment, ...]
    findings: tuple[tuple[Finding, ...], ...]
    closed: FitResult | str
    fit: FitResult
    ladder: Refinement | None = None

    @property
    def best(self) -> FitResult:
        """The result to act on: the refined one where there is one."""
        return self.fit if self.ladder is None else self.ladder.best


def run_study(study: Study, progress: Progress) -> Outcome:
    """Read, check, solve in closed form, optimise and, if asked for, refine.

    Args:
        study: the settings.
        progress: called with a few words when a stage begins.

    Raises:
        OSError: a file that cannot be read.
        KeyError: unknown parameter or plane names.
        ValueError: data or settings that make no sense; the message says which.
    """
    from rotorfit.data_check import check

    check_model_name(study.model)  # before files are read, which may take long
    experiments = []
    for file in study.files:
        progress(f"reading {file.path.name}")
        experiments.append(file.read())
    progress("checking the data")
    findings = tuple(tuple(check(experiment)) for experiment in experiments)
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
    )
    ladder = None
    if study.refine:
        progress("refining the structure")
        ladder = refine(result)
    return Outcome(study, tuple(experiments), findings, closed, result, ladder)


def check_model_name(name: str) -> None:
    """Refuse an unknown model.

    Raises:
        ValueError: names the nearest model.
    """
    if name not in MODELS:
        raise ValueError(unknown_name("model", name, MODELS))


def build_model(study: Study, experiments: Sequence[Experiment]) -> RotorModel:
    """The model of a study.

    Raises:
        ValueError: unknown model, or an option that it does not have.
    """
    check_model_name(study.model)
    options: dict[str, Any] = {}
    if study.planes:
        options["planes"] = study.planes
    elif study.model == "anisotropic":  # has as many planes as the data, whatever they are called
        options["planes"] = tuple(dict.fromkeys(plane for experiment in experiments for plane in experiment.planes))
    if study.blocks:
        options["blocks"] = study.blocks
    if study.two_lam:
        options["two_lam"] = True
    return MODELS[study.model]().variant(**options)


def frozen_prior(where: str, name: str, numbers: Sequence[float]) -> Any:
    """A ``scipy.stats`` distribution by name, frozen with its shape numbers, location and scale.

    Raises:
        ValueError: no such continuous distribution, or numbers that it does not take.
    """
    from scipy import stats

    distribution = getattr(stats, name, None)
    if not isinstance(distribution, stats.rv_continuous):
        allowed = [n for n in stats.__all__ if isinstance(getattr(stats, n), stats.rv_continuous)]
        sentence = unknown_name("distribution", name, allowed).partition(" Allowed:")[0]
        raise ValueError(f"{where}: {sentence} Any continuous distribution of scipy.stats is allowed")
    try:
        frozen = distribution(*numbers)
    except TypeError as reason:
        raise ValueError(f"{where}: {name} does not take the numbers {list(numbers)}") from reason
    if not frozen.std() > 0:
        raise ValueError(f"{where}: {name} has no positive spread with the numbers {list(numbers)}")
    return frozen
