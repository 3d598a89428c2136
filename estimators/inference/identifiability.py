"""Which parameters the data determine, and which only in combination, from the Jacobian of the whitened residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, Bool, Float
from rotorfit.base.digits import significant
from rotorfit.base.significance import OPEN_ERRORS
from rotorfit.estimators.inference.constrained_minima import EntryConstraint
from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models import RotorModel

UNRESOLVED_ERROR = 1.0
"""A direction is unresolved when its standard error exceeds this multiple of the parameters' own size."""
_SILENT = 1e-100
"""Change of whitened readings by a parameter's own size, up to which it has no influence: the square of its error
overflows."""
UNSEEN_CHANGE = 1e-4
"""Relative change of a result, by parameters' own sizes that no datum notices, from which it is left open."""


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
        silent = [c.names[0] for c in self.combinations if len(c.names) == 1 and np.isinf(c.stderr)]
        if len(silent) < 2:
            return "\n".join([head, *("  " + c.message for c in self.combinations)])
        others = [c.message for c in self.combinations if len(c.names) > 1 or not np.isinf(c.stderr)]
        together = (
            f"{', '.join(silent)} are not observable: they have no influence on these data. Fix them or give priors."
        )
        return "\n".join([head, *("  " + message for message in (together, *others))])


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
        "m/N": 1 / stiffness,
        "1/kg": frequency**2 / stiffness,
    }
    natural = np.array([by_unit.get(model.parameter(name).unit, 0.0) for name in base])
    scales = np.maximum(np.abs(values), 0.1 * natural)
    typical = np.array([model.parameter(name).scale for name in base])
    return np.where(scales > 0, scales, typical)


def covariance(root: Float, scales: Float) -> tuple[Float, Float, Float, Bool]:
    """Covariance of the determined combinations; errors, directions and unresolved mask of scaled ones."""
    scaled = root * scales
    norm = np.linalg.norm(scaled, axis=0)
    silent = norm < _SILENT
    safe = np.where(silent, 1.0, norm)
    # Columns of equal length: a singular value then tells dependence, not the units.
    fewer = len(root) < scales.size  # data than parameters
    _, singular, rows = np.linalg.svd(scaled / safe, full_matrices=fewer)
    power = np.pad(singular[::-1], (scales.size - singular.size, 0))
    lost = power <= RANK_TOLERANCE * power.max(initial=0.0)
    unseen = rows[::-1].T / safe[:, None]  # directions by ascending information, as they are
    kept = unseen / np.where(lost, np.inf, power)  # over what the data tell of each
    kept[silent] = 0.0
    covar = kept @ kept.T
    null = np.zeros((scales.size, 0))
    if lost.any() or silent.any():  # covariance seen across the null space: leave that space out
        # Orthonormal basis of null directions, parameters without any influence each on an axis of its own.
        others = unseen[:, lost].copy()
        length = np.linalg.norm(others, axis=0)
        others[silent] = 0.0
        others = others[:, np.linalg.norm(others, axis=0) > 1e-8 * length]
        if others.shape[1]:
            u, s, _ = np.linalg.svd(others / np.linalg.norm(others, axis=0), full_matrices=False)
            others = u[:, s > 1e-8]
        null = np.concatenate([np.eye(scales.size)[:, silent], others], axis=1)
        across = np.eye(scales.size) - null @ null.T
        covar = across @ covar @ across
    variance, directions = np.linalg.eigh(covar)
    rest = scales.size - null.shape[1]
    stderr = np.concatenate([np.full(null.shape[1], np.inf), np.sqrt(np.maximum(variance[::-1], 0.0))[:rest]])
    directions = np.concatenate([null, directions[:, ::-1][:, :rest]], axis=1)
    return covar * (scales[:, None] * scales), stderr, directions, stderr > UNRESOLVED_ERROR


