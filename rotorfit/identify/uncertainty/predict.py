"""Responses that a fitted rotor would give elsewhere, from a fit and from a posterior."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import quantile
from rotorfit.base.units import RPM_PER_RAD_S, in_rad_s
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.inference.cause_acts import Motion, moving
from rotorfit.estimators.inference.causes import block_with_causes
from rotorfit.estimators.inference.covariance import spreading
from rotorfit.identify.fitting.quantities import Share
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.derived import DERIVED_DRAWS
from rotorfit.identify.uncertainty.prediction import Prediction, along_and_across
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.models.motion.stability import growth_rate


def predict(
    fit: FitResult,
    frequency: ArrayLike | None,
    speed: ArrayLike | None,
    *,
    frequency_rpm: ArrayLike | None = None,
    frequency_hz: ArrayLike | None = None,
    speed_rpm: ArrayLike | None = None,
    force_plane: str | None = None,
    force: complex | None = None,
    mr: complex | None = None,
    plane: str | None = None,
    direction: str | None = None,
    level: float = 0.95,
    whole: bool = False,
    share: Share = "all",
    at: Mapping[str, Any] | None = None,
    thetas: Float | None = None,
) -> Prediction:
    """Responses with their bands, by the fit's covariance or over parameter vectors of draws, shape ``(W, P)``."""
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; a band has a probability between 0 and 1")
    frequency = in_rad_s("frequency", frequency, needed=False, rpm=frequency_rpm, hz=frequency_hz)
    speed = in_rad_s("speed", speed, rpm=speed_rpm)
    check_rotor(fit)
    model, group = fit.model, fit.group(at)
    test = _planned(fit, frequency, speed, force_plane, force, mr, plane, direction)
    _refuse_unstable(fit, group, np.unique(test.speed))
    block = _with_rotor_causes(fit, _block(fit, test, group))
    response, covariance, freedom, spread = (
        _by_covariance(fit, block, group) if thetas is None else _by_draws(fit, block, thetas)
    )
    noise = _noise(fit, test, model.coordinate(test.plane[0], str(test.direction[0])[-1]), response)
    moved = np.zeros((0, response.size, 2)) if share == "noise" else _moved(fit, block, spread, thetas is not None)
    systematic = np.einsum("kni,knj->nij", moved, moved)
    wider = 1 + np.nan_to_num(np.trace(systematic, axis1=1, axis2=2) / np.trace(covariance, axis1=1, axis2=2))
    # Satterthwaite: the systematic share is taken as known.
    reach = reach_new = np.array([quantile(level, one) for one in (freedom * wider**2).tolist()])
    if whole:
        scale = reach / quantile(level, math.inf)  # of t over that of the normal distribution
        errors = spread
        if thetas is None:  # simulated errors of the parts of whole curves, shape (W, N, 2)
            solved = fit.settings.solved
            covar = fit.covar if solved is None else fit.covar - solved.errors.covariance
            drawn = np.random.default_rng(1).normal(size=(DERIVED_DRAWS, fit.x.size)) @ spreading(covar).T
            errors = np.einsum("wp,nip->wni", drawn, spread)
        sizes = np.random.default_rng(2).normal(size=(len(errors), len(moved)))
        errors = errors + np.einsum("wk,kni->wni", sizes, moved)
        known = np.nan_to_num(noise)[:, None]
        own = np.random.default_rng(0).normal(size=errors.shape) * known
        both = covariance + systematic
        new = both + known[:, None] ** 2 * np.eye(2)
        reach = scale * _largest(response, both, errors, level)
        reach_new = scale * _largest(response, new, errors + own, level)
    return Prediction(
        frequency=test.frequency,
        speed=test.speed,
        plane=str(test.plane[0]),
        direction=str(test.direction[0]),
        force_plane=str(test.force_plane[0]),
        response=response,
        covariance=covariance,
        systematic=systematic,
        noise=noise,
        reach=reach,
        reach_new=reach_new,
        level=level,
        whole=whole,
        notes=_notes(fit, test, noise),
    )


_Mean: TypeAlias = tuple[ComplexArray, Float, Float, Float]
"""Responses ``(N,)`` with the covariance of their parts, its degrees of freedom, and what whole curves vary by."""


