"""A study: the files, every setting of one identification, the model that it names; and what it gave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles
from rotorfit.base.names import unknown_name
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.law_ranking import LawComparison
from rotorfit.identify.fitting.structure.refine import Refinement
from rotorfit.identify.options.kinds import is_set
from rotorfit.identify.options.table import SHAFT, StudyOptions
from rotorfit.identify.uncertainty.bootstrap import Bootstrap
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.identify.uncertainty.profile import Profile
from rotorfit.lab.data.experiments import perturbations
from rotorfit.lab.data.findings import Finding, attributed, error_sentence, errors_in, of_the_fit, warnings_in
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import LAWS, MODELS, AnisotropicShaft, Chain, KnownStructure, Modal, Orthotropic, RotorModel


@dataclass(frozen=True, kw_only=True)
class Study(StudyOptions):
    """Files, model and options of one identification; the names are those of the TOML keys."""

    files: tuple[DataFile | RecordingFiles, ...]  # test files and recordings, all of which inform one parameter vector
    model: str  # name of the model, a key of :data:`rotorfit.models.MODELS`
    out: Path | None = None  # folder for the results, nothing is written without one


_NOT_REFINED = (
    " The structure was not refined, since blocks of it would follow the error of the data: undo that first, or refine "
    "all the same (despite_errors = true, --despite-errors)."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """Result of a study."""

    study: Study  # the settings
    experiments: tuple[Experiment, ...]  # the data
    findings: tuple[tuple[Finding, ...], ...]  # what the data check found, file by file
    closed: FitResult | str  # the closed form, or the reason why there is none
    fit: FitResult  # the fit of the model as asked for
    ranking: LawComparison | None = None  # of laws of eccentricity, if asked for; the best one is fitted
    refinement: Refinement | None = None  # the structural refinement, if asked for
    posterior: Posterior | None = None  # of the result to act on, if asked for, as the two below
    profiles: tuple[Profile, ...] = ()
    bootstrap: Bootstrap | None = None
    command: str = ""  # what was typed for it

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
        own = [f"warning: {one.words}" for one in (*of_the_fit(self.fit.findings), *self.best.notices)]
        return (*warnings_in(attributed(self.findings, sources)), *own)

    @property
    def failure(self) -> str:
        """Errors of the data and searches that did not converge, in words; empty where all is well."""
        if self.data_errors:
            left_out = _NOT_REFINED if self.study.refine and self.refinement is None else ""
            return f"{error_sentence(self.data_errors)}{left_out}"
        if not self.best.success:
            return f"the fit did not converge: {self.best.message}"
        if self.posterior is not None and not self.posterior.converged:
            return f"the posterior's sampling has {self.posterior.message}"
        return ""


ALL_LAWS = "all"
"""The word for the laws that a ranking has by itself."""

# ---- the model ----------------------------------------------------------------------------------------------------


def check_model_name(name: str) -> None:
    """Refuse an unknown model."""
    if name == KnownStructure.name:
        raise ValueError(f"the model {name} is that of a shaft from a file: structure names its matrices (shaft.mat)")
    if name not in MODELS:
        raise ValueError(unknown_name("model", name, MODELS))


def check_model(study: Study) -> None:
    """Refuse an unknown model, and options of a shaft from a file without one."""
    if study.structure:
        if study.model != KnownStructure.name:
            raise ValueError(f"structure makes the model {KnownStructure.name}, not {study.model}; leave model out")
        return
    check_model_name(study.model)
    if study.law and study.laws:
        raise ValueError("law is one law, laws are several to choose from: give one of the two")
    for name in study.laws:
        if name not in (ALL_LAWS, *LAWS):
            raise ValueError(unknown_name("law", name, (ALL_LAWS, *LAWS)))
    own = ("fluid",) if study.model == Chain.name else ()
    idle = [name for name in SHAFT if getattr(study, name) and name not in own]
    if idle or isinstance(study.planes, Mapping):
        raise ValueError(
            f"{idle[0] if idle else 'planes with nodes'}: only for a shaft from a file, which structure names"
        )


def _shaft_of_file(study: Study) -> KnownStructure:
    """The shaft of a file with its planes and what is fitted."""
    replaced = {*study.fluid, *study.supports, *study.magnetic, *study.damping}
    if not isinstance(study.planes, Mapping) and not (replaced and not study.planes):
        given = ", ".join(study.planes) or "none"
        raise ValueError(f"planes: with structure each plane has its node, disk=7,journal=14; got {given}")
    planes = study.planes if isinstance(study.planes, Mapping) else {}
    options = {name: getattr(study, name) for name in SHAFT if name != "structure"}
    shaft: KnownStructure = KnownStructure.from_ross(study.structure, planes=planes, **options)
    return shaft


def build_model(study: Study, experiments: Sequence[Experiment]) -> RotorModel:
    """The model of a study."""
    check_model(study)
    options: dict[str, Any] = {}
    shaft = _shaft_of_file(study) if study.structure else None
    if isinstance(study.planes, tuple) and study.planes:
        options["planes"] = study.planes
    elif study.model == "anisotropic":  # has as many planes as the data, whatever they are called
        options["planes"] = tuple(dict.fromkeys(plane for experiment in experiments for plane in experiment.planes))
    if study.model == Chain.name and study.fluid:
        options["fluid"] = study.fluid if len(study.fluid) > 1 else study.fluid[0]
    if study.model == AnisotropicShaft.name:
        if not any(test.reads_twist for test in experiments):
            options["torsion"] = None
        if any(test.reads_start_up for test in experiments):
            options["runout"] = True
    if study.model == Modal.name:
        options |= modal_options(tuple(study.planes), experiments)
    names = ("modes", "gains", "apart", "blocks", "two_lam", "probes", "clearance_um")
    options |= {name: given for name in names if is_set(given := getattr(study, name)) and given != 0}
    if study.residuals is not None:
        options["residuals"] = study.residuals
    if study.law:
        if study.law not in LAWS:
            raise ValueError(unknown_name("law", study.law, LAWS))
        options["law"] = LAWS[study.law]()
    model = (shaft or MODELS[study.model]()).variant(**options)
    return Orthotropic(model, study.orthotropic) if study.orthotropic else model


def modal_options(planes: Sequence[str], experiments: Sequence[Experiment]) -> dict[str, Any]:
    """Options of a modal model that suit the data: of the planes that are forced and read, or else of all, the one that
    moves most is the one to normalise at."""
    tests = perturbations(experiments)
    size = {plane: 0.0 for test in tests for plane in (*test.planes, *test.force_planes)}
    for test in tests:
        for plane in test.planes:
            size[plane] = max(size[plane], float(np.sqrt(np.mean(np.abs(test.response[test.plane == plane]) ** 2))))
    driven = {p for t in tests for p in t.force_plane[t.force != 0].tolist() if p in t.planes}
    names = tuple(planes) or tuple(sorted(size, key=lambda plane: (plane not in driven, -size[plane])))
    forced = tuple(dict.fromkeys(p for t in tests for p in t.force_plane[t.force != 0].tolist() if p in names))
    axes: dict[str, set[str]] = {}
    for test in tests:
        for plane in (plane for plane in test.planes if plane in names):
            axes.setdefault(plane, set()).update(test.direction[test.plane == plane].tolist())
    paired = all(own == {"x", "y"} for own in axes.values())
    measured = tuple(axes)
    found = {"planes": names, "force_planes": forced, "probe_planes": measured}
    return {"gains": "probe" if paired else "plane", **{name: some for name, some in found.items() if some}}
