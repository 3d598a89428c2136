"""Closed-form identification: matrix inversion (eqs 5 to 9) and straight lines, no iteration and no starting values.

The dynamic stiffness is linear in its lumped coefficients (sums and products of parameters, such as K1 + K2 or D lam).
One linear least-squares problem gives those, and the parameters follow from them one after the other, each from an
equation in which it is the only unknown. Both steps are read off the model's own graph, so they exist for every model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.observations import Block, Responses
from rotorfit.estimators.problem import ParameterSpace
from rotorfit.estimators.response import dynamic_stiffness, inverse

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Index = NDArray[np.intp]

_DEPENDENT = 1e-9  # relative size below which one coefficient adds nothing to the others
_SETTLED = 1e-6  # relative change of the lumped coefficients after which further passes bring nothing
_SPEED_TERMS = 5  # powers of the speed looked for in a coefficient


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """A closed-form estimate.

    Attributes:
        x: estimate, shape ``(p,)``.
        covar: covariance from the propagated noise, shape ``(p, p)``, NaN where unweighted.
        notes: what had to be assumed, in words.
    """

    x: Float
    covar: Float
    notes: tuple[str, ...] = ()


class ClosedFormError(ValueError):
    """The data do not allow a closed form; the message says what is missing."""


@dataclass(frozen=True, eq=False)
class _Terms:
    """Lumped coefficients as expressions of the fitted vector, and where each one enters kappa."""

    x: ca.SX
    expressions: ca.SX
    block: Index
    group: Index
    row: Index
    column: Index
    power: Index
    unit: ComplexArray
    speed_power: Index
    speed: Float  # speed to which a term is restricted, NaN for all


def closed_form(space: ParameterSpace, blocks: tuple[Block, ...], *, weighted: bool = True, passes: int = 2) -> ClosedForm:
    """Identify without iteration.

    Weighted, three linear solves: the bare force balance; the same weighed with the noise that its result propagates;
    once more with the responses of that result as instruments, because the noise of the measured responses, which stand
    among the regressors, would otherwise pull the stiffness towards zero.

    Args:
        space: what is free and what is known.
        blocks: observations; those that are not responses or forces of circular tests are passed over.
        weighted: weigh each reading with its propagated noise; otherwise, as the paper did, fit the inverted dynamic
            stiffness (or the force balance where planes are missing) with equal weights.

        passes: weighted solves; more than the two of the closed form proper only improve starts from hard data.

    Raises:
        ClosedFormError: no line has readings at all coordinates.
    """
    chosen = [complete_lines(block) for block in blocks if isinstance(block, Responses)]
    chosen = [block for block in chosen if block.speed.size]
    if not chosen:
        raise ClosedFormError(
            "the closed form needs responses to a circular force with readings at every plane of the model; "
            "give start values instead"
        )
    terms = _lumped_terms(space, chosen)
    basis, spread, offset = _independent(terms, space)
    if not _determined(space, terms, chosen, spread):
        return _with_convention(space, blocks, weighted, passes)
    design, target = _force_balance(terms, chosen, spread, offset, None)
    if not weighted:
        design, target = _stiffness_balance(terms, chosen, spread, offset)
        lumped, information = _solve(design, target)
        x, notes = _parameters(space, terms, offset + spread @ lumped, spread, None)
        return ClosedForm(x, np.full((x.size, x.size), np.nan), notes)
    lumped, _ = _solve(design, target)
    for number in range(passes):
        values = offset + spread @ lumped
        design, target = _force_balance(terms, chosen, spread, offset, values)
        if number == 0:
            lumped, information = _solve(design, target)
            continue
        instruments, _ = _force_balance(terms, chosen, spread, offset, values, predicted=True)
        before = lumped
        lumped, information = _solve(design, target, instruments)
        if np.all(np.abs(lumped - before) <= _SETTLED * np.abs(lumped)):
            break
    x, notes = _parameters(space, terms, offset + spread @ lumped, spread, information)
    jacobian = np.asarray(ca.Function("g", [terms.x], [ca.jacobian(terms.expressions[basis.tolist()], terms.x)])(x))
    covar = np.linalg.pinv(jacobian.T @ information @ jacobian, rcond=1e-15, hermitian=True)
    return ClosedForm(x, np.asarray(covar), notes)


def _determined(space: ParameterSpace, terms: _Terms, blocks: list[Responses], spread: Float) -> bool:
    """Whether such a test can give all independent lumped coefficients, judged on exact responses of a typical rotor.

    Noise hides the defect: the force balance of a plane that is never forced is homogeneous, and noisy data "solve" it
    with zeros.
    """
    rng = np.random.default_rng(1)
    x = np.array([_typical(space, i) for i in range(len(space.names))]) * rng.uniform(0.8, 1.25, len(space.names))
    theta = space.theta(np.concatenate([x, np.zeros(len(space.nuisance))]))
    designs = []
    for number, block in enumerate(blocks):
        H = inverse(dynamic_stiffness(block, theta))
        amplitude = block.force if block.imposed else np.einsum("lij,lj->li", H, block.force)
        weight = H / np.abs(amplitude).max(axis=1)[:, None, None]
        phi = _regressors(terms, number, block, amplitude)
        designs.append(_flat(weight @ phi @ spread[terms.block == number]))
    design = np.concatenate(designs)
    norm = np.linalg.norm(design, axis=0)
    if not norm.all():
        return False
    power = np.linalg.svd(design / norm, compute_uv=False)
    return bool(power[-1] > 1e-9 * power[0])


def _with_convention(space: ParameterSpace, blocks: tuple[Block, ...], weighted: bool, passes: int) -> ClosedForm:
    """Closed form with one more parameter at its conventional value, where the data leave a combination open."""
    for entry, base in enumerate(space.base):
        nominal = space.model.parameter(base).nominal
        if nominal is None:
            continue
        index = np.where(space.index == entry, -1, space.index - (space.index > entry))
        keep = np.arange(space.size) != entry
        reduced = replace(
            space,
            names=space.names[:entry] + space.names[entry + 1 :],
            base=space.base[:entry] + space.base[entry + 1 :],
            template=np.where(space.index == entry, nominal, space.template),
            index=index,
            lower=space.lower[keep],
            upper=space.upper[keep],
        )
        found = closed_form(reduced, blocks, weighted=weighted, passes=passes)
        covar = np.insert(np.insert(found.covar, entry, 0.0, axis=0), entry, 0.0, axis=1)
        note = f"{space.names[entry]} taken as {nominal:g}: these data leave it open"
        return ClosedForm(np.insert(found.x, entry, nominal), covar, (note, *found.notes))
    raise ClosedFormError(
        "these data do not determine the lumped coefficients of the model: fix parameters or give start values"
    )


def complete_lines(block: Responses) -> Responses:
    """The lines of a block that have a reading at every coordinate."""
    if block.imposed and len(block.model.coordinates) > 1:
        return replace(block, **_line_subset(block, np.zeros(block.speed.size, dtype=bool)))
    needed = 1 if block.imposed else len(block.model.coordinates)
    count = np.bincount(block.line, minlength=block.speed.size)
    return replace(block, **_line_subset(block, count == needed))


def _line_subset(block: Responses, keep: NDArray[np.bool_]) -> dict[str, Any]:
    readings = keep[block.line]
    number = np.cumsum(keep) - 1
    parts: dict[str, Any] = {name: getattr(block, name)[keep] for name in ("speed", "frequency", "force", "group")}
    parts |= {n: getattr(block, n)[readings] for n in ("coordinate", "measured", "sigma", "label", "run")}
    return parts | {"line": number[block.line[readings]]}


# ---- the model's lumped coefficients ----------------------------------------------------------------------------


def _lumped_terms(space: ParameterSpace, blocks: list[Responses]) -> _Terms:
    model = space.model
    n = len(model.coordinates)
    x = ca.SX.sym("x", len(space.names))
    speed = ca.SX.sym("speed")
    rows: list[tuple[int, int, int, int, int, complex, int, float]] = []
    expressions: list[ca.SX] = []
    for number, block in enumerate(blocks):
        for group in np.unique(block.group):
            theta = [
                x[int(k)] if k >= 0 else space.template[group, i] for i, k in enumerate(space.index[group].tolist())
            ]
            inputs = ca.vertcat(*theta, speed, 0.0)
            flat = model.functions.graph(inputs)
            factors = model.functions.factor_graph(inputs)
            speeds = np.unique(block.speed[block.group == group])
            for entry in range(flat.numel()):
                power, rest = divmod(entry, 2 * n * n)
                imaginary, place = divmod(rest, n * n)
                row, column = divmod(place, n)
                unit = 1j if imaginary else 1.0
                expression = ca.simplify(flat[entry] / factors[2 * column])
                for degree, at, part in _speed_parts(expression, speed, speeds):
                    expressions.append(part)
                    rows.append((number, int(group), row, column, power, unit, degree, at))
    columns = list(zip(*rows, strict=True))
    block_, group_, row_, column_, power_, _, degree_, _ = (np.array(c) for c in columns)
    return _Terms(
        x, ca.vertcat(*expressions), block_, group_, row_, column_, power_,
        np.array(columns[5], dtype=complex), degree_, np.array(columns[7], dtype=float),
    )


def _speed_parts(expression: ca.SX, speed: ca.SX, speeds: Float) -> list[tuple[int, float, ca.SX]]:
    """Split a coefficient by powers of the speed, or by speed where too few speeds were tested for that."""
    if not ca.depends_on(expression, speed):
        return [] if expression.is_zero() else [(0, np.nan, expression)]
    parts, derivative, factorial = [], expression, 1.0
    for degree in range(_SPEED_TERMS):
        part = ca.simplify(ca.substitute(derivative, speed, ca.SX(0.0)) / factorial)
        if not part.is_zero():
            parts.append((degree, np.nan, part))
        derivative = ca.simplify(ca.jacobian(derivative, speed))
        factorial *= degree + 1
        if derivative.is_zero() or not derivative.nnz():
            if len(parts) <= speeds.size:
                return parts
            break
    return [(0, float(v), ca.substitute(expression, speed, ca.SX(float(v)))) for v in speeds]


def _independent(terms: _Terms, space: ParameterSpace) -> tuple[Index, Float, Float]:
    """Write every lumped coefficient as an affine function of independent ones.

    Relations such as kappa_12 = -K2 = kappa_21 are found by evaluating the expressions at random parameters.

    Returns:
        rows of independent expressions ``b``; matrix ``S`` and offset ``o`` with ``all = S b + o``.
    """
    from scipy.linalg import qr

    count, size = terms.expressions.numel(), len(space.names)
    evaluate = ca.Function("lumped", [terms.x], [terms.expressions])
    scale = np.array([space.model.parameter(name).scale for name in space.base])
    samples = scale * np.exp(np.random.default_rng(0).uniform(-1, 1, (2 * min(count, 4 * size) + 4 * size + 8, size)))
    values = np.array([np.asarray(evaluate(sample)).ravel() for sample in samples])
    centre = values.mean(axis=0)
    spread = values - centre
    norm = np.linalg.norm(spread, axis=0)
    moving = norm > 1e-12 * np.linalg.norm(values, axis=0)
    scaled = np.where(moving, spread / np.where(moving, norm, 1.0), 0.0)
    _, r, pivots = qr(scaled, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(r))
    rank = int(np.sum(diagonal > _DEPENDENT * diagonal[0])) if diagonal.size else 0
    basis = np.sort(pivots[:rank])
    S = np.linalg.lstsq(spread[:, basis], spread, rcond=None)[0].T
    S[np.abs(S) < 1e-11 * np.abs(S).max(axis=1, keepdims=True, initial=1e-300)] = 0.0
    return basis, S, centre - S @ centre[basis]


# ---- linear least squares ------------------------------------------------------------------------------------------


def _amplitudes(block: Responses) -> tuple[ComplexArray, ComplexArray, Float]:
    """Amplitude, force and noise at every coordinate of every line, each of shape ``(L, n)``."""
    if not block.imposed:
        amplitude, sigma = block.amplitudes()
        return amplitude, block.force, sigma
    return block.force, block.measured[:, None], block.sigma[:, None]


def _regressors(terms: _Terms, number: int, block: Responses, amplitude: ComplexArray) -> ComplexArray:
    """Contribution of each lumped coefficient to ``kappa A``, shape ``(L, n, E)``, E the terms of this block."""
    mine = np.flatnonzero(terms.block == number)
    result = np.zeros((*amplitude.shape, mine.size), dtype=complex)
    for place, e in enumerate(mine):
        lines = block.group == terms.group[e]
        if not np.isnan(terms.speed[e]):
            lines &= block.speed == terms.speed[e]
        s, Om = block.s[lines], block.speed[lines]
        product = terms.unit[e] * s ** terms.power[e] * Om ** terms.speed_power[e]
        result[lines, terms.row[e], place] = product * amplitude[lines, terms.column[e]]
    return result


def _kappa(terms: _Terms, number: int, block: Responses, values: Float) -> ComplexArray:
    """Dynamic stiffness of each line from lumped coefficients, shape ``(L, n, n)``."""
    n = len(block.model.coordinates)
    mine = terms.block == number
    columns = []
    for column in range(n):
        unit = np.zeros((block.speed.size, n), dtype=complex)
        unit[:, column] = 1.0
        columns.append(_regressors(terms, number, block, unit) @ values[mine])
    return np.stack(columns, axis=-1)


def _force_balance(
    terms: _Terms,
    blocks: list[Responses],
    spread: Float,
    offset: Float,
    values: Float | None,
    *,
    predicted: bool = False,
) -> tuple[Float, Float]:
    """Rows of ``kappa A = F``, linear in the independent lumped coefficients.

    With a first estimate ``values`` of the coefficients each row is multiplied by ``inv(kappa)`` over sigma, which turns the
    force error into the response error, whose noise is known and independent from reading to reading. ``predicted`` puts
    the responses of that estimate in the place of the measured ones.
    """
    designs, targets = [], []
    for number, block in enumerate(blocks):
        amplitude, force, sigma = _amplitudes(block)
        if predicted and values is not None and not block.imposed:
            amplitude = np.einsum("lij,lj->li", inverse(_kappa(terms, number, block, values)), block.force)
        phi = _regressors(terms, number, block, amplitude)
        if values is None:
            weight = np.eye(force.shape[1]) / np.abs(force).max(axis=1)[:, None, None]
        elif block.imposed:
            weight = np.eye(1) / sigma[:, :, None]
        else:
            weight = inverse(_kappa(terms, number, block, values)) / sigma[:, :, None]
        mine = terms.block == number
        designs.append(_flat(weight @ phi @ spread[mine]))
        targets.append(_flat((weight @ (force - phi @ offset[mine])[:, :, None])))
    return np.concatenate(designs), np.concatenate(targets)[:, 0]


def _flat(values: ComplexArray) -> Float:
    rows = values.reshape(-1, values.shape[-1])
    return np.concatenate([rows.real, rows.imag])


def _stiffness_balance(
    terms: _Terms, blocks: list[Responses], spread: Float, offset: Float
) -> tuple[Float, Float]:
    """Entries of the inverted dynamic stiffness (eq. 7), all of equal weight; force balance where it has no inverse."""
    designs, targets = [], []
    for number, block in enumerate(blocks):
        mine = terms.block == number
        if block.imposed:
            design, target = _force_balance(terms, [block], spread, offset, None)
            designs.append(design)
            targets.append(target)
            continue
        stiffness = stiffness_matrices(block)
        if stiffness.kappa.size == 0:
            amplitude, force, _ = _amplitudes(block)
            phi = _regressors(terms, number, block, amplitude)
            designs.append(_flat(phi @ spread[mine]))
            targets.append(_flat((force - phi @ offset[mine])[:, :, None])[:, 0])
            continue
        lines = replace(block, **_line_subset(block, np.isin(np.arange(block.speed.size), stiffness.first_line)))
        for column in range(stiffness.kappa.shape[-1]):
            unit = np.zeros(stiffness.kappa.shape[:2], dtype=complex)
            unit[:, column] = 1.0
            phi = _regressors(terms, number, lines, unit)
            designs.append(_flat(phi @ spread[mine]))
            targets.append(_flat((stiffness.kappa[:, :, column] - phi @ offset[mine])[:, :, None])[:, 0])
    return np.concatenate(designs), np.concatenate(targets)


def _solve(design: Float, target: Float, instruments: Float | None = None) -> tuple[Float, Float]:
    """Least squares with equilibrated columns, or with instruments; returns the solution and the information matrix."""
    if instruments is not None:
        norm = np.linalg.norm(instruments, axis=0)
        norm = np.where(norm > 0, norm, 1.0)
        cross = (instruments / norm).T @ (design / norm)
        return np.linalg.solve(cross, (instruments / norm).T @ target) / norm, instruments.T @ instruments
    norm = np.linalg.norm(design, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    scaled = design / norm
    solution = np.linalg.lstsq(scaled, target, rcond=1e-13)[0]
    return solution / norm, design.T @ design


# ---- from lumped coefficients to parameters --------------------------------------------------------------------------


def _parameters(
    space: ParameterSpace, terms: _Terms, values: Float, spread: Float, information: Float | None
) -> tuple[Float, tuple[str, ...]]:
    """Solve the lumped expressions for the parameters, one unknown at a time, then take one weighted step on all."""
    size = len(space.names)
    x = np.full(size, np.nan)
    waiting = [(k, terms.expressions[k], float(values[k])) for k in range(values.size)]
    while np.isnan(x).any():
        found = _next_parameter(terms.x, x, waiting)
        if found is None:
            break
        x[found[0]] = found[1]
    notes: tuple[str, ...] = ()
    missing = np.isnan(x)
    if missing.any():
        x, notes = _remaining(space, terms, values, x)
    if information is not None:
        x = _one_step(terms, values, spread, information, x)
    inside = np.clip(x, space.lower[:size], space.upper[:size])
    return np.where(np.isfinite(inside), inside, np.nan), notes


def _next_parameter(
    symbols: ca.SX, x: Float, waiting: list[tuple[int, ca.SX, float]]
) -> tuple[int, float] | None:
    """The next parameter that some expression gives directly: alone in it, and linear or as a reciprocal."""
    known = np.flatnonzero(~np.isnan(x))
    best: tuple[float, int, float] | None = None
    for _, expression, value in waiting:
        unknown = [i for i in range(x.size) if np.isnan(x[i]) and ca.depends_on(expression, symbols[i])]
        if len(unknown) != 1:
            continue
        symbol = symbols[unknown[0]]
        here = expression
        if known.size:
            here = ca.substitute(expression, symbols[known.tolist()], ca.DM(x[known]))
        solved = _solve_for(ca.simplify(here), symbol, value)
        if solved is not None and (best is None or solved[1] > best[0]):
            best = (solved[1], unknown[0], solved[0])
    return None if best is None else (best[1], best[2])


def _solve_for(expression: ca.SX, symbol: ca.SX, value: float) -> tuple[float, float] | None:
    """Solve ``expression = value`` for its only symbol; also the share of the value that depends on the symbol."""
    for reciprocal in (False, True):
        t = ca.SX.sym("t")
        e = ca.simplify(ca.substitute(expression, symbol, 1 / t if reciprocal else t))
        slope = ca.simplify(ca.jacobian(e, t))
        samples = np.array([float(ca.Function("s", [t], [slope])(v)) for v in (0.7, 1.9, 31.0)])
        if not np.allclose(samples, samples[0], rtol=1e-9, atol=0) or samples[0] == 0:
            continue
        constant = float(ca.Function("c", [t], [e])(1.0)) - samples[0]
        root = (value - constant) / samples[0]
        share = abs(samples[0] * root) / (abs(constant) + abs(samples[0] * root) + 1e-300)
        return (1 / root if reciprocal else root), share
    return None


def _remaining(
    space: ParameterSpace, terms: _Terms, values: Float, x: Float
) -> tuple[Float, tuple[str, ...]]:
    """Parameters that no single expression gives: solve the coupled lumped equations, or take a typical value."""
    from scipy.optimize import least_squares

    missing = np.flatnonzero(np.isnan(x))
    names = [space.names[i] for i in missing]
    typical = np.array([_typical(space, int(i)) for i in missing])
    start = x.copy()
    start[missing] = typical
    f = ca.Function("f", [terms.x], [terms.expressions])
    df = ca.Function("df", [terms.x], [ca.jacobian(terms.expressions, terms.x)])
    level = np.maximum(np.abs(values), np.abs(np.asarray(f(start)).ravel()))
    weight = 1.0 / np.where(level > 0, level, 1.0)
    influence = np.asarray(df(start))[:, missing] * weight[:, None] * typical
    silent = np.linalg.norm(influence, axis=0) == 0

    def residual(u: Float) -> Float:
        y = start.copy()
        y[missing] = u * typical
        return np.asarray((np.asarray(f(y)).ravel() - values) * weight)

    solved = least_squares(residual, np.ones(missing.size), x_scale="jac", max_nfev=50)
    start[missing] = np.where(silent, 1.0, solved.x) * typical
    return start, (f"{', '.join(names)}: no coefficient gives them singly; solved jointly from typical values",)


def _typical(space: ParameterSpace, entry: int) -> float:
    parameter = space.model.parameter(space.base[entry])
    guess = parameter.scale if parameter.nominal is None else parameter.nominal
    return float(np.clip(guess, space.lower[entry], space.upper[entry])) or 1e-3


def _one_step(terms: _Terms, values: Float, spread: Float, information: Float, x: Float) -> Float:
    """One linearised weighted step on all lumped coefficients at once: it uses the redundant ones as well."""
    f = ca.Function("f", [terms.x], [terms.expressions, ca.jacobian(terms.expressions, terms.x)])
    now, jacobian = (np.asarray(part) for part in f(x))
    # information is that of the independent coefficients b, all = S b + o: least squares on S(b_model - b) = 0
    pick = np.linalg.pinv(spread)
    J = pick @ jacobian
    miss = pick @ (values - now.ravel())
    scale = np.maximum(np.abs(x), 1e-12)
    normal = J.T @ information @ J * np.outer(scale, scale)
    root = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    step = np.linalg.lstsq(normal / np.outer(root, root), (J.T @ information @ miss) * scale / root, rcond=1e-10)[0]
    moved = x + step / root * scale
    # The linearisation holds near the solution only; a step that changes a parameter beyond its size is not taken.
    return moved if np.all(np.abs(moved - x) <= 0.5 * np.abs(x) + 1e-300) else x


# ---- eq. 7, frequency by frequency ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StiffnessMatrices:
    """Measured dynamic stiffness (eq. 7).

    Attributes:
        frequency, speed: rad/s, shape ``(N,)``; the frequency is signed where forward and backward are apart.
        kappa: shape ``(N, n, n)``, N/m.
        sigma: standard deviation of real and imaginary part of each entry, from the propagated noise, same shape.
        first_line: line of the block that carries each frequency, shape ``(N,)``.
    """

    frequency: Float
    speed: Float
    kappa: ComplexArray
    sigma: Float
    first_line: Index


def stiffness_matrices(block: Responses) -> StiffnessMatrices:
    """Invert the response matrix at every frequency at which all planes were forced (eqs 5 and 7).

    In models with x and y apart the forward and the backward run at ``|w|`` make the 2n columns of eq. (5).
    Frequencies whose forces or readings are incomplete, and singular response matrices, are left out.
    """
    block = complete_lines(block)
    n = len(block.model.coordinates)
    amplitude, sigma = block.amplitudes()
    w = block.frequency if block.model.frame == "z" else np.abs(block.frequency)
    keys = np.column_stack([block.group, _rounded(block.speed), _rounded(w)])
    _, index = np.unique(keys, axis=0, return_inverse=True)
    order = np.argsort(index.reshape(-1), kind="stable")
    frequency, speed, kappa, error, first = [], [], [], [], []
    for lines in np.split(order, np.flatnonzero(np.diff(index.reshape(-1)[order])) + 1):
        if lines.size < n:
            continue
        A, F = amplitude[lines].T, block.force[lines].T
        if np.linalg.matrix_rank(F) < n or np.linalg.matrix_rank(A) < n:
            continue
        # More runs than coordinates (repeats): least squares, kappa A = F.
        back = np.linalg.pinv(A)
        k = F @ back
        # d kappa = -kappa dA A^+, readings independent.
        variance = np.abs(k) ** 2 @ (sigma[lines].T ** 2) @ np.abs(back) ** 2
        frequency.append(w[lines[0]])
        speed.append(block.speed[lines[0]])
        kappa.append(k)
        error.append(np.sqrt(variance))
        first.append(lines[0])
    return StiffnessMatrices(
        np.array(frequency), np.array(speed), np.array(kappa).reshape(-1, n, n), np.array(error).reshape(-1, n, n),
        np.array(first, dtype=np.intp),
    )


def _rounded(values: Float) -> Float:
    """Values rounded to nine digits, so that equal conditions compare equal after unit conversion."""
    size = np.abs(values).max(initial=0.0)
    return np.round(values / size, 9) if size else values

