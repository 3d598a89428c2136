"""The graph of a model's lumped coefficients: an entry of the dynamic stiffness by powers of s and of the speed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.compiled import array_function


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """Where lumped coefficients enter the dynamic stiffness, one entry a coefficient, shape ``(E,)``."""

    block: Index
    group: Index
    row: Index  # row of kappa of each entry
    column: Index  # column of kappa of each entry
    power: Index  # power of s
    unit: ComplexArray  # 1 or j
    speed_power: Index  # power of the rotative speed
    speed: Float  # speed to which it is restricted, NaN for all


@dataclass(frozen=True, eq=False, kw_only=True)
class LumpedGraph:
    """Lumped coefficients with speeds and known values as variables: fits that differ in those share one."""

    function: Callable[[Sequence[Any]], Float]
    rows: Index  # coefficient of each derivative
    columns: Index  # fitted value of each derivative
    place: Place  # where they enter, ``speed`` being the running number of the speed, -1 for all


@lru_cache(maxsize=32)
def lumped_graph(
    model: RotorModel,
    template: tuple[tuple[float | None, ...], ...],
    index: tuple[tuple[int, ...], ...],
    kinds: tuple[tuple[tuple[int, int, bool], ...], ...],
    size: int,
) -> LumpedGraph:
    """Expressions of the lumped coefficients of a model in some blocks of observations."""
    x = ca.SX.sym("x", size)
    speed = ca.SX.sym("speed")
    speeds = ca.SX.sym("speeds", sum(count for groups in kinds for _, count, _ in groups))
    known = ca.SX.sym("known", sum(value is None for row in template for value in row))
    symbols = iter(range(known.numel()))
    thetas = [[known[next(symbols)] if value is None else value for value in row] for row in template]
    places: list[tuple[float | complex, ...]] = []
    expressions: list[ca.SX] = []
    first = 0
    for block, groups in enumerate(kinds):
        for group, count, turns in groups:
            theta = [x[k] if k >= 0 else value for k, value in zip(index[group], thetas[group], strict=True)]
            own = [(first + k, speeds[first + k]) for k in range(count)]
            for *entry, expression in _entries(model, theta, speed):
                for degree, at, part in _speed_parts(expression, speed, own, turns):
                    places.append((block, group, *entry, degree, at))
                    expressions.append(part)
            first += count
    numbers = [np.array(column) for column in zip(*places, strict=True)]  # in the order of the attributes
    place = Place(**dict(zip((field.name for field in fields(Place)), numbers, strict=True)))
    return _compiled(ca.vertcat(*expressions), place, (x, speeds, known))


def _entries(
    model: RotorModel, theta: Sequence[ca.SX | float], speed: ca.SX
) -> Iterator[tuple[int, int, int, complex, ca.SX]]:
    """Row, column, power of s, unit and expression of what is not zero in a centred rotor, probes' factors left out."""
    n = len(model.coordinates)
    inputs = ca.vertcat(*theta, speed, 0.0)
    flat = model.functions.graph(inputs)
    factors = model.functions.factor_graph(inputs)
    for number in range(flat.numel()):
        power, rest = divmod(number, 2 * n * n)
        imaginary, place = divmod(rest, n * n)
        row, column = divmod(place, n)
        if not flat[number].is_zero():
            seen = ca.simplify(flat[number] / factors[2 * column])
            yield row, column, power, 1j if imaginary else 1.0 + 0j, seen


def _speed_parts(
    expression: ca.SX, speed: ca.SX, speeds: Sequence[tuple[int, ca.SX]], turns: bool
) -> list[tuple[int, int, ca.SX]]:
    """Split a coefficient by powers of the speed, or by speed where too few speeds were tested for that. Returns the
    power of the speed, running number of the speed or -1 for all, and expression of each part."""
    if not turns:  # a rotor at rest: terms with the speed say nothing
        expression = ca.simplify(ca.substitute(expression, speed, ca.SX(0.0)))
    if not ca.depends_on(expression, speed):
        return [] if expression.is_zero() else [(0, -1, expression)]
    parts, derivative, factorial = [], expression, 1.0
    speed_terms = 5  # powers of the speed looked for in a coefficient
    for degree in range(speed_terms):
        part = ca.simplify(ca.substitute(derivative, speed, ca.SX(0.0)) / factorial)
        if not part.is_zero():
            parts.append((degree, -1, part))
        derivative = ca.simplify(ca.jacobian(derivative, speed))
        factorial *= degree + 1
        if derivative.is_zero() or not derivative.nnz():
            if len(parts) <= len(speeds):
                return parts
            break
    return [(0, number, ca.substitute(expression, speed, own)) for number, own in speeds]


def _compiled(values: ca.SX, place: Place, inputs: tuple[ca.SX, ca.SX, ca.SX]) -> LumpedGraph:
    """Coefficients and their derivatives by the first of the inputs as one function."""
    jacobian = ca.jacobian(values, inputs[0])
    rows, columns = (np.asarray(part, dtype=np.intp) for part in jacobian.sparsity().get_triplet())
    # As an array function: calls of CasADi's own spend most of their time on converting matrices.
    function = array_function(ca.Function("lumped", list(inputs), [ca.densify(values), jacobian]))
    return LumpedGraph(function=function, rows=rows, columns=columns, place=place)
