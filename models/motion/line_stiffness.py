"""Dynamic stiffness of many lines and its slopes, each written out as one graph in the frequency.

:class:`~rotorfit.models.model.CompiledModel` gives coefficients of powers of s, once for each condition of the rotor.
Where the fluid changes from line to line by its eccentricity nothing is shared, and the sum over the powers belongs
into the graph: common terms are computed once, what does not depend on a parameter, a speed or an eccentricity stays
as small as it is, and everything broadcasts, so that many parameter vectors meet many lines.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import ComplexArray, Float
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
    """Dynamic stiffness of a model without its known structure, and its derivatives."""

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
