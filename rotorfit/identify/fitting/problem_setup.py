"""Lay a fit out as an optimisation problem: experiments, settings and calibration become residuals and priors."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace, parameter_space
from rotorfit.estimators.misfit.priors import Prior, within_support
from rotorfit.estimators.misfit.problem import LOSSES, Problem
from rotorfit.identify.fitting.causes.solution import shifted
from rotorfit.identify.fitting.noise.error_bars import with_noise, without_noise
from rotorfit.identify.fitting.settings import FitSettings, PhaseOffsets
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment, in_words
from rotorfit.lab.data.weights import Influences, weighed
from rotorfit.lab.observing.baseline import with_baseline
from rotorfit.lab.observing.clearance import usable
from rotorfit.lab.observing.forced import correlated
from rotorfit.models import RotorModel


def as_tuple(experiments: Experiment | Sequence[Experiment]) -> tuple[Experiment, ...]:
    """One experiment or several, as a tuple."""
    if isinstance(experiments, str | Path):
        raise TypeError(f"a fit needs what rf.read returns, not the name of a file: rf.read({str(experiments)!r})")
    several = tuple(experiments) if isinstance(experiments, Sequence) else (experiments,)
    for experiment in several:
        if not isinstance(experiment, Experiment):
            raise TypeError(f"a fit needs experiments such as rf.read returns, not {type(experiment).__name__}")
    if not several or not all(len(e) for e in several):
        raise ValueError("nothing to fit: give at least one experiment with at least one reading")
    return several


def dry_run(baseline: Experiment | None) -> PerturbationTest | None:
    """A baseline as it is, if it is a test with measured forces."""
    if baseline is None:
        return None
    what = type(baseline).__name__
    if isinstance(baseline, Experiment):
        if (found := baseline.perturbation) is not None:
            return found
        what = baseline.title
    raise TypeError(f"a baseline is what rf.read returns of a dry run, responses to measured forces, not a {what}")


def check_model(model: Any) -> None:
    """Refuse a class, or a name, in place of a model."""
    if not isinstance(model, RotorModel):
        raise TypeError(f"the model must be an instance such as rf.models.WhirlWhip(), not {model!r}")


def build_problem(model: RotorModel, experiments: Experiment | Sequence[Experiment], settings: FitSettings) -> Problem:
    """Lay a fit out as an optimisation problem."""
    model = _checked(model, settings)
    blocks, suffixes = _observed(model, as_tuple(experiments), settings)
    spread = settings.noise is not None and any(effect.kind == "phase" for effect in settings.noise.effects)
    # Offsets of all runs about their mean, with a spread that was found, come with the noise.
    nuisance, parts = ((), []) if spread else _phase_entries(blocks, settings.phase_offsets)
    factors = tuple(np.hstack(own) for own in zip(*parts, strict=True)) if parts else (None,) * len(blocks)
    space = parameter_space(model, known=settings.held, bounds=settings.bounds, groups=suffixes, nuisance=nuisance)
    priors = make_priors(space, settings.priors)
    space = within_support(space, priors)
    problem = with_noise_scale(
        Problem(space=space, blocks=blocks, loss=settings.loss, priors=priors, factors=factors), settings.noise_scale
    )
    if settings.solved is not None:
        problem = shifted(problem, settings.solved.shift)
    if settings.noise is not None:
        problem = with_noise(problem, settings.noise)
    if space.size > problem.n_data:
        raise ValueError(f"{space.size} unknowns but only {problem.n_data} real data: fix parameters or add readings")
    return problem


def _checked(model: RotorModel, settings: FitSettings) -> RotorModel:
    """The model, with factors of its probes where settings name them; settings that contradict are refused."""
    check_model(model)
    names = {*settings.known, *settings.bounds, *settings.priors, *settings.per, *settings.start}
    betas = {name for name in names if name.startswith("beta")} - set(model.parameter_names)
    if betas and "betas" in model.options():  # factors of its probes, which settings name
        model = model.variant(betas=True)
    if settings.baseline is not None and settings.stator_mass_kg is not None:
        raise ValueError("baseline and stator_mass_kg are both given: the dry run holds the stator's mass; keep one")
    if settings.stator_mass_kg is not None and not 0 < settings.stator_mass_kg < math.inf:
        raise ValueError(f"stator_mass_kg is {settings.stator_mass_kg!r}; a mass is a positive number, kg")
    if settings.loss not in LOSSES:
        raise ValueError(unknown_name("loss", settings.loss, LOSSES))
    for name in settings.per:
        model.parameter(name)
    return model


def _observed(
    model: RotorModel, experiments: tuple[Experiment, ...], settings: FitSettings
) -> tuple[tuple[Block, ...], tuple[Mapping[str, str], ...]]:
    """Experiments as the model sees them, weights solved for their influences first, and the parameter groups by the
    suffixes of their names."""
    influences = [None if model.eccentricity_dependent else weighed(experiment) for experiment in experiments]
    if len(experiments) == 1 and influences[0] is not None:
        _check_modes(model, influences[0], settings)
    seen: tuple[Experiment, ...] = tuple(
        usable(model, experiment if found is None else found.test)[0]
        for experiment, found in zip(experiments, influences, strict=True)
    )
    suffixes, groups = group_rows(seen, settings.per)
    blocks: list[Block] = []
    for experiment, found, rows in zip(seen, influences, groups, strict=True):
        block = experiment.observe(model, rows).with_force_spectrum(settings.force_spectrum)
        if settings.loss != "linear" and not block.normal:
            raise ValueError(
                f"{experiment.source or experiment.title}: loss {settings.loss!r} is for readings that err one by one; "
                "averaged spectra have a likelihood of their own. Take 'linear' (loss=, --loss), and leave bands out "
                "that are not the rotor's (band_hz=)"
            )
        if found is not None and block.linear is not None:
            block = correlated(block.linear, found)
        blocks.append(with_baseline(model, block, experiment, settings.baseline, settings.stator_mass_kg))
    return tuple(blocks), suffixes


def _check_modes(model: RotorModel, influences: Influences, settings: FitSettings) -> None:
    """Refuse a model of more modes than weights at a few speeds show, unless something is known beforehand."""
    wanted = model.mode_count
    seen = influences.modes
    beforehand = settings.known or settings.priors or model.shaft is not None
    if seen is None or beforehand or not 0 < seen.count < wanted:
        return
    raise ValueError(
        f"{model.name} has {wanted} modes, but {influences.modes_told}. Fit a modal model, modes={seen.count} (--model "
        f"modal --modes {seen.count}), measure nearer to the next critical speed, or say what is known beforehand"
    )


def _phase_entries(
    blocks: Sequence[Block], offsets: PhaseOffsets
) -> tuple[tuple[str, ...], list[tuple[ComplexArray, ...]]]:
    """Names of the phases to fit, and for each block the sensitivities to them."""
    if offsets not in (True, False, "common"):
        raise ValueError(f"phase_offsets is {offsets!r}; allowed: False, True (one a run but the first), 'common'")
    if not offsets:
        return (), []
    phases = [block.by_turning_phase for block in blocks]
    turning = [block for block, own in zip(blocks, phases, strict=True) if own is not None]
    runs = list(dict.fromkeys(run for block in turning for run in block.run.tolist()))
    if offsets == "common" and not runs:
        raise ValueError("phase_offsets='common' needs responses to turning forces; these data have none")
    runs = runs if offsets == "common" else runs[1:]
    factors = [
        np.zeros((block.measured.size, len(runs)), dtype=complex)
        if own is None
        else own[:, None] * (block.run[:, None] == np.array(runs))
        for block, own in zip(blocks, phases, strict=True)
    ]
    if offsets == "common":
        return (DATUM,), [tuple(part.sum(axis=1, keepdims=True) for part in factors)]
    return tuple(f"phase[{run}]" for run in runs), [tuple(factors)] if runs else []


def with_noise_scale(problem: Problem, scale: Mapping[str, float], power: int = 1) -> Problem:
    """The problem with the noise of responses multiplied by factors of their own."""
    if not scale:
        return problem
    factor = np.array([scale.get(name, 1.0) for name in problem.channel_names])
    return problem.with_noise(factor[problem.channel] ** power)


def with_noise_of_data(problem: Problem, settings: FitSettings, x: Float) -> tuple[Problem, Float]:
    """The problem with the noise of the data alone, and the estimate that it gave: goodness of fit refers to both."""
    noise = settings.noise
    given = with_noise_scale(problem if noise is None else without_noise(problem, noise), settings.noise_scale, -1)
    count = given.space.size
    if settings.causes is not None:  # solved with the values that the fit ended with
        return given, x[:count]
    return given, noise.before if noise is not None and noise.before.size == count else x[:count]


def make_priors(space: ParameterSpace, priors: Mapping[str, Any]) -> tuple[Prior, ...]:
    """Priors of the fitted entries that names stand for, a parameter fitted per attribute for all of its own."""
    result = []
    for name, distribution in priors.items():
        if not (hasattr(distribution, "logpdf") and hasattr(distribution, "dist")):
            raise ValueError(
                f"prior of {name} must be a frozen scipy.stats distribution, continuous as norm(1.0, 0.1) is, "
                f"not {distribution!r}"
            )
        if not (np.isfinite(distribution.mean()) and 0 < distribution.std() < np.inf):
            raise ValueError(f"prior of {name} needs a finite mean and a positive, finite standard deviation")
        entries = [i for i, (n, b) in enumerate(zip(space.names, space.base, strict=True)) if name in (n, b)]
        if not entries:
            if name in space.model.parameter_names:
                raise ValueError(f"prior of {name}: it is known here, so nothing is fitted; keep one of the two")
            raise KeyError(unknown_name("fitted parameter", name, space.names))
        support = distribution.support()
        for i in entries:
            low, high = float(space.lower[i]), float(space.upper[i])
            if not max(low, support[0]) < min(high, support[1]):
                raise ValueError(
                    f"prior of {name} allows [{support[0]:g}, {support[1]:g}], its bounds [{low:g}, {high:g}]: nothing "
                    "is left; change either"
                )
        result += [Prior(i, distribution) for i in entries]
    return tuple(result)


def each_of(
    model: RotorModel, per: Mapping[str, str], known: Mapping[str, float | tuple[float, float] | None]
) -> Mapping[str, str]:
    """Parameters that take one value for each value of an attribute; ``K*`` is every one that begins so and is fitted.

    Raises:
        KeyError: none does.
    """
    check_model(model)
    found: dict[str, str] = {}
    for name, attribute in per.items():
        names = [name]
        if "*" in name:
            fitted = [one.name for one in model.parameters if known.get(one.name, one.default) is None]
            names = fnmatch.filter(fitted, name)
            if not names:
                there = ", ".join(fitted) or "none"
                raise KeyError(f"per: no fitted parameter of {model.name} is like {name!r}; there are {there}")
        found |= dict.fromkeys(names, attribute)
    return found


def group_rows(
    experiments: Sequence[Experiment], per: Mapping[str, str]
) -> tuple[tuple[Mapping[str, str], ...], tuple[Index, ...]]:
    """Group rows by the distinct values of attributes: for each group that shares one parameter vector the suffix of
    each ``per`` parameter, and for each experiment the group of each of its rows."""
    if not per:
        return ({},), tuple(np.zeros(len(experiment), dtype=np.intp) for experiment in experiments)
    seen: dict[tuple[str, ...], int] = {}
    rows = []
    for experiment in experiments:
        keys = [[f"{name}={in_words(v)}" for v in experiment.attribute(name).tolist()] for name in per.values()]
        tuples = zip(*keys, strict=True)
        rows.append(np.array([seen.setdefault(key, len(seen)) for key in tuples], dtype=np.intp))
    return tuple(dict(zip(per, key, strict=True)) for key in seen), tuple(rows)