def _by_covariance(fit: FitResult, block: Block, group: int) -> _Mean:
    """By a fit; curves vary by their slopes by the fitted vector, shape ``(N, 2, p)``."""
    response, slopes = _slopes(fit, block, group)
    covar = fit.covar if fit.settings.solved is None else fit.covar - fit.settings.solved.errors.covariance
    covariance = slopes @ covar @ slopes.transpose(0, 2, 1)
    undetermined = fit.identifiability.leaves_open(np.abs(response), slopes) if fit.success else np.s_[:]
    covariance[undetermined] = np.inf
    freedom = np.full(len(slopes), fit.freedom)
    if fit.noise is not None:  # the fewer of those of real and imaginary part
        freedom = np.array([min(fit.noise.degrees(part) for part in point) for point in slopes])
    return response, covariance, freedom, slopes


def _by_draws(fit: FitResult, block: Block, thetas: Float) -> _Mean:
    """Over parameter vectors; curves vary by the errors of each, shape ``(W, N, 2)``."""
    drawn = np.array([block.predict(np.broadcast_to(t, fit.thetas.shape)) for t in thetas])
    response = drawn.mean(axis=0)
    errors = np.stack([drawn.real, drawn.imag], axis=2) - np.column_stack([response.real, response.imag])
    covariance = np.einsum("wni,wnj->nij", errors, errors) / (len(errors) - 1)
    return response, covariance, np.full(response.size, np.inf), errors


def _with_rotor_causes(fit: FitResult, block: Block) -> Block:
    """The block with the causes that move the rotor, as they were found, in its predictions."""
    solved = fit.settings.solved
    if solved is None:
        return block
    sizes = np.where([moving(cause.act) for cause in solved.causes], solved.errors.value, 0.0)
    return block_with_causes(block, fit.thetas, solved.causes, sizes) if sizes.any() else block


def rotor_changes(fit: FitResult, block: Block) -> ComplexArray:
    """Changes of predictions by a unit of each cause that moves the rotor, the fitted values held, shape ``(N, k)``."""
    solved = fit.settings.solved
    if solved is None:
        return np.zeros((block.measured.size, 0), dtype=complex)
    motion, still = Motion(block=block, theta=fit.thetas), np.zeros(block.measured.size, dtype=complex)
    return np.array([c.act.change(motion) if moving(c.act) else still for c in solved.causes]).T


def _moved(fit: FitResult, block: Block, slopes: Float, drawn: bool) -> Float:
    """Changes of real and imaginary parts ``(K, N, 2)`` whose squares add up to what causes of the rotor leave open: by
    themselves, and by what they did to the fitted values, which draws of a posterior hold already."""
    solved = fit.settings.solved
    if solved is None:
        return np.zeros((0, block.measured.size, 2))
    direct = rotor_changes(fit, block).T
    change = np.stack([direct.real, direct.imag], axis=2)
    if not drawn:
        change = change + np.einsum("nip,pk->kni", slopes, solved.errors.moves)
    root = spreading(solved.errors.covar) * math.sqrt(solved.errors.widened)
    return np.asarray(np.einsum("kni,kj->jni", change, root))


def _slopes(fit: FitResult, block: Block, group: int) -> tuple[ComplexArray, Float]:
    """Predicted responses ``(N,)`` and the derivatives of their parts by the fitted parameters, ``(N, 2, p)``."""
    response, slope = block.predict_jacobian(fit.thetas)
    return response, np.stack([fit.problem.space.pull_back(part, group) for part in (slope.real, slope.imag)], axis=1)