def diagnose(
    model: RotorModel, names: Sequence[str], base: Sequence[str], values: Float, root: Float, scales: Float
) -> tuple[Float, Identifiability]:
    """Covariance and identifiability verdict of a fit."""
    covar, stderr, directions, open_ = covariance(root, scales)
    determined = bool(np.isfinite(stderr).all()) and stderr.min() > 0
    errors, basis = stderr[open_], directions[:, open_]
    combinations = []
    named_share = 0.02  # entries of an unresolved direction below this fraction of the largest are not named
    for vector in _sparse_basis(basis).T:
        chosen = np.flatnonzero(np.abs(vector) > named_share * np.abs(vector).max()).tolist()
        along = basis.T @ vector
        blind = (np.isinf(errors) & (np.abs(along) > 1e-9)).any()
        error = np.inf if blind else float(np.linalg.norm(along * np.minimum(errors, 1e100)))
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
    # Entries that a direction without any information moves, or that the weak ones leave too wide an error.
    none, weak = np.isinf(stderr), open_ & np.isfinite(stderr)
    unseen_share = 1e-6  # share in an unseen direction that is more than round-off
    moved = np.abs(directions[:, none]).max(axis=1, initial=0.0) > unseen_share
    wide = np.linalg.norm(directions[:, weak] * stderr[weak], axis=1) > 0.5 * UNRESOLVED_ERROR
    return covar, Identifiability(
        rank=int(np.sum(~open_)),
        size=len(names),
        condition=float(stderr.max() / stderr.min()) if determined else np.inf,
        combinations=tuple(combinations),
        unresolved=tuple(names[i] for i in np.flatnonzero(moved | wide).tolist()),
        null_space=directions[:, none] * scales[:, None],
    )


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
    ways = []
    if units[0] is not None and units[0] == units[1]:
        ways.append((moves[a], moves[b], ("+", "sum"), ("-", "difference")))
    if values[a] and values[b]:
        ways.append((moves[a] / values[a], moves[b] / values[b], ("*", "product"), ("/", "ratio")))
    for first, second, opposite, alike in ways:
        if abs(first + second) < tolerance * abs(first):
            return opposite
        if abs(first - second) < tolerance * abs(first):
            return alike
    return None


def along_valley(problem: Problem, x: Float, covar: Float, scales: Float, verdict: Identifiability) -> Identifiability:
    """The verdict, with parameters not determined that go together farther than their standard errors tell. A parameter
    that others are estimated as ratios to is held at six standard errors from its estimate, all else being fitted
    again: chi-squared is to rise by nine there at least, a quarter of what the curvature promises.

    Residuals of lines of the twist hold terms in proportion to the inertia J and others in proportion to 1/J. Where J
    is too large for the second and too small for the first to be seen the misfit is flat, over decades. Noise makes a
    dent as often where the second begin to be seen, at a J far below the true one, as where the first do, and from the
    curvature there J would be known to be next to nothing."""
    space = problem.space
    for denominator, over in space.model.ratios.items():
        numerators = [i for i, base in enumerate(space.base) if base in over]
        for entry, base in enumerate(space.base):
            if base == denominator and space.names[entry] not in verdict.unresolved and x[entry] > 0:
                found = _open_along(problem, x, covar[entry, entry], scales, [entry, *numerators])
                if found is None:
                    continue
                others = [other for other in verdict.combinations if not set(other.names) <= set(found.names)]
                verdict = replace(
                    verdict,
                    rank=verdict.rank + len(verdict.combinations) - len(others) - 1,
                    combinations=(*others, found),
                    unresolved=tuple(n for n in space.names if n in {*verdict.unresolved, *found.names}),
                )
    return verdict


def _open_along(
    problem: Problem, x: Float, variance: float, scales: Float, valley: Sequence[int]
) -> Combination | None:
    """The combination that is open along a valley, its first entry in front, None where that is no longer than said."""
    entry, names = valley[0], problem.space.names
    lower, upper = box(problem)
    tolerated_error_ratio = 2.0  # factor by which the error bar along a valley may be too short
    reach = tolerated_error_ratio * OPEN_ERRORS * float(np.sqrt(max(variance, 0.0)))
    cost, held = problem.cost(x), EntryConstraint(problem, np.where(x == 0, 1.0, np.abs(x)))
    largest_change = 0.5  # change along a valley, over its value, from which a parameter has none of its own
    for end in (float(x[entry]) + reach, float(x[entry]) - reach):
        if not max(0.0, lower[entry]) < end < upper[entry]:
            continue
        start = x.copy()
        start[valley] *= end / x[entry]
        there, found, _ = held.alone(entry, end, np.clip(start, lower, upper))
        rise = 2 * (there - cost)
        if rise >= OPEN_ERRORS**2:
            continue
        chosen = [i for i in valley if abs(found[i] - x[i]) > largest_change * abs(x[i])]
        moved, own = ((found - x) / scales)[chosen], [names[i] for i in chosen]
        length, unit = float(np.linalg.norm(moved)), problem.space.model.parameter(problem.space.base[entry]).unit
        together = f"{', '.join(own)} only as ratios" if len(own) > 1 else f"{names[entry]} is open"
        return Combination(
            names=tuple(own),
            direction=tuple((moved / length).tolist()),
            stderr=length / OPEN_ERRORS,
            message=f"{together}: at {names[entry]} = {significant(end, 2)} {unit} chi-squared is "
            f"{significant(abs(rise), 2)} {'higher' if rise > 0 else 'lower'} than at {significant(x[entry], 2)}. "
            "Fix one or give a prior.",
        )
    return None
