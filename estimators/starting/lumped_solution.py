"""From lumped coefficients, such as K1 + K2 or D lam, to the parameters of a model."""

from __future__ import annotations

import numpy as np

from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.starting.force_balance import solve_definite
from rotorfit.estimators.starting.lumped import Lumped
from rotorfit.models.array_types import Float


def parameters_from(
    space: ParameterSpace, lumped: Lumped, values: Float, information: Float | None
) -> tuple[Float, tuple[str, ...]]:
    """Solve the lumped expressions for the parameters, one unknown at a time, then take one weighted step on all."""
    size = len(space.names)
    x = lumped.parameters(values, typical_values(space))
    notes: tuple[str, ...] = ()
    if np.isnan(x).any():
        x, notes = _remaining(space, lumped, values, x)
    if information is not None:
        x = _one_step(lumped, values, information, x)
    inside = np.clip(x, space.lower[:size], space.upper[:size])
    return np.where(np.isfinite(inside), inside, np.nan), notes


def _remaining(space: ParameterSpace, lumped: Lumped, values: Float, x: Float) -> tuple[Float, tuple[str, ...]]:
    """Parameters that no single expression gives: solve the coupled lumped equations, or take a typical value."""
    from scipy.optimize import least_squares

    missing = np.flatnonzero(np.isnan(x))
    names = [space.names[i] for i in missing]
    typical = typical_values(space)[missing]
    start = x.copy()
    start[missing] = typical
    now, slopes = lumped.linearise(start)
    level = np.maximum(np.abs(values), np.abs(now))
    weight = 1.0 / np.where(level > 0, level, 1.0)
    influence = slopes[:, missing] * weight[:, None] * typical
    silent = np.linalg.norm(influence, axis=0) == 0

    def residual(u: Float) -> Float:
        y = start.copy()
        y[missing] = u * typical
        return np.asarray((lumped.values(y) - values) * weight)

    solved = least_squares(residual, np.ones(missing.size), x_scale="jac", max_nfev=50)
    start[missing] = np.where(silent, 1.0, solved.x) * typical
    open_ones = [name for name, unseen in zip(names, silent.tolist(), strict=True) if unseen]
    return start, (
        (f"{', '.join(open_ones)}: no coefficient depends on it; a typical value is taken",) if open_ones else ()
    )


def typical_values(space: ParameterSpace) -> Float:
    """Nonzero sizes of the free parameters, shape ``(p,)``."""
    parameters = [space.model.parameter(name) for name in space.base]
    size = len(parameters)
    guess = np.array([p.scale if p.nominal is None else p.nominal for p in parameters])
    inside = np.clip(guess, space.lower[:size], space.upper[:size])
    return np.where(inside == 0, 1e-3, inside)


def typical_theta(space: ParameterSpace) -> Float:
    """All parameters of a model with the free ones at typical values."""
    return space.theta(np.concatenate([typical_values(space), np.zeros(len(space.nuisance))]))


def _one_step(lumped: Lumped, values: Float, information: Float, x: Float) -> Float:
    """One linearised weighted step on all lumped coefficients at once: it uses the redundant ones as well."""
    now, jacobian = lumped.linearise(x)
    # information is that of the independent coefficients b, all = S b + o: least squares on S(b_model - b) = 0
    J = lumped.back @ jacobian
    scale = np.maximum(np.abs(x), 1e-12)
    normal = J.T @ information @ J * np.outer(scale, scale)
    root = np.sqrt(np.maximum(normal.diagonal(), 1e-300))
    right = J.T @ information @ (lumped.back @ (values - now)) * scale / root
    unit = normal / np.outer(root, root)
    step = solve_definite(unit, right)
    if step is None:
        step = np.linalg.lstsq(unit, right, rcond=1e-10)[0]
    moved = x + step / root * scale
    # The linearisation holds near the solution only; a step that changes a parameter beyond its size is not taken.
    return moved if (np.abs(moved - x) <= 0.5 * np.abs(x) + 1e-300).all() else x