def _planned(
    fit: FitResult,
    frequency: ArrayLike | None,
    speed: ArrayLike,
    force_plane: str | None,
    force: complex | None,
    mr: complex | None,
    plane: str | None,
    direction: str | None,
) -> PerturbationTest:
    """The readings to predict, as a test whose readings are not known yet."""
    model = fit.model
    speeds = np.atleast_1d(np.asarray(speed, dtype=float))
    w = speeds if frequency is None else np.atleast_1d(np.asarray(frequency, dtype=float))
    try:
        w, speeds = (np.array(values) for values in np.broadcast_arrays(w, speeds))
    except ValueError:
        counts = f"{w.size} frequencies and {speeds.size} speeds"
        raise ValueError(f"{counts} do not go together; give one of either") from None
    if w.ndim != 1 or not w.size or not (np.isfinite(w).all() and np.isfinite(speeds).all()):
        raise ValueError("frequency and speed are finite numbers or vectors of them, rad/s")
    if force is not None and mr is not None:
        raise ValueError("give a force, N, or an unbalance mr, kg m, not both")
    where = _plane("force plane", force_plane, model.planes)
    check_forced(model, where)
    drive = np.full(w.shape, 1.0 if force is None else force, dtype=complex) if mr is None else mr * w**2 + 0j
    if not (np.isfinite(drive).all() and drive.all()):
        raise ValueError("the force is zero or not finite: there is no response to predict")
    read = ("z" if model.frame == "z" else "x") if direction is None else direction
    seen = where if plane is None else plane
    check_read(model, seen, read)
    return PerturbationTest(
        run=np.full(w.shape, "prediction"),
        speed=speeds,
        frequency=w,
        force_plane=np.full(w.shape, where),
        force=drive,
        plane=np.full(w.shape, seen),
        direction=np.full(w.shape, read),
        response=np.full(w.shape, 1e-9, dtype=complex),  # m, inside any clearance: to be predicted, none of it is used
        sigma=np.ones(w.shape),
        source="prediction",
    )


def check_rotor(fit: FitResult) -> None:
    """Refuse what a fit without its rig, a seal or bearing by itself, cannot tell."""
    if fit.settings.baseline is not None or fit.settings.stator_mass_kg is not None:
        raise ValueError(
            f"the rig was taken out of this fit (baseline=, stator_mass_kg=): {fit.model.name} is the force of the "
            "seal or bearing alone, which moves nothing by itself. Put its coefficients into a rotor: fit.to_ross(), "
            "coefficients.csv"
        )


def check_forced(model: RotorModel, plane: str) -> None:
    """Refuse a force of which the model does not know what it does."""
    if not model.is_forced(plane):
        known = ", ".join(one for one in model.planes if model.is_forced(one))
        raise ValueError(
            f"no force acted at {plane}: modes alone tell what forces do at {known} and nowhere else. Test with a "
            f"force or a weight at {plane}, or fit a model with a structure (Chain, KnownStructure)"
        )


def check_read(model: RotorModel, plane: str, axis: str) -> None:
    """Refuse motion that the model does not know; an empty axis stands for any."""
    _plane("plane", plane, (*model.planes, *(name for name, _ in model.probes)))
    seen = [one for one in ("z", "x", "y") if model.is_read(plane, one)]
    if seen and (axis in seen or axis[-1:] not in ("x", "y")):
        return
    alone = {one: [axis for axis in ("x", "y") if model.is_read(one, axis)] for one in model.read_planes}
    known = ", ".join(f"{one} along {axes[0]}" if len(axes) == 1 else one for one, axes in alone.items())
    raise ValueError(
        f"no probe read {f'{plane} along {axis[-1]}' if seen else plane}: modes alone tell how planes move where "
        f"probes were, {known}. Choose one of these (plane=, --plane), put a probe there, or fit a model with a "
        f"structure (Chain, KnownStructure), which says how {plane} moves with the others"
    )


def _plane(what: str, name: str | None, planes: Sequence[str]) -> str:
    if name is None and len(planes) == 1:
        return str(planes[0])
    if name is None:
        raise ValueError(
            f"give the {what} ({what.replace(' ', '_')}=, --{what.replace(' ', '-')}): one of {', '.join(planes)}"
        )
    if name not in planes:
        raise ValueError(unknown_name(what, name, planes))
    return name


def _block(fit: FitResult, test: PerturbationTest, group: int) -> Block:
    """The readings in the model's coordinates; of a fluid that changes with eccentricity, orbits followed from rest."""
    block = test.observe(fit.model, np.full(len(test), group, dtype=np.intp))
    if not block.centred:
        raise ValueError("orbits about an equilibrium off the centre are not predicted")
    return block.from_rest(one_sweep=True)


def _refuse_unstable(fit: FitResult, group: int, speeds: Float) -> None:
    """Refuse speeds at which a response would not be steady."""
    for value in speeds.tolist():
        if growth_rate(fit.model, fit.thetas[group], value, fit.stability_band) > 0:
            onset = significant(fit.threshold_of(group).value * RPM_PER_RAD_S, 5)
            limit = (
                f"; speeds are allowed below its threshold of {onset} rpm" if fit.threshold_of(group).value > 0 else ""
            )
            at = f"{significant(value * RPM_PER_RAD_S, 5)} rpm ({significant(value, 5)} rad/s)"
            raise ValueError(
                f"the fitted rotor is unstable at {at}: it whirls by itself, and has no steady response to a force"
                f"{limit}"
            )


