"""The model that a study names, with the options that its data ask for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rotorfit.data.experiments import Experiment, LineTest
from rotorfit.models import LAWS, MODELS, AnisotropicShaft, Modal, Orthotropic, RotorModel
from rotorfit.models.parameters import unknown_name
from rotorfit.studies.modal_options import modal_options
from rotorfit.studies.study import Study


def check_model_name(name: str) -> None:
    """Refuse an unknown model."""
    if name not in MODELS:
        raise ValueError(unknown_name("model", name, MODELS))


def _has_twist(experiment: Experiment) -> bool:
    return isinstance(experiment, LineTest) and bool((experiment.direction == "twist").any())


def _has_start_up(experiment: Experiment) -> bool:
    """True if 1x and 2x were read over the speeds of a start-up, where run-out shows."""
    if not isinstance(experiment, LineTest):
        return False
    speeds = [set(experiment.speed[experiment.line == line].tolist()) for line in ("1x", "2x")]
    return min(map(len, speeds)) >= LineTest.START_UP


def build_model(study: Study, experiments: Sequence[Experiment]) -> RotorModel:
    """The model of a study."""
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
    if study.probes:
        options["probes"] = study.probes
    if study.clearance_um is not None:
        options["clearance_um"] = study.clearance_um
    model = MODELS[study.model]().variant(**options)
    return Orthotropic(model, study.orthotropic) if study.orthotropic else model
