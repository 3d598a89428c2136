"""Values that no rotor has beside what is known, and the factor of a unit that would explain those of a fluid.

Readings or forces in another unit change the whole dynamic stiffness by one factor. Data do not show it; what is known
of the structure, and taken off, then leaves a fluid with negative stiffness or damping.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.faults import of_program
from rotorfit.base.significance import OPEN_ERRORS, SIGNIFICANT_ERRORS
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import closed_form
from rotorfit.estimators.starting.start_points import short_fits
from rotorfit.identify.fitting.quantities import FittedParameter
from rotorfit.models.parameters import bare_name

_POSSIBLE = {"K0": (0.0, np.inf), "D": (0.0, np.inf), "lam": (0.0, 1.0)}
"""Values that a fluid may have. A negative inertia is common in short tests, and no factor changes its sign."""

_FACTORS: tuple[tuple[float, str, str], ...] = (
    (np.sqrt(2.0), "forces are rms values given as peak", "readings are rms values given as peak"),
    (2.0, "readings are peak-to-peak given as 0-peak", "readings are 0-peak given as peak-to-peak"),
    (2 * np.sqrt(2.0), "readings are peak-to-peak given as rms", "readings are rms values given as peak-to-peak"),
    (4.44822, "forces are in lbf given as N", "forces are in N given as lbf"),
    (9.80665, "forces are in kgf given as N", "forces are in N given as kgf"),
    (25.4, "readings are in um given as mil", "readings are in mil given as um"),
    (
        175.127,
        "readings are in inches and forces in lbf",
        "readings are in m and forces in N, taken for inches and lbf",
    ),
    (1000.0, "readings are in um given as mm, or forces in kN given as N", "readings are in mm given as um"),
)
"""Factors on the dynamic stiffness that make it right, and what each and its inverse come from."""


def impossible(problem: Problem, x: Float, params: Mapping[str, FittedParameter]) -> Iterator[str]:
    """Sentences on values of a fluid that are impossible beyond their errors, where the model fits: with the factor
    that would make them possible, as a question; of a fluid that turns against the shaft; of a disk's inertia."""
    yield from _gyration(params)
    off = [name for name, p in params.items() if _is_off(p)]
    if not off:
        return
    known = [name for name, p in params.items() if not p.vary and p.value and p.unit in ("N/m", "N s/m")]
    factors = _factors(problem, x) if known else []
    if factors:
        said = ", ".join(f"{name} {_number(params[name])}" for name in off)
        found = ", ".join(f"{name} {significant(value, 3)}" for name, value in factors[0][2].items())
        ways = " or ".join(f"of {significant(number, 4)} ({cause})" for number, cause, _ in factors[:3])
        yield (
            f"{said}: not possible of a fluid beside what is known ({', '.join(known)}). Is a unit wrong by a factor "
            f"{ways}? With the first the values would be {found}. A stiffness that is negative in truth, as that of a "
            "magnetic bearing, is no error"
        )
        return
    against = [name for name in off if bare_name(name) == "lam" and params[name].value < 0]
    if against:
        turned = ", ".join(f"{name} {_number(params[name])}" for name in against)
        yield (
            f"{turned}: the fluid would turn against the shaft. Is the sense of rotation reversed (the sign of the "
            "speed, x and y exchanged), or the direction of the forces?"
        )


def _gyration(params: Mapping[str, FittedParameter]) -> Iterator[str]:
    """That a disk has an inertia which its mass cannot have: readings of the displacement alone do not show it, because
    Ip, k12, k22 and d2 of a tilt that is not read go with It."""
    if not {"M", "It"} <= params.keys() or not (params["M"].value > 0 and params["It"].value > 0):
        return
    radius = np.sqrt(params["It"].value / params["M"].value)
    edge = np.cbrt(params["M"].value / 7850.0)  # of a cube of steel
    thin, hollow = 0.1, 20.0  # of it: far beyond a rod a hundred times as long as thick, and a wheel of sheet metal
    if not thin * edge < radius < hollow * edge:
        what = f"It {significant(params['It'].value, 3)} kg m^2 beside M {significant(params['M'].value, 3)} kg"
        yield (
            f"{what}: a radius of gyration of {significant(radius, 2)} m, which no disk of this mass has. Is its unit "
            "wrong (kg cm^2, g mm^2)? Where slopes are not read, k12, k22, Ip and d2 go with It"
        )


def _is_off(p: FittedParameter) -> bool:
    """True if a value is outside of what is possible beyond its error."""
    low, high = _POSSIBLE.get(bare_name(p.name), (-np.inf, np.inf))
    far = SIGNIFICANT_ERRORS * p.stderr
    return bool(p.vary and p.resolved and np.isfinite(p.stderr) and (p.value < low - far or p.value > high + far))


def _number(p: FittedParameter) -> str:
    return f"{significant(p.value, 3)} +- {significant(p.stderr, 1)}{'' if p.unit == '1' else ' ' + p.unit}"


def _factors(problem: Problem, x: Float) -> list[tuple[float, str, dict[str, float]]]:
    """Factors on the dynamic stiffness with which all values are possible, what they come from, and the values: those
    that the data bear alike, the nearest to one first."""
    found: list[tuple[float, float, str, dict[str, float]]] = []
    for number, larger, smaller in _FACTORS:
        for factor, cause in ((number, larger), (1 / number, smaller)):
            cost, end = _scaled_fit(problem, x, factor)
            values = dict(zip(problem.space.names, end.tolist(), strict=False))
            own = {name: value for name, value in values.items() if bare_name(name) in _POSSIBLE}
            inside = (_POSSIBLE[bare_name(n)][0] < v < _POSSIBLE[bare_name(n)][1] for n, v in own.items())
            if np.isfinite(cost) and all(inside):
                found.append((cost, number, cause, own))
    least = min((one[0] for one in found), default=np.inf)
    explained = 2 * problem.cost(x) + OPEN_ERRORS**2
    near = [one for one in found if one[0] <= min(least + OPEN_ERRORS**2 / 2, explained)]
    return [one[1:] for one in sorted(near, key=lambda one: one[1])]


def _scaled_fit(problem: Problem, x: Float, factor: float) -> tuple[float, Float]:
    """Cost and values of a short fit of the data as they would be with a dynamic stiffness so many times as large."""
    blocks = []
    for block in problem.blocks:
        over = factor if getattr(block, "imposed", False) else 1 / factor
        blocks.append(block.with_noise(np.full(block.measured.size, over)).with_measured(block.measured * over))
    scaled = replace(problem, blocks=tuple(blocks))
    start = x.copy()
    try:
        start[: len(problem.space.names)] = closed_form(problem.space, scaled.blocks).x
    except (ValueError, np.linalg.LinAlgError) as reason:  # then from the fit itself
        if of_program(reason):
            raise
    end = short_fits(scaled, np.clip(start, problem.space.lower, problem.space.upper)[None])
    return float(end.cost[0]), end.best