def _largest(response: ComplexArray, covariance: Float, errors: Float, level: float) -> Float:
    """Quantile of the largest error of a curve, over standard errors, in amplitude or phase."""
    unit = np.exp(1j * np.angle(response))
    turned = (errors[..., 0] + 1j * errors[..., 1]) / unit
    determined = np.isfinite(covariance).all(axis=(1, 2)) & (np.abs(response) > 0)
    if not determined.any():
        return np.asarray(np.inf)
    along, across = along_and_across(response[determined], covariance[determined])
    turned = turned[:, determined]
    worst = np.maximum(np.abs(turned.real) / along, np.abs(turned.imag) / across).max(axis=1)
    return np.asarray(np.quantile(worst, level))


def _noise(fit: FitResult, test: PerturbationTest, coordinate: int, response: ComplexArray) -> Float:
    """Noise of a new reading: that of the fitted readings of its coordinate, a constant and a share of the response."""
    sigma, size = [], []
    for block, predicted in zip(fit.problem.blocks, fit.problem.predict(fit.x), strict=True):
        base = block.responses
        if base is not None and not base.imposed:
            rows = base.coordinate == coordinate
            sigma.append(base.sigma[rows])
            size.append(np.abs(predicted[rows]))
    variance, power = np.concatenate([*sigma, []]) ** 2, np.concatenate([*size, []]) ** 2
    if not variance.size:
        return np.full(response.size, np.nan)
    from scipy.optimize import nnls

    # Relative errors of the variances count, which span decades where noise is proportional.
    columns = np.column_stack([np.ones_like(power), power]) / variance[:, None]
    top = columns.max(axis=0)
    shares = nnls(columns / top, np.ones(variance.size))[0] / top
    return np.asarray(np.sqrt(fit.widening * (shares[0] + shares[1] * np.abs(response) ** 2)))


def _notes(fit: FitResult, test: PerturbationTest, noise: Float) -> tuple[str, ...]:
    """Notes on the bands."""
    bases = fit.problem.responses
    found: list[str] = []
    for what, values, tested in (
        ("speeds", test.speed, [base.speed for base in bases]),
        ("frequencies", test.frequency, [base.frequency for base in bases]),
    ):
        found += extrapolation(what, values, tested)
    if np.isnan(noise).any():
        found.append(f"No readings at {test.plane[0]} were fitted: the noise of a new reading there is not known.")
    if fit.model_limited:
        found.append("The model misses the data beyond their noise: the bands may be too narrow.")
    if fit.noise is not None and fit.noise.effects:
        found.append("Runs differ: a new run differs from the mean by more than the band of a new reading.")
    return tuple(found)


def extrapolation(what: str, values: Float, tested: Sequence[Float]) -> list[str]:
    """A sentence where values lie outside the tested ones of their sign."""
    if not tested:
        return [f"The fit has no responses to forces that turn: all {what} are extrapolated."]
    known = np.concatenate(tested)
    low, high = np.full(values.shape, np.inf), np.full(values.shape, -np.inf)
    for sign in (-1.0, 0.0, 1.0):
        same = known[np.sign(known) == sign]
        if same.size:
            here = np.sign(values) == sign
            low[here], high[here] = same.min(), same.max()
    margin = SPEED_TOLERANCE * np.abs(known).max(initial=0.0)
    below = values < low - margin
    sides = [values[below] * RPM_PER_RAD_S, values[~below & (values > high + margin)] * RPM_PER_RAD_S]
    count = sum(side.size for side in sides)
    if not count:
        return []
    where = " and ".join(_span(side.min(), side.max()) for side in sides if side.size)
    tested_span = _span(known.min() * RPM_PER_RAD_S, known.max() * RPM_PER_RAD_S)
    verb = "lie" if count > 1 else "lies"
    return [f"Extrapolated: {count} of {values.size} {what}, {where} rpm, {verb} outside the tested {tested_span} rpm."]


def _span(low: float, high: float) -> str:
    ends = significant(low, 5), significant(high, 5)
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)
