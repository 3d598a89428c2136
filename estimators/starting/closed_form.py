"""Closed-form identification: matrix inversion (eqs 5 to 9) and straight lines, no iteration and no starting values.

The dynamic stiffness is linear in its lumped coefficients (sums and products of parameters, such as K1 + K2 or D lam).
One linear least-squares problem gives those, and the parameters follow from them one after the other, each from an
equation in which it is the only unknown. Both steps are read off the model's own graph, so they exist for every model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from itertools import islice

import numpy as np

from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness, inverse
from rotorfit.estimators.blocks.row_keys import numbers
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.starting.lumped import Lumped, LumpedStructure, lumped_coefficients
from rotorfit.models.array_types import ComplexArray, Float, Index

_PIECE = 8192  # readings whose equations are held at once
_SETTLED = 1e-6  # relative change of the lumped coefficients after which further passes bring nothing


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """A closed-form estimate.

    Attributes:
        x: estimate, shape ``(p,)``.
        root: derivatives of the lumped coefficients by the parameters, and the information on those; None where
            unweighted.
        open: entries that were taken at their conventional value.
        notes: what had to be assumed, in words.
    """

    x: Float
    root: tuple[Float, Float] | None
    open: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def covar(self) -> Float:
        """Covariance from the propagated noise, shape ``(p, p)``, NaN where unweighted."""
        size = self.x.size - len(self.open)
        found = np.full((size, size), np.nan) if self.root is None else _covariance(*self.root)
        for entry in self.open:
            found = np.insert(np.insert(found, entry, 0.0, axis=0), entry, 0.0, axis=1)
        return found


class ClosedFormError(ValueError):
    """The data do not allow a closed form; the message says what is missing."""


def closed_form(
    space: ParameterSpace, blocks: tuple[Block, ...], *, weighted: bool = True, passes: int = 2
) -> ClosedForm:
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
    return closed_forms(space, blocks, weighted=weighted, passes=(passes,))[0]


def closed_forms(
    space: ParameterSpace,
    blocks: tuple[Block, ...],
    *,
    weighted: bool = True,
    passes: tuple[int, ...],
    enough: Callable[[Float], bool] | None = None,
) -> list[ClosedForm]:
    """Closed forms after several numbers of passes, at the cost of the last; see :func:`closed_form`.

    Args:
        space, blocks, weighted: as there.
        passes: numbers of passes, ascending.
        enough: whether an estimate is so good that further passes are not worth their time.
    """
    chosen = [complete_lines(block) for block in blocks if isinstance(block, Responses)]
    chosen = [block for block in chosen if block.speed.size]
    if not chosen:
        raise ClosedFormError(
            "the closed form needs responses to a circular force with readings at every plane of the model; "
            "give start values instead"
        )
    lumped = lumped_coefficients(LumpedStructure.of(space, chosen))
    if not _determined(space, lumped, chosen):
        return _with_convention(space, blocks, weighted, passes, enough)
    typical = space.template if space.model.shaft is None else _typical_theta(space)
    if weighted:
        return _weighted(space, lumped, _kept_passes(lumped, chosen, typical), passes, enough)
    equations = [_Equations(lumped, number, block, typical) for number, block in enumerate(chosen)]
    solution = _solve([e.stiffness_balance() for e in equations])
    x, notes = _parameters(space, lumped, lumped.offset + lumped.spread @ solution, None)
    return [ClosedForm(x, None, notes=notes)] * len(passes)


def _weighted(
    space: ParameterSpace,
    lumped: Lumped,
    solutions: Iterator[tuple[Float, Float]],
    passes: tuple[int, ...],
    enough: Callable[[Float], bool] | None,
) -> list[ClosedForm]:
    found: dict[int, ClosedForm] = {}
    before = np.zeros(0)
    for number in range(1, max(passes) + 1):
        try:
            solution, information = next(solutions)
        except np.linalg.LinAlgError as reason:
            if not found:
                raise ClosedFormError("the passes diverge: the noise hides a response") from reason
            break  # further passes diverge; the best of those found is near enough to start from
        settled = number > 1 and bool(np.all(np.abs(solution - before) <= _SETTLED * np.abs(solution)))
        before = solution
        if settled or number in passes:
            x, notes = _parameters(space, lumped, lumped.offset + lumped.spread @ solution, information)
            root = lumped.linearise(x)[1][lumped.basis], information
            found[number] = ClosedForm(x, root, notes=notes)
        if settled or (number in found and enough is not None and enough(found[number].x)):
            break
    return [found.get(number, found[max(found)]) for number in passes]


def _kept_passes(lumped: Lumped, blocks: list[Responses], typical: Float) -> Iterator[tuple[Float, Float]]:
    """What :func:`_passes` yields; the data keep it, for the next fit with other bounds, priors or loss."""
    notes = blocks[0].layout_notes
    of = [lumped, *(values for block in blocks for values in (block.measured, block.sigma))]
    given, known, done = notes.get(_passes, ([], b"", ()))
    if known != typical.tobytes() or len(given) != len(of) or any(a is not b for a, b in zip(given, of, strict=True)):
        done = ()
    yield from done
    for found in islice(_passes(lumped, blocks, typical), len(done), None):
        done = (*done, found)
        notes[_passes] = of, typical.tobytes(), done
        yield found


def _passes(lumped: Lumped, blocks: list[Responses], typical: Float) -> Iterator[tuple[Float, Float]]:
    """Independent lumped coefficients and the information on them after one weighted pass, after two, and so on."""
    pieces = [(number, piece) for number, block in enumerate(blocks) for piece in block.split(_PIECE)]
    equations = [_Equations(lumped, *piece, typical) for piece in pieces]
    reduced = _triangle if len(equations) > 1 else np.asarray  # the systems of many pieces fit no memory
    solution = _solve([reduced(e.force_balance(e.amplitude, e.force_weight())) for e in equations])
    size = solution.size
    first = True
    while True:
        values = lumped.offset + lumped.spread @ solution
        systems, projected, information = [], np.zeros((size, size + 1)), np.zeros((size, size))
        for e in equations:
            H = e.inverse(values)
            weight = e.response_weight(H)
            system = e.force_balance(e.amplitude, weight)
            if first:
                systems.append(reduced(system))
                instruments = system[:-1]
            else:
                instruments = e.sensitivities(e.predicted(H), weight)
                projected += instruments @ system.T
            information += instruments @ instruments.T
        solution = _solve(systems) if first else _solve_projected(projected, information)
        first = False
        yield solution, information


def _covariance(jacobian: Float, information: Float) -> Float:
    """Covariance of the parameters from the information on the lumped coefficients."""
    of_parameters = jacobian.T @ information @ jacobian
    # Unit diagonal first: masses and stiffnesses are many decades apart.
    size = np.sqrt(np.maximum(np.diag(of_parameters), 0.0))
    scale = 1 / np.where(size > 0, size, 1.0)
    scaled = of_parameters * np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-15, hermitian=True) * np.outer(scale, scale))


def _determined(space: ParameterSpace, lumped: Lumped, blocks: list[Responses]) -> bool:
    """Whether such a test can give all independent lumped coefficients, judged on exact responses of a typical rotor.

    Noise hides the defect: the force balance of a plane that is never forced is homogeneous, and noisy data "solve" it
    with zeros.
    """
    conditions = [part for b in blocks for part in (
        numbers(b.speed), b.speed != 0, b.frequency,
        b.coordinate if b.imposed else np.round(b.force / np.abs(b.force).max(axis=1, keepdims=True), 6),
    )]  # fmt: skip
    key = blake2b(b"".join(np.ascontiguousarray(part).tobytes() for part in conditions)).digest()
    if key not in lumped.determined:
        lumped.determined[key] = _is_determined(space, lumped, blocks)
    return lumped.determined[key]


def _is_determined(space: ParameterSpace, lumped: Lumped, blocks: list[Responses]) -> bool:
    rng = np.random.default_rng(1)
    x = _typical(space) * rng.uniform(0.8, 1.25, len(space.names))
    theta = space.theta(np.concatenate([x, np.zeros(len(space.nuisance))]))
    designs = []
    for number, block in enumerate(blocks):
        equations = _Equations(lumped, number, block, theta)
        H = inverse(dynamic_stiffness(block, theta))
        amplitude = equations.predicted(H)
        weight = H / np.abs(amplitude).max(axis=1)[:, None, None]
        designs.append(equations.sensitivities(amplitude, weight))
    design = np.concatenate(designs, axis=1)
    norm = np.linalg.norm(design, axis=1, keepdims=True)
    if not norm.all():
        return False
    power = np.linalg.svd(design / norm, compute_uv=False)
    return bool(power[-1] > 1e-9 * power[0])


def _with_convention(
    space: ParameterSpace,
    blocks: tuple[Block, ...],
    weighted: bool,
    passes: tuple[int, ...],
    enough: Callable[[Float], bool] | None,
) -> list[ClosedForm]:
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
        note = f"{space.names[entry]} taken as {nominal:g}: these data leave it open"
        whole = partial(np.insert, obj=entry, values=nominal)
        better = None if enough is None else partial(_with_entry, enough, whole)
        return [
            replace(found, x=whole(found.x), open=(*found.open, entry), notes=(note, *found.notes))
            for found in closed_forms(reduced, blocks, weighted=weighted, passes=passes, enough=better)
        ]
    raise ClosedFormError(
        "these data do not determine the lumped coefficients of the model: fix parameters or give start values"
    )


def _with_entry(enough: Callable[[Float], bool], whole: Callable[[Float], Float], x: Float) -> bool:
    return enough(whole(x))


def complete_lines(block: Responses) -> Responses:
    """The lines of a block that have a reading at every coordinate."""
    if block.imposed and len(block.model.coordinates) > 1:
        return block.lines(np.zeros(block.speed.size, dtype=bool))
    needed = 1 if block.imposed else len(block.model.coordinates)
    whole = np.bincount(block.line, minlength=block.speed.size) == needed
    return block if whole.all() else block.lines(whole)


# ---- linear least squares ----------------------------------------------------------------------------


class _Equations:
    """Equations of motion ``kappa A = F`` of one block, linear in the independent lumped coefficients.

    Attributes:
        amplitude, force, sigma: readings, forces and noise at every coordinate of every line, shape ``(L, n)``.
    """

    def __init__(self, lumped: Lumped, number: int, block: Responses, typical: Float) -> None:
        self.block = block
        # A known structure goes to the side of the forces; its scale factors, not linear here, stay typical.
        known = block.known_stiffness(typical)
        self._known = None if known is None else known.values
        if block.imposed:
            self.amplitude, self.force, self.sigma = block.force, block.measured[:, None], block.sigma[:, None]
        else:
            self.amplitude, self.sigma = block.amplitudes()
            self.force = block.force
        place = lumped.place
        self._mine = mine = np.flatnonzero(place.block == number)
        self._row, self._column = place.row[mine], place.column[mine]
        s_powers = block.s ** np.arange(place.power.max() + 1)[:, None]
        speed_powers = block.speed ** np.arange(place.speed_power.max() + 1)[:, None]
        self._factor = place.unit[mine, None] * s_powers[place.power[mine]] * speed_powers[place.speed_power[mine]]
        here = place.group[mine, None] == block.group
        here &= np.isnan(place.speed[mine, None]) | (place.speed[mine, None] == block.speed)
        self._factor *= here
        combine = np.vstack([lumped.spread[mine].T, lumped.offset[mine]])
        self._unknowns = len(combine)
        # For each row of the equation of motion: columns and factors of its coefficients, and what combines them.
        rows = [np.flatnonzero(self._row == row) for row in range(self.amplitude.shape[1])]
        self._rows = [(self._column[own], self._factor[own], np.ascontiguousarray(combine[:, own])) for own in rows]

    def kappa(self, values: Float) -> ComplexArray:
        """Dynamic stiffness of each line from lumped coefficients, shape ``(L, n, n)``."""
        n = self.amplitude.shape[1]
        result = np.zeros((n, n, self.amplitude.shape[0]), dtype=complex)
        for row, column, factor, value in zip(
            self._row.tolist(), self._column.tolist(), self._factor, values[self._mine].tolist(), strict=True
        ):
            result[row, column] += value * factor
        kappa = np.moveaxis(result, -1, 0)
        return kappa if self._known is None else kappa + self._known

    def inverse(self, values: Float) -> ComplexArray:
        """Receptance of each line from lumped coefficients, shape ``(L, n, n)``."""
        return inverse(self.kappa(values))

    def predicted(self, H: ComplexArray) -> ComplexArray:
        """Amplitudes with a receptance, shape ``(L, n)``; imposed ones are what they are."""
        return self.block.force if self.block.imposed else np.asarray(np.einsum("lij,lj->li", H, self.block.force))

    def force_weight(self) -> Float:
        """Weight of each line that brings it to a force of one, shape ``(L,)``."""
        return np.asarray(1 / np.abs(self.force).max(axis=1))

    def response_weight(self, H: ComplexArray) -> ComplexArray:
        """Weights that turn the force error into the response error over its noise, independent between readings."""
        return np.asarray((np.eye(1) + 0j if self.block.imposed else H) / self.sigma[:, :, None])

    def force_balance(self, amplitude: ComplexArray, weight: ComplexArray | Float) -> Float:
        """Columns ``weight kappa A`` over ``weight F``, one an equation, shape ``(B + 1, 2 L n)``."""
        return _weigh(self._sides(amplitude, self.force), weight)

    def sensitivities(self, amplitude: ComplexArray, weight: ComplexArray) -> Float:
        """The left side of :meth:`force_balance` alone, shape ``(B, 2 L n)``."""
        return _weigh(self._sides(amplitude, self.force)[:, :-1], weight)

    def _sides(self, amplitude: ComplexArray, force: ComplexArray) -> ComplexArray:
        """Both sides of kappa A = F, shape ``(n, B + 1, L)``."""
        count, n = amplitude.shape
        result = np.zeros((n, self._unknowns, count), dtype=complex)
        columns = np.ascontiguousarray(amplitude.T)
        for row, (column, factor, combine) in enumerate(self._rows):
            products = factor * columns[column]
            # Real times complex along the lines: BLAS has that for real numbers only.
            np.matmul(combine, products.view(float), out=result[row].view(float))
        result[:, -1] = force.T - result[:, -1]
        if self._known is not None:
            result[:, -1] -= np.einsum("lij,lj->il", self._known, amplitude)
        return result

    def stiffness_balance(self) -> Float:
        """Entries of the inverted dynamic stiffness (eq. 7), equally weighted; force balance where there are none."""
        if self.block.imposed:
            return self.force_balance(self.amplitude, self.force_weight())
        stiffness = stiffness_matrices(self.block)
        if stiffness.kappa.size == 0:
            return self.force_balance(self.amplitude, np.ones(len(self.force)))
        systems = []
        for column in range(stiffness.kappa.shape[-1]):
            unit = np.zeros_like(self.amplitude)
            unit[:, column] = 1.0
            sides = self._sides(unit, np.zeros_like(unit))[:, :, stiffness.first_line]
            sides[:, -1] += stiffness.kappa[:, :, column].T
            systems.append(_one_a_column(np.swapaxes(sides, 0, 1)))
        return np.concatenate(systems, axis=1)


def _weigh(sides: ComplexArray, weight: ComplexArray | Float) -> Float:
    """Sides of equations, shape ``(n, C, L)``, mixed by weights of shape ``(L, n, n)``: real, shape ``(C, 2 L n)``.

    Weights of shape ``(L,)`` are those of whole lines.
    """
    n, rows, count = sides.shape
    mixed = np.empty((rows, n, count), dtype=complex)
    product = np.empty((rows, count), dtype=complex)
    for i in range(n):
        if weight.ndim == 1:
            np.multiply(sides[i], weight, out=mixed[:, i])
            continue
        np.multiply(sides[0], weight[:, i, 0], out=mixed[:, i])
        for j in range(1, n):
            np.multiply(sides[j], weight[:, i, j], out=product)
            mixed[:, i] += product
    return _one_a_column(mixed)


def _one_a_column(values: ComplexArray) -> Float:
    return np.ascontiguousarray(values).reshape(values.shape[0], -1).view(float)


def _triangle(system: Float) -> Float:
    """As few equations as unknowns with the same least-squares solution."""
    return np.asarray(np.linalg.qr(system.T, mode="r")).T


def _solve(systems: list[Float]) -> Float:
    """Least squares with equilibrated unknowns; the last row of each system is the right side."""
    system = np.concatenate(systems, axis=1) if len(systems) > 1 else systems[0]
    norm = np.linalg.norm(system, axis=1)
    norm = np.where(norm > 0, norm, 1.0)
    triangle = _triangle(system / norm[:, None]).T
    solution = np.linalg.lstsq(triangle[:, :-1], triangle[:, -1], rcond=1e-13)[0]
    return np.asarray(solution * norm[-1] / norm[:-1])


def _solve_projected(projected: Float, information: Float) -> Float:
    """Solve equations projected on instruments, whose own products are the information."""
    norm = np.sqrt(np.diag(information))
    norm = np.where(norm > 0, norm, 1.0)
    scaled = projected / norm[:, None]
    return np.asarray(np.linalg.solve(scaled[:, :-1] / norm, scaled[:, -1]) / norm)


# ---- from lumped coefficients to parameters ------------------------------------------------------------------------


def _parameters(
    space: ParameterSpace, lumped: Lumped, values: Float, information: Float | None
) -> tuple[Float, tuple[str, ...]]:
    """Solve the lumped expressions for the parameters, one unknown at a time, then take one weighted step on all."""
    size = len(space.names)
    x = lumped.parameters(values, _typical(space))
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
    typical = _typical(space)[missing]
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
    return start, (f"{', '.join(names)}: no coefficient gives them singly; solved jointly from typical values",)


def _typical(space: ParameterSpace) -> Float:
    """Nonzero sizes of the free parameters, shape ``(p,)``."""
    parameters = [space.model.parameter(name) for name in space.base]
    size = len(parameters)
    guess = np.array([p.scale if p.nominal is None else p.nominal for p in parameters])
    inside = np.clip(guess, space.lower[:size], space.upper[:size])
    return np.where(inside == 0, 1e-3, inside)


def _typical_theta(space: ParameterSpace) -> Float:
    return space.theta(np.concatenate([_typical(space), np.zeros(len(space.nuisance))]))


def _one_step(lumped: Lumped, values: Float, information: Float, x: Float) -> Float:
    """One linearised weighted step on all lumped coefficients at once: it uses the redundant ones as well."""
    now, jacobian = lumped.linearise(x)
    # information is that of the independent coefficients b, all = S b + o: least squares on S(b_model - b) = 0
    J = lumped.solve_spread(jacobian)
    miss = lumped.solve_spread(values - now)
    scale = np.maximum(np.abs(x), 1e-12)
    normal = J.T @ information @ J * np.outer(scale, scale)
    root = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    step = np.linalg.lstsq(normal / np.outer(root, root), (J.T @ information @ miss) * scale / root, rcond=1e-10)[0]
    moved = x + step / root * scale
    # The linearisation holds near the solution only; a step that changes a parameter beyond its size is not taken.
    return moved if np.all(np.abs(moved - x) <= 0.5 * np.abs(x) + 1e-300) else x


# ---- eq. 7, frequency by frequency ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
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
    size = np.bincount(index.reshape(-1))
    begin = np.cumsum(size) - size
    parts = []
    for count in np.unique(size[size >= n]).tolist():
        lines = order[begin[size == count][:, None] + np.arange(count)]
        A, F = np.swapaxes(amplitude[lines], 1, 2), np.swapaxes(block.force[lines], 1, 2)
        good = (np.linalg.matrix_rank(F) == n) & (np.linalg.matrix_rank(A) == n)
        lines, A, F = lines[good], A[good], F[good]
        # More runs than coordinates (repeats): least squares, kappa A = F.
        back = np.linalg.pinv(A)
        k = F @ back
        # d kappa = -kappa dA A^+, readings independent.
        variance = np.abs(k) ** 2 @ np.swapaxes(sigma[lines] ** 2, 1, 2) @ np.abs(back) ** 2
        parts.append((lines[:, 0], k, np.sqrt(variance)))
    if not parts:
        kappa, error = np.empty((0, n, n), dtype=complex), np.empty((0, n, n))
        return StiffnessMatrices(
            frequency=np.empty(0), speed=np.empty(0), kappa=kappa, sigma=error, first_line=np.empty(0, dtype=np.intp)
        )
    first, kappa, error = (np.concatenate(column) for column in zip(*parts, strict=True))
    sort = np.lexsort([w[first], block.speed[first], block.group[first]])
    first = first[sort]
    return StiffnessMatrices(
        frequency=w[first], speed=block.speed[first], kappa=kappa[sort], sigma=error[sort], first_line=first
    )


def _rounded(values: Float) -> Float:
    """Values rounded to nine digits, so that equal conditions compare equal after unit conversion."""
    size = np.abs(values).max(initial=0.0)
    return np.round(values / size, 9) if size else values
