"""Which parameters the data determine, and which only in combination, from the Jacobian of the whitened residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.models import RotorModel
from rotorfit.models.array_types import RANK_TOLERANCE, Bool, Float
from rotorfit.models.digits import significant

UNRESOLVED_ERROR = 1.0
"""A direction is unresolved when its standard error exceeds this multiple of the parameters' own size."""
_UNSEEN_SHARE = 1e-6  # share in an unseen direction that is more than round-off
UNSEEN_CHANGE = 1e-4
"""Relative change of a result, by parameters' own sizes that no datum notices, from which it is left open."""
_NAMED_SHARE = 0.02  # entries of an unresolved direction below this fraction of the largest are not named


@dataclass(frozen=True, kw_only=True)
class Combination:
    """One direction in parameter space that the data leave open."""

    names: tuple[str, ...]  # the parameters that move together
    direction: tuple[float, ...]  # change of each, as a fraction of its size
    stderr: float  # standard error along the direction in the same measure, infinite if the data say nothing
    message: str  # what that means and what to do
    kind: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Identifiability:
    """Verdict on a fit.

    Attributes:
        rank: number of parameter combinations that the data determine.
        size: number of fitted parameters.
        condition: condition number of the scaled Jacobian.
        combinations: the unresolved ones.
        unresolved: names of the parameters that have no value of their own.
        null_space: directions that the data do not see at all, in physical units, shape ``(p, n_null)``.
    """

    rank: int
    size: int
    condition: float
    combinations: tuple[Combination, ...]
    unresolved: tuple[str, ...]
    null_space: Float

    def leaves_open(self, sizes: Float, slopes: Float) -> Bool:
        """True for results, of slopes ``(N, ..., n)``, that a change which no datum notices moves, ``(N,)``."""
        if not self.null_space.size:
            return np.zeros(len(slopes), dtype=bool)
        leak = np.abs(slopes[..., : self.null_space.shape[0]] @ self.null_space)
        return np.asarray(leak.reshape(len(slopes), -1).max(axis=1) > UNSEEN_CHANGE * sizes)

    def __str__(self) -> str:
        head = (
            f"{self.rank} of {self.size} parameter combinations determined, condition number "
            f"{significant(self.condition, 2)}"
        )
        return "\n".join([head, *("  " + c.message for c in self.combinations)])


def natural_scales(model: RotorModel, base: Sequence[str], values: Float, stiffness: float, frequency: float) -> Float:
    """Size of each parameter against which an error is judged. The parameter's own value, but not less than a tenth of
    what would matter in the test: dynamic stiffness level for N/m, over the highest frequency for damping, over its
    square for masses, over higher powers for structural blocks."""
    by_unit = {
        "N/m": stiffness,
        "N s/m": stiffness / frequency,
        "kg": stiffness / frequency**2,
        "kg s": stiffness / frequency**3,
        "kg s^2": stiffness / frequency**4,
        "kg s^4": stiffness / frequency**6,
        "1": 1.0,
    }
    natural = np.array([by_unit.get(model.parameter(name).unit, 0.0) for name in base])
    scales = np.maximum(np.abs(values), 0.1 * natural)
    typical = np.array([model.parameter(name).scale for name in base])
    return np.where(scales > 0, scales, typical)


def covariance(root: Float, scales: Float) -> tuple[Float, Float, Float, Bool]:
    """Covariance of the determined combinations; errors, directions and unresolved mask of scaled ones."""
    kept, unseen, lost, silent = _scaled_directions(root, scales)
    seen = not (lost.any() or silent.any())
    null = np.zeros((scales.size, 0)) if seen else _null_basis(unseen[:, lost], silent)
    covar = kept @ kept.T
    if null.size:  # covariance seen across the null space: leave that space out
        across = np.eye(scales.size) - null @ null.T
        covar = across @ covar @ across
    variance, directions = np.linalg.eigh(covar)
    stderr = np.sqrt(np.maximum(variance[::-1], 0.0))
    directions = directions[:, ::-1]
    count = null.shape[1]
    if count:
        keep = stderr.size - count
        directions = np.concatenate([null, directions[:, :keep]], axis=1)
        stderr = np.concatenate([np.full(count, np.inf), stderr[:keep]])
    return covar * (scales[:, None] * scales), stderr, directions, stderr > UNRESOLVED_ERROR


