"""Sentences worth reading about a fit: misfit, noise that is too large, bounds, a rotor that could not have run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.blocks.shaft_lines import LineResponses
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.inference.identifiability import Identifiability
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.fitting.noise.residual_study import MODEL_LIMITED_REDCHI, ResidualStudy, is_misfit
from rotorfit.fitting.quantities import FittedParameter
from rotorfit.models import BLOCKS, Modal, RotorModel
from rotorfit.models.array_types import Bool, Float
from rotorfit.models.digits import significant
from rotorfit.models.motion.stability import growth_rate, stability_band
from rotorfit.units import RPM_PER_RAD_S

EXACT_REDCHI = 1e-4  # redchi below which the data are exact, and their noise the floor that keeps weights finite

_FILTERED = (
    "Noise that is correlated along the lines, as behind overlapping filters, looks the same where sigma is not "
    "known: standard errors include that too. Give sigma_um as repeated sweeps show it, to separate them"
)


def fit_warnings(
    problem: Problem,
    x: Float,
    redchi: float,
    params: Mapping[str, FittedParameter],
    identifiability: Identifiability,
    rescaled: bool,
    noise: ResidualStudy | None,
) -> list[str]:
    """Warnings for a reader of the result."""
    found = [] if noise is None else noise.warnings(redchi)
    advice = _advice(problem, identifiability, rescaled)
    nfree = problem.n_data - problem.space.size
    misfit = covariance.widening(redchi, problem.loss, nfree=nfree, freedom=freedom_of(problem.blocks))
    if is_misfit(noise, misfit) and not (noise is not None and noise.explained):
        where = f". It misses most: {', '.join(noise.places)}" if noise is not None and noise.places else ""
        wider = "the residuals of each response" if rescaled else significant(np.sqrt(redchi), 2)
        other = f". {_FILTERED}" if noise is not None and noise.perhaps_filtered else ""
        found.append(
            f"redchi is {significant(redchi, 3)}: the model, not the noise, limits this fit. Standard errors are "
            f"widened by {wider}, but parameters may be biased beyond them; {advice}{where}{other}"
        )
    if noise is not None and noise.odd_run and redchi > MODEL_LIMITED_REDCHI:
        found.append(noise.odd_run)
    quiet_deviations = 6.0  # standard deviations of redchi below one at which the noise is too large for the residuals
    quiet_redchi = 0.5  # redchi below which errors are wider than they need be by more than is worth knowing
    if EXACT_REDCHI < redchi < min(quiet_redchi, 1 - quiet_deviations * np.sqrt(2 / max(nfree, 1))):
        found.append(
            f"redchi is {significant(redchi, 2)}: the noise is overestimated, and standard errors are about "
            f"{significant(1 / np.sqrt(redchi), 2)} times too wide. Give the noise of the readings (sigma_um), "
            "or more lines"
        )
    if problem.loss != "linear":
        # the median of |r|^2 is 2 ln 2 for noise alone, and hardly moves for a few outliers
        typical = float(np.median(np.abs(problem.residuals(x)) ** 2)) / (2 * np.log(2))
        if typical > MODEL_LIMITED_REDCHI:
            found.append(
                f"the squared residuals of most readings are {significant(typical, 2)} times those of the noise: not "
                f"outliers but the model limits this fit, and parameters may be biased; {advice}"
            )
    found += [
        f"{p.name} rests on its bound at {p.value:.6g}{'' if p.unit == '1' else ' ' + p.unit}"
        for p in params.values()
        if p.at_bound
    ]
    lines = [block for block in problem.blocks if isinstance(block, LineResponses)]
    if lines and all((block.line == "w").all() for block in lines) and identifiability.unresolved:
        left = ", ".join(identifiability.unresolved)
        found.append(
            f"these data hold the motion at w alone, which leaves {left} open: a shaft of unequal stiffness shows in "
            "the image at 2x - w and in its twist. Of recordings rf.shaft_lines reads these lines, not rf.responses"
        )
    return found + _instability(problem, x, identifiability.unresolved)


def _advice(problem: Problem, identifiability: Identifiability, rescaled: bool) -> str:
    """Advice for a fit that its model limits: structural blocks only where more can be added."""
    model = problem.space.model
    if isinstance(model, Modal):
        return "add modes, or let x and y differ (apart)"
    for block in problem.responses:  # motion along x and y under forces along one of them
        along = [block.force[:, [c.axis == axis for c in model.coordinates]].any(axis=1) for axis in "xy"]
        if (along[0] ^ along[1]).any():
            return (
                "forces are given along one axis at a time: if the other shaker pushes too, give what both load cells "
                "say (force_x_N, force_y_N)"
            )
    if not hasattr(model, "blocks"):
        return f"{model.name} has no structural blocks to add; a model of more planes may fit"
    if rescaled or len(model.blocks) == len(BLOCKS):
        return "bring the shaft's matrices (KnownStructure)"
    if why_not_refined(model, identifiability):
        left = ", ".join(identifiability.unresolved)
        return f"give known values or priors for what the data leave open first ({left})"
    return "try a refined model (rf.refine, --refine)"


def _instability(problem: Problem, x: Float, unresolved: Sequence[str]) -> list[str]:
    """Speeds at which a rotor with the fitted values could not have been tested, three at most."""
    theta = problem.space.theta(x)
    model = problem.space.model
    found: list[str] = []
    left = ", ".join(unresolved)
    remedy = "Check signs, directions and the model"
    if left:
        remedy = f"These data leave {left} open: give known values or priors before you look for an error in the data"
    for block in problem.responses:
        if block.imposed or not block.frequency.any():
            continue  # under a static load the journal may run where centred it could not
        _, group, speed = block.at_set_speed().condition
        rates, grows = growth(model, theta[group], speed, block.frequency)
        for v, rate, some in zip(speed, rates, grows, strict=True):
            if some and len(set(found)) < 3:
                where = f"the tested speed of {v * RPM_PER_RAD_S:.0f} rpm" if model.speed_dependent else "any speed"
                found.append(
                    f"the fitted rotor is unstable at {where} (growth rate {significant(rate, 3)} 1/s): a rig could "
                    f"not have been measured there. {remedy}"
                )
    return list(dict.fromkeys(found))


def growth(model: RotorModel, theta: Float, speed: Float, frequency: Float) -> tuple[Float, Bool]:
    """Largest growth rate, 1/s, of rotors at tested speeds, and whether it is more than round-off, shape ``(K,)``."""
    band = stability_band(model, float(np.abs(frequency).max()))
    if len(speed) == 1:  # one by numbers: arrays of one entry cost several times as much
        rates = growth_rate(model, theta[0], speed[0], band)[None]
    else:
        rates = growth_rate(model, theta, speed, band)
    return rates, np.asarray(rates > 1e-9 * np.abs(theta).max(axis=1))


def why_not_refined(model: RotorModel, identifiability: Identifiability) -> str:
    """Why :func:`rotorfit.refine` refuses a fit; empty where it can be tried."""
    if not hasattr(model, "blocks"):
        return f"{model.name} has no structural blocks to add: they couple two or more planes"
    if identifiability.unresolved:
        return f"resolve the parameters of the plain model before adding to it. {identifiability}"
    return ""
