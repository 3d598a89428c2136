"""Stiffness of lines by one graph in the frequency, and the journal of a nonlinear model, where eccentricity enters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models.compiled import array_function
from rotorfit.models.model import RotorModel
from rotorfit.models.shafts.shaft import KnownStiffness


def at_frequency(coefficients: list[tuple[Any, Any]], w: Any) -> tuple[Any, Any]:
    """Real and imaginary part of a polynomial in ``s = j w`` from those of its coefficients, symbolic."""
    re, im = ca.SX(0), ca.SX(0)
    for power in range(len(coefficients) - 1, -1, -1):
        a, b = coefficients[power]
        turned = ((a, b), (-b, a), (-a, -b), (b, -a))[power % 4]
        re, im = re * w + turned[0], im * w + turned[1]
    return re, im


def arguments(theta: ArrayLike, *others: ArrayLike) -> list[Any]:
    """Inputs of a compiled graph, parameters first; a single vector goes in as numbers, cheaper than arrays of one."""
    theta = np.asarray(theta, dtype=float)
    single = theta.ndim < 3 and theta.size == theta.shape[-1]
    parameters = theta.ravel() if single else np.moveaxis(theta, -1, 0)
    return [*parameters, *(np.asarray(other, dtype=float)[()] for other in others)]


class LineStiffness:
    """Dynamic stiffness of a model without its known structure, and its derivatives, each written out as one graph in
    the frequency. :class:`~rotorfit.models.coefficients.CompiledModel` gives coefficients of powers of s, once for each
    condition of the rotor. Where the fluid changes from line to line by its eccentricity nothing is shared, and the sum
    over the powers belongs into the graph: common terms are computed once, and everything broadcasts, so that many
    parameter vectors meet many lines."""

    def __init__(self, model: RotorModel) -> None:
        theta, speed, eccentricity, matrices, _ = model.symbolic
        self._size = size = len(model.coordinates)
        w = ca.SX.sym("w")
        parts = [
            at_frequency([(m.re[i, j], m.im[i, j]) for m in matrices], w) for i in range(size) for j in range(size)
        ]
        flat = ca.vertcat(*[ca.densify(part) for pair in parts for part in pair])
        inputs = ca.vertcat(theta, speed, eccentricity, w)
        self._values = array_function(ca.Function("stiffness", [inputs], [ca.cse(flat)]))
        jacobian = ca.jacobian(flat, ca.vertcat(theta, eccentricity))
        row, column = (np.asarray(index, dtype=np.intp) for index in jacobian.sparsity().get_triplet())
        places = sorted(set(zip(column.tolist(), (row // 2).tolist(), strict=True)))
        self.inputs = tuple(place for place, _ in places)
        self.rows, self.columns = (tuple(pair) for pair in zip(*(divmod(at, size) for _, at in places), strict=True))
        slopes = [jacobian[2 * at + part, place] for place, at in places for part in (0, 1)]
        self._slopes = array_function(ca.Function("slopes", [inputs], [ca.cse(ca.densify(ca.vertcat(*slopes)))]))

    def values(self, theta: ArrayLike, w: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Dynamic stiffness, shape ``(n, n, ...)``."""
        flat = self._values(arguments(theta, speed, eccentricity, w))
        return complex_pairs(flat).reshape(self._size, self._size, *flat.shape[1:])

    def slopes(self, theta: ArrayLike, w: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Derivatives by parameters and eccentricity, shape ``(K, ...)``."""
        return complex_pairs(self._slopes(arguments(theta, speed, eccentricity, w)))


def complex_pairs(flat: Float) -> ComplexArray:
    """Real and imaginary parts in turn as complex numbers, shape ``(n, ...)``."""
    result = np.empty((flat.shape[0] // 2, *flat.shape[1:]), dtype=complex)
    result.real, result.imag = flat[0::2], flat[1::2]
    return result


@lru_cache(maxsize=64)
def line_stiffness(model: RotorModel) -> LineStiffness:
    """The functions of a model, compiled once."""
    return LineStiffness(model)


def known_structure(model: RotorModel, vectors: Float, s: ComplexArray, speed: Float) -> KnownStiffness:
    """Contribution of a model's known structure to its stiffness, lines along the last axis of values and slopes."""
    shape = np.broadcast_shapes(vectors.shape[:-1], s.shape)
    flat = np.broadcast_to(vectors, (*shape, vectors.shape[-1])).reshape(-1, vectors.shape[-1])
    known = model.known_stiffness(flat, np.broadcast_to(s, shape).ravel(), np.broadcast_to(speed, shape).ravel())
    values, slopes = np.moveaxis(known.values, 0, -1), np.moveaxis(known.slopes, 1, -1)
    return KnownStiffness(
        values.reshape(*values.shape[:-1], *shape), known.inputs, slopes.reshape(*slopes.shape[:-1], *shape)
    )


class Journal:
    """A coordinate whose orbit changes the fluid there: of what depends on its eccentricity there is the entry (b, b)
    alone, so that with ``Delta(eps)`` its change and H the receptance of the rotor with this journal centred,
    ``A_b = (H F)_b / (1 + H_bb Delta)``."""

    def __init__(self, model: RotorModel, at: int) -> None:
        theta, speed, eccentricity, matrices, _ = model.symbolic
        self.model = model
        self.at = at
        self.plane = model.coordinates[at].plane
        clearance = model.clearance_at(self.plane)
        if clearance is None:
            raise ValueError(f"{model.name} depends on eccentricity at {self.plane} and has no clearance there")
        self.clearance = clearance
        entries = [part for m in matrices for part in (m.re[self.at, self.at], m.im[self.at, self.at])]
        drive = ca.densify(ca.vertcat(*entries))
        centred = ca.substitute(drive, eccentricity, 0.0)  # exactly zero for what does not change
        parts = [drive[i] - centred[i] if ca.depends_on(drive[i], eccentricity) else 0.0 for i in range(drive.numel())]
        change = ca.densify(ca.vertcat(*parts))
        slope = ca.jacobian(drive, eccentricity)
        # F = C0(|z|/c) z has the derivative C0 + coupling (1 + exp(2 j phi) conj) by z, phi being the direction of z.
        coupling = ca.densify(slope[:2] * eccentricity / 2)
        inputs = ca.vertcat(theta, speed, eccentricity)
        self.inertia_changes = bool(ca.depends_on(change[4:], eccentricity))
        self.change_graph = ca.Function("change", [inputs], [ca.cse(change)])
        self._coefficient_change = array_function(self.change_graph)
        self._coupling = array_function(ca.Function("coupling", [inputs], [coupling]))
        slopes = ca.densify(ca.jacobian(coupling, ca.vertcat(theta, eccentricity)))
        self._coupling_jacobian = array_function(ca.Function("coupling_jacobian", [inputs], [slopes]))
        self.graph = _excess_graph(theta, speed, eccentricity, change)
        self._excess = array_function(self.graph)

    def excess(
        self,
        theta: ArrayLike,
        w: ArrayLike,
        speed: ArrayLike,
        drive: ArrayLike,
        receptance: ComplexArray,
        eccentricity: ArrayLike,
    ) -> Float:
        """Excess of the eccentricity, its slope, change of the drive-point stiffness and its slope, ``(6, ...)``."""
        return self._excess(arguments(theta, speed, eccentricity, w, drive, receptance.real, receptance.imag))

    def change_of(self, theta: ArrayLike, speed: ArrayLike) -> Callable[[Float], ComplexArray]:
        """Change of the journal's coefficients by powers of s, ``(order + 1, ...)``, by the eccentricity."""
        rotors = arguments(theta, speed)
        if all(np.ndim(value) == 0 for value in rotors):
            of_one = _change_of_one(self, tuple(map(float, rotors)))
            return lambda eccentricity: complex_pairs(of_one([np.asarray(eccentricity, dtype=float)[()]]))

        def change(eccentricity: Float) -> ComplexArray:
            return complex_pairs(self._coefficient_change([*rotors, np.asarray(eccentricity, dtype=float)[()]]))

        return change

    def coupling(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Half the eccentricity times the slope of the static stiffness, N/m. About an equilibrium at an angle phi a
        small displacement ``dz`` of the journal changes the force by ``C0 dz + coupling (dz + exp(2 j phi) conj(dz))``.
        """
        flat = self._coupling(arguments(theta, speed, eccentricity))
        return np.asarray(flat[0] + 1j * flat[1])

    def coupling_jacobian(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Derivatives of :meth:`coupling` by the parameters and, last, the eccentricity, shape ``(P + 1, ...)``."""
        flat = self._coupling_jacobian(arguments(theta, speed, eccentricity))
        return np.asarray(flat[0::2] + 1j * flat[1::2])


@lru_cache(maxsize=64)
def _change_of_one(seat: Journal, rotor: tuple[float, ...]) -> Callable[[Sequence[Float]], Float]:
    """One rotor is integrated over thousands of instants: what its values alone decide is worked out once."""
    eccentricity = ca.SX.sym("eccentricity")
    parts = seat.change_graph(ca.vertcat(*rotor, eccentricity))
    return array_function(ca.Function("change", [eccentricity], [ca.cse(ca.densify(parts))]))


@lru_cache(maxsize=64)
def journals(model: RotorModel) -> tuple[Journal, ...]:
    """The journals of a model that depends on eccentricity, each by that of its own orbit, compiled once."""
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; laws of eccentricity need complex coordinates")
    return tuple(Journal(model, at) for at in _coordinates(model))


def journal(model: RotorModel) -> Journal:
    """The journal of a model that has one, for motion other than centred orbits."""
    seats = journals(model)
    if len(seats) > 1:
        planes = " and ".join(seat.plane for seat in seats)
        raise ValueError(
            f"{model.name} changes with the orbits at {planes}. Centred orbits are worked out for several journals; "
            "constant loads, positions off centre, imposed orbits and whirl beyond the onset for one: give the law of "
            f"one plane alone, law={{{seats[0].plane!r}: ...}}"
        )
    return seats[0]


def _coordinates(model: RotorModel) -> list[int]:
    functions = model.functions
    chosen = functions.inputs == functions.n_parameters + 1
    places = set(zip(functions.rows[chosen].tolist(), functions.columns[chosen].tolist(), strict=True))
    if not places:
        raise ValueError(f"{model.name} as used here does not depend on eccentricity; give it a law")
    beside = [(row, column) for row, column in places if row != column or model.coordinates[row].axis != "z"]
    if beside:
        raise ValueError(
            f"{model.name}: eccentricity enters the stiffness at {len(places)} places; only entries on the diagonal, "
            "each of the displacement at a plane, may change, with the orbit there"
        )
    return sorted(row for row, _ in places)


def _excess_graph(theta: ca.SX, speed: ca.SX, eccentricity: ca.SX, change: ca.SX) -> ca.Function:
    """Excess that :meth:`Journal.excess` evaluates, inputs in its order but the eccentricity behind the speed."""
    w, drive, h_re, h_im = (ca.SX.sym(name) for name in ("w", "drive", "h_re", "h_im"))
    powers = range(change.numel() // 2)
    re, im = at_frequency([(change[2 * k], change[2 * k + 1]) for k in powers], w)
    by_eps = [ca.jacobian(part, eccentricity) for part in (re, im)]
    # ratio = 1 + h Delta, size = drive / |ratio|, its slope -size Re(h Delta' / ratio)
    ratio_re, ratio_im = 1 + h_re * re - h_im * im, h_re * im + h_im * re
    over = 1 / (ratio_re**2 + ratio_im**2)
    size = drive * ca.sqrt(over)
    turn_re, turn_im = h_re * by_eps[0] - h_im * by_eps[1], h_re * by_eps[1] + h_im * by_eps[0]
    growth = -size * (turn_re * ratio_re + turn_im * ratio_im) * over
    results = ca.densify(ca.vertcat(size - eccentricity, growth - 1, re, im, *by_eps))
    return ca.Function("excess", [ca.vertcat(theta, speed, eccentricity, w, drive, h_re, h_im)], [ca.cse(results)])
