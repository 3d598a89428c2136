"""Last section of the report: the calls and versions that give the same numbers again."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from rotorfit.base.version import VERSIONS
from rotorfit.identify.fitting.causes.calibration import Calibration
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitOptions, FitSettings
from rotorfit.identify.options.table import SHAFT, command_words
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.recordings.formats.files import ALWAYS_RAW
from rotorfit.models import LAWS, MODELS, Law, Orthotropic, RotorModel
from rotorfit.show.report.html import Html, element, paragraph
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.parts import section, sentence

_SAMPLER = ("ess", "walkers", "max_steps", "noise")
"""Settings of the sampler."""


def reproduce_section(material: ReportInput) -> Html:
    """Versions and settings."""

    fit = material.fit
    packages = ["casadi", "numpy", "scipy", "matplotlib", *(["emcee"] if material.posterior is not None else [])]
    versions = [f"rotorfit {VERSIONS}", f"Python {platform.python_version()}"]
    versions += [f"{name} {version(name)}" for name in packages]
    command = material.command or _command(material)
    shell = [paragraph("On the command line:"), element("pre", command)] if command else []
    return section(
        "To reproduce",
        paragraph("In Python:"),
        element("pre", "\n".join(_calls(material))),
        *shell,
        paragraph(sentence(f"{fit.method}: {fit.message}; {fit.nfev} evaluations of the model")),
        paragraph(", ".join(versions), "."),
    )


# ---- Python ----------------------------------------------------------------------------------


def _origin(material: ReportInput) -> tuple[FitResult, bool]:
    """The fit that was asked for, and whether the one reported is its refinement."""
    refinement = material.refinement
    if refinement is None or material.fit is not refinement.best:
        return material.fit, False
    first, best = refinement.steps[0], material.fit
    if best.settings.causes is None:
        return first, True
    asked = replace(first.settings, causes=best.settings.causes, start={})  # candidates are compared without causes
    return replace(first, settings=asked), True


def _source(experiment: Experiment, reading: Mapping[str, Mapping[str, Any]] = MappingProxyType({})) -> str:
    """How an experiment came about."""
    if not experiment.source:
        return "data_in_memory"
    recorded = _recorded(experiment.source)
    given = reading.get(recorded[0][0] if recorded else experiment.source, {})
    chosen = "".join(f", {name}={_shown(value)}" for name, value in given.items())
    if recorded is None:
        return f"rf.read({experiment.source!r}{chosen})"
    files, setup = recorded
    rest = f", {setup!r}" if setup else ""
    records = f"[{', '.join(f'rf.read_recording({name!r}{rest})' for name in files)}]"
    options = "".join(f", {name}={value:g}" for name, value in experiment.reduced_with.items())
    return f"rf.{experiment.reducer}({records}{options}{chosen})"


def _recorded(source: str) -> tuple[list[str], str] | None:
    """Files of recordings and their setup, None for a file of responses; the source is written by ``rf.responses``."""
    names, _, setup = source.partition(" with ")
    files = names.split(", ")
    return (files, setup) if all(Path(name).suffix.lower() in ALWAYS_RAW for name in files) or setup else None


def _calls(material: ReportInput) -> Iterator[str]:
    fit, refined = _origin(material)
    yield "import rotorfit as rf"
    if fit.settings.priors:
        yield "import scipy.stats"
    sources = [_source(experiment, material.reading) for experiment in fit.experiments]
    yield f"model = {_shown(fit.model)}"
    yield f"experiments = [{', '.join(sources)}]"
    parts = [f"{name}={_shown(value)}" for name, value in _given(fit.settings).items()]
    call = "rf.closed_form" if fit.method == "closed form" else "rf.fit"
    made = f"{call}({', '.join(['model, experiments', *parts])})"
    yield f"fit = rf.refine({made}).best" if refined else f"fit = {made}"
    for p in material.profiles:
        yield f"fit.profile({p.name!r})"
    simulated, posterior = material.bootstrap, material.posterior
    if simulated is not None:
        yield f"fit.bootstrap(n={len(simulated.samples) + simulated.failures}, seed={simulated.seed})"
    if posterior is not None:
        asked = {"seed": posterior.seed, **{n: getattr(posterior.settings, n) for n in _SAMPLER}}
        yield f"posterior = fit.sample({', '.join(f'{name}={value!r}' for name, value in asked.items())})"


def _given(settings: FitSettings) -> dict[str, Any]:
    """Options of a fit by name, those left out that it has by default."""
    usual = FitSettings()
    names = (*(f.name for f in fields(FitOptions)), "baseline", "calibration")
    found = {name: getattr(settings, name) for name in names}
    return {n: v for n, v in found.items() if (v or v is None) and v != getattr(usual, n)}


def _own_options(model: RotorModel) -> dict[str, Any]:
    """Options of a model that are not those it has by default."""
    try:
        usual = type(model)().options()
    except TypeError:  # a model that cannot be made without arguments
        usual = {}
    given = model.options()
    return {name: value for name, value in given.items() if name not in usual or _shown(value) != _shown(usual[name])}


def _shown(value: Any) -> str:
    """A setting as Python would write it; large arrays by their shape."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k!r}: {_shown(v)}" for k, v in value.items()) + "}"
    if isinstance(value, np.ndarray):
        return f"<array {' × '.join(map(str, value.shape))}>"
    if isinstance(value, Experiment) or hasattr(value, "dist"):
        return _source(value) if isinstance(value, Experiment) else _distribution(value)
    if isinstance(value, RotorModel):
        return _model_shown(value)
    if isinstance(value, Law | Calibration):
        return f"rf.{'models.' if isinstance(value, Law) else ''}{value!r}"
    return repr(tuple(value) if isinstance(value, list) else value)