def _scaled_directions(root: Float, scales: Float) -> tuple[Float, Float, Bool, Bool]:
    """Directions of scaled parameters as columns, ascending information. Each is over what the data tell of it, zero
    where that is nothing; then as they are; which of them the data do not tell; and which of the parameters have no
    influence at all."""
    scaled = root * scales[..., None, :]
    norm = np.linalg.norm(scaled, axis=-2)
    silent = norm == 0
    safe = np.where(silent, 1.0, norm)
    # Columns of equal length: a singular value then tells dependence, not the units.
    fewer = root.shape[-2] < scales.shape[-1]  # data than parameters
    _, singular, rows = np.linalg.svd(scaled / safe[..., None, :], full_matrices=fewer)
    power = np.zeros(scales.shape)
    power[..., scales.shape[-1] - singular.shape[-1] :] = singular[..., ::-1]
    lost = power <= RANK_TOLERANCE * power.max(axis=-1, initial=0.0, keepdims=True)
    basis = np.swapaxes(rows[..., ::-1, :], -1, -2) / safe[..., :, None]
    kept = basis / np.where(lost, np.inf, power)[..., None, :]
    kept[silent] = 0.0
    return kept, basis, lost, silent


def _null_basis(directions: Float, silent: Bool) -> Float:
    """Orthonormal basis of null directions, parameters without any influence each on an axis of its own."""
    axes = np.eye(silent.size)[:, silent]
    others = directions.copy()
    others[silent] = 0.0
    rest = np.linalg.norm(others, axis=0) > 1e-8 * np.linalg.norm(directions, axis=0)
    others = others[:, rest]
    if others.shape[1]:
        u, s, _ = np.linalg.svd(others / np.linalg.norm(others, axis=0), full_matrices=False)
        others = u[:, s > 1e-8]
    return np.concatenate([axes, others], axis=1)


def diagnose(
    model: RotorModel,
    names: Sequence[str],
    base: Sequence[str],
    values: Float,
    root: Float,
    scales: Float,
) -> tuple[Float, Identifiability]:
    """Covariance and identifiability verdict of a fit."""
    covar, stderr, directions, open_ = covariance(root, scales)
    determined = bool(np.isfinite(stderr).all()) and stderr.min() > 0
    condition = float(stderr.max() / stderr.min()) if determined else float("inf")
    size = len(names)
    if not open_.any():
        nothing = directions[:, :0]
        return covar, Identifiability(
            rank=size, size=size, condition=condition, combinations=(), unresolved=(), null_space=nothing
        )
    errors, basis = stderr[open_], directions[:, open_]
    combinations = []
    for vector in _sparse_basis(basis).T:
        chosen = np.flatnonzero(np.abs(vector) > _NAMED_SHARE * np.abs(vector).max()).tolist()
        error = _error_along(vector, basis, errors)
        pair = _pair(model, base, values, vector * scales, chosen) if len(chosen) == 2 else None
        combinations.append(
            Combination(
                names=tuple(names[i] for i in chosen),
                direction=tuple(float(vector[i]) for i in chosen),
                stderr=error,
                message=_message(model, names, base, chosen, error, pair),
                kind="" if pair is None else pair[1],
            )
        )
    return covar, Identifiability(
        rank=int(np.sum(~open_)),
        size=size,
        condition=condition,
        combinations=tuple(combinations),
        unresolved=_unresolved(names, directions, stderr, open_),
        null_space=directions[:, np.isinf(stderr)] * scales[:, None],
    )