def _model_shown(model: RotorModel) -> str:
    if model.made_from:
        (_, path), *rest = model.made_from.items()
        return f"rf.models.KnownStructure.from_ross({', '.join([repr(path), *(f'{n}={_shown(v)}' for n, v in rest)])})"
    options = ", ".join(f"{name}={_shown(option)}" for name, option in _own_options(model).items())
    home = "rf.models." if type(model).__module__.startswith("rotorfit.models.") else ""
    return f"{home}{type(model).__name__}({options})"


def _distribution(prior: Any) -> str:
    words = [f"{v:g}" for v in prior.args] + [f"{k}={v:g}" for k, v in prior.kwds.items()]
    return f"scipy.stats.{prior.dist.name}({', '.join(words)})"


# ---- command line ------------------------------------------------------------------------------


_MODEL_OPTIONS = {
    "planes", "blocks", "two_lam", "law", "clearance_um", "modes", "gains", "apart", "residuals", "probes", "betas",
}  # fmt: skip
"""Options of models that the command line has, ``betas`` by a value that is known or free."""


def _command(material: ReportInput) -> str:
    """The call of the command line, empty where it cannot say what was asked for."""
    fit, refined = _origin(material)
    settings = fit.settings
    model, supports = (fit.model.base, fit.model.at) if isinstance(fit.model, Orthotropic) else (fit.model, ())
    shaft = dict(model.made_from)
    options = shaft or _own_options(model)
    calibrated = vars(settings.calibration) if settings.calibration else {}
    expressible = (
        fit.method == "least squares"
        and (model.name in MODELS or shaft)
        and all(e.source for e in (*fit.experiments, *([settings.baseline] if settings.baseline else [])))
        and set(options) <= (set(SHAFT) | {"planes"} if shaft else _MODEL_OPTIONS)
        and ("law" not in options or options["law"] in [law() for law in LAWS.values()])
    )
    if not expressible:
        return ""
    asked: dict[str, Any] = {
        "operating": any(e.reducer == "operating_spectra" and e.source for e in fit.experiments),
        "runout_um": next((e.reduced_with["runout_um"] for e in fit.experiments if e.reduced_with), None),
        **options,
        "orthotropic": supports,
        "law": options["law"].name if "law" in options else "",
        **_given(settings),
        "baseline": "" if settings.baseline is None else settings.baseline.source,
        "calibration": {name: value for name, value in calibrated.items() if value},
        "refine": refined,
        "profile": tuple(p.name for p in material.profiles),
    }
    simulated, posterior = material.bootstrap, material.posterior
    if simulated is not None:
        asked |= {"bootstrap": len(simulated.samples) + simulated.failures, "seed": simulated.seed}
    if posterior is not None:
        limits = posterior.settings
        asked |= {"sample": True, "seed": posterior.seed, "ess": limits.ess, "max_steps": limits.max_steps}
    words = command_words(asked)
    if words is None:
        return ""
    files: list[str] = []
    for experiment in fit.experiments:
        names, setup = _recorded(experiment.source) or ([experiment.source], "")
        files += [*names, *(["--setup", setup] if setup else [])]
    named = [] if shaft else ["--model", model.name]
    return shlex.join(["rotorfit", "fit", *files, *named, *words, "--out", "results/"])