def _unresolved(names: Sequence[str], directions: Float, stderr: Float, open_: Bool) -> tuple[str, ...]:
    """Entries that a direction without any information moves, or that the weak ones leave too wide an error."""
    weak = open_ & np.isfinite(stderr)
    return tuple(
        name
        for i, name in enumerate(names)
        if np.abs(directions[i, np.isinf(stderr)]).max(initial=0.0) > _UNSEEN_SHARE
        or np.linalg.norm(directions[i, weak] * stderr[weak]) > 0.5 * UNRESOLVED_ERROR
    )


def _error_along(vector: Float, basis: Float, stderr: Float) -> float:
    """Standard error along a vector in the span of directions with errors of their own; infinite if one it has is."""
    along = basis.T @ vector
    if (np.isinf(stderr) & (np.abs(along) > 1e-9)).any():
        return float("inf")
    return float(np.linalg.norm(along * np.minimum(stderr, 1e100)))


def _sparse_basis(vectors: Float) -> Float:
    """Basis of the same space with as few parameters in each vector as pivoting gives, columns of unit length."""
    basis = vectors.T.copy()
    used: list[int] = []
    for row in range(basis.shape[0]):
        remaining = np.abs(basis[row:]).copy()
        remaining[:, used] = 0.0
        pivot_row, pivot = divmod(int(np.argmax(remaining)), remaining.shape[1])
        basis[[row, row + pivot_row]] = basis[[row + pivot_row, row]]
        basis[row] /= basis[row, pivot]
        used.append(pivot)
        for other in range(basis.shape[0]):
            if other != row:
                basis[other] -= basis[other, pivot] * basis[row]
    norms = np.linalg.norm(basis, axis=1, keepdims=True)
    return np.asarray((basis / np.where(norms > 0, norms, 1.0)).T)


def _message(
    model: RotorModel,
    names: Sequence[str],
    base: Sequence[str],
    chosen: Sequence[int],
    error: float,
    pair: tuple[str, str] | None,
) -> str:
    """Say in words what an unresolved direction means and how to get out of it."""
    if len(chosen) == 1:
        name = names[chosen[0]]
        if error > 1e6:
            return f"{name} is not observable: it has no influence on these data. Fix it or give a prior."
        percent = f"{100 * error:.0f} %"
        return f"{name} is not determined by these data (error of {percent} of its size). Fix it or give a prior."
    if pair is not None:
        sign, kind = pair
        return f"{names[chosen[0]]} {sign} {names[chosen[1]]} only as a {kind}: fix one or give a prior."
    own = [i for i in chosen if base[i] in model.parameter_names]  # the others are angles and gains of the data
    conventional = [(names[i], model.parameter(base[i]).nominal) for i in own]
    offered = [f"fix {name} (for instance at {value:g}) or another of them" for name, value in conventional if value]
    way_out = f"{offered[0]}, or give a prior" if offered else "fix one of them or give a prior"
    if len(own) < len(chosen) and own and not offered:
        way_out = f"fix {' or '.join(names[i] for i in own[:3])}, or give a prior"
    return f"{', '.join(names[i] for i in chosen)} only in combination, along one direction: {way_out}."


def _pair(
    model: RotorModel, base: Sequence[str], values: Float, moves: Float, chosen: Sequence[int]
) -> tuple[str, str] | None:
    """True if two parameters are open only as their sum, difference, product or ratio."""
    a, b = chosen
    tolerance = 1e-3
    units = [model.parameter(base[i]).unit if base[i] in model.parameter_names else None for i in chosen]
    if units[0] is not None and units[0] == units[1]:
        if abs(moves[a] + moves[b]) < tolerance * abs(moves[a]):
            return "+", "sum"
        if abs(moves[a] - moves[b]) < tolerance * abs(moves[a]):
            return "-", "difference"
    if values[a] and values[b]:
        first, second = moves[a] / values[a], moves[b] / values[b]
        if abs(first + second) < tolerance * abs(first):
            return "*", "product"
        if abs(first - second) < tolerance * abs(first):
            return "/", "ratio"
    return None
