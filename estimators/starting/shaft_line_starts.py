"""Where a fit to spectral lines begins: linear least squares, line after line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, ComplexArray, Float
from rotorfit.estimators.blocks.shaft_lines import LineResponses
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.misfit.ratios import LogRatioProblem, Ratios, ratios_of
from rotorfit.estimators.signals.ratios import least_squares
from rotorfit.estimators.signals.start_up_lines import shaft_of_lines
from rotorfit.estimators.starting.start_points import full_vector
from rotorfit.models.shafts.combination_lines import Order

_REWEIGHTINGS = 4
"""Rounds of reweighting: an equation error is weighed by the stiffness that it was multiplied with."""
_SIZES = np.geomspace(10**-4.5, 10**1.5, 13)
"""Sizes tried of a parameter of which lines give only ratios to it, over the typical one."""


def has_lines(problem: Problem) -> bool:
    """True if spectral lines are among what is fitted."""
    return any(block.shaft_lines for block in problem.blocks)


def round_part(problem: Problem) -> Problem | None:
    """The problem of a rotor with a turning element as if it were round, from its motion at w; None of others. What is
    fitted besides comes last, so that the start of this problem is the beginning of that of the whole one."""
    space = problem.space
    rotor = space.model.round_rotor
    if rotor is None:
        return None
    blocks = [found for block in problem.blocks if (found := block.as_if_round(rotor)) is not None]
    kept = [i for i, name in enumerate(space.base) if name in rotor.parameter_names]
    if len(blocks) < len(problem.blocks) or not kept:
        return None
    round_space = replace(
        space,
        model=rotor,
        names=tuple(space.names[i] for i in kept),
        base=tuple(space.base[i] for i in kept),
        template=space.template[:, : len(rotor.parameters)],
        index=space.index[:, : len(rotor.parameters)],
        lower=space.lower[: len(kept)],
        upper=space.upper[: len(kept)],
        nuisance=(),
    )
    priors = tuple(prior for prior in problem.priors if prior.entry < len(kept))
    return replace(problem, space=round_space, blocks=tuple(blocks), priors=priors, factors=())


def support_starts(problem: Problem, start: Float) -> list[Float]:
    """Starts with supports that differ by a typical amount."""
    space = problem.space
    at = {kind: [i for i, base in enumerate(space.base) if base.startswith(kind)] for kind in ("dKs", "angle_s")}
    if space.model.line_count == 2 or not at["dKs"]:
        return [start]
    starts = []
    for sign in (1.0, -1.0):
        for angle in (0.0, np.pi / 4) if at["angle_s"] else (0.0,):
            moved = start.copy()
            moved[at["dKs"]] = [sign * space.model.parameter(space.base[i]).scale for i in at["dKs"]]
            moved[at["angle_s"]] = angle
            starts.append(moved)
    return starts


def line_start(problem: Problem) -> Float:
    """Start values of the fitted parameters, shape ``(p,)``; typical sizes where the lines do not tell."""
    space = problem.space
    model = space.model
    values = {name: model.parameter(name).scale for name in model.parameter_names}
    values |= dict.fromkeys(("dK_cos", "dK_sin", "ec", "es", "Px", "Py"), 0.0)
    values |= dict.fromkeys([name for name in values if name[:2] in ("R1", "R2")], 0.0)
    known = np.asarray((space.index < 0).all(axis=0)).tolist()
    template = dict(zip(model.parameter_names, space.template[0].tolist(), strict=True))
    fixed = {name: template[name] for name, is_known in zip(model.parameter_names, known, strict=True) if is_known}
    readings = _readings(problem)
    for step in (_round_part, _image, _steady, _torsion):
        values |= step(readings, values | fixed)
        values |= fixed
    start = np.array([values[name] for name in space.base])
    ratios = ratios_of(problem)
    if ratios is None or start[ratios.entry] != ratios.size or not start[ratios.numerators].any():
        return start
    return _along_the_valley(problem, ratios, full_vector(problem, start))[: start.size]


def _along_the_valley(problem: Problem, ratios: Ratios, start: Float) -> Float:
    """The start with the best of several sizes of a parameter of which lines give only ratios, and steps of all else.
    Noise makes more than one dent in the valley: which is the deeper is seen by a step more, and between the sizes."""
    objective = LogRatioProblem(problem, ratios)
    lower, upper = ratios.bounds(problem.space)
    sizes = np.log(_SIZES)
    sizes = sizes[(sizes > lower[ratios.entry]) & (sizes < upper[ratios.entry])]
    places = np.tile(ratios.of(start), (sizes.size, 1))
    places[:, ratios.entry] = sizes
    steps = [_held_step(objective, place) for place in places]
    costs = np.array([np.inf, *(cost for cost, _ in steps), np.inf])
    dents = np.flatnonzero((costs[1:-1] <= costs[:-2]) & (costs[1:-1] <= costs[2:]) & np.isfinite(costs[1:-1]))
    ends = []
    for i in dents.tolist():
        for between in (-1 / 3, 0.0, 1 / 3):
            place = steps[i][1].copy()
            place[ratios.entry] += between * np.log(_SIZES[1] / _SIZES[0])
            ends.append(_held_step(objective, np.clip(place, lower, upper)))
    if not ends:
        return start
    return ratios.vectors(np.clip(min(ends, key=lambda end: end[0])[1], lower, upper))


def _held_step(objective: LogRatioProblem, y: Float) -> tuple[float, Float]:
    """Where Gauss-Newton's step leads with the size held, and the cost foretold there; infinite where there is none."""
    cost, gradient, matrix = objective.gauss_newton(y)
    if not np.isfinite(cost + gradient.sum() + matrix.sum()):
        return np.inf, y
    # What matters to the data by less than round-off at its typical size stays where it is.
    space = objective.problem.space
    typical = np.concatenate([space.typical, np.full(len(space.nuisance), 0.1)])
    determined = np.diag(matrix) * typical**2 > RANK_TOLERANCE * cost
    determined[objective.ratios.entry] = False
    moving = np.flatnonzero(determined)
    size = np.sqrt(np.diag(matrix)[moving])
    along = gradient[moving] / size
    way = -np.linalg.lstsq(matrix[np.ix_(moving, moving)] / np.outer(size, size), along, rcond=RANK_TOLERANCE)[0]
    end = y.copy()
    end[moving] += way / size
    return float(cost + along @ way / 2), end


_Columns = tuple[Float, Float, ComplexArray, ComplexArray, Float]
"""Frequency, speed, force, response and sigma of readings."""
_Readings = dict[tuple[str, Order], _Columns]
"""Those of each kind of line."""


def _readings(problem: Problem) -> _Readings:
    """Readings of all blocks by kind of line."""
    kinds: dict[tuple[str, Order], list[ComplexArray]] = {}
    for block in problem.blocks:
        if isinstance(block, LineResponses):
            parts = (block.frequency, block.speed, block.force, block.measured, block.sigma)
            for direction, order, rows in block.kinds:
                kinds.setdefault((direction, order), []).append(np.array([part[rows] for part in parts], dtype=complex))
    tables = {kind: np.concatenate(own, axis=1) for kind, own in kinds.items()}
    return {kind: (w.real, Om.real, force, z, sigma.real) for kind, (w, Om, force, z, sigma) in tables.items()}


def _kappa(values: dict[str, float], w: Float) -> ComplexArray:
    return np.asarray(values["K"] + 1j * w * values["D"] - values["M"] * w**2)


def _delta(values: dict[str, float]) -> complex:
    return complex(values["dK_cos"], values["dK_sin"])


def _round_part(readings: _Readings, values: dict[str, float]) -> dict[str, float]:
    """K, D and M of ``kappa(w) A = F``, the image's share in it left out."""
    found = readings.get(("z", (1, 0)))
    if found is None or found[0].size < 2:
        return {}
    w, _, force, response, sigma = found
    weight = 1 / sigma
    K = D = M = 0.0
    for _ in range(_REWEIGHTINGS):
        columns = np.array([response, 1j * w * response, -(w**2) * response]) * weight
        K, D, M = least_squares(columns.T, force * weight, real=True).tolist()
        weight = 1 / (sigma * np.abs(K + 1j * w * D - M * w**2))
    return {"K": K, "D": D, "M": abs(M)}


def _start_up(readings: _Readings, values: dict[str, float]) -> dict[str, float]:
    """The shaft from 1x and 2x over many speeds, in proportion to its mass, the sag taken for constant."""
    once, twice = readings.get(("z", (0, 0))), readings.get(("z", (0, 1)))
    fewest_speeds = 8  # speeds of a start-up from which its lines are solved for the whole shaft
    if once is None or twice is None or min(np.unique(once[1]).size, np.unique(twice[1]).size) < fewest_speeds:
        return {}
    w = np.concatenate([once[1], 2 * twice[1]])
    first = np.arange(w.size) < once[1].size
    U, sigma = (np.concatenate([once[i], twice[i]]) for i in (3, 4))
    partner = np.where(first, U.conj(), 0.0)
    try:
        found, R1, R2 = shaft_of_lines(w, first, U, partner, sigma, runout="R1c" in values)
    except ValueError:  # noise; the start need not be good
        return {}
    M, delta, load, eps = values["M"], found.delta, found.side, found.eps
    scaled = {"K": found.k, "D": found.d, "dK_cos": delta.real, "dK_sin": delta.imag, "Px": load.real, "Py": load.imag}
    lengths = {"ec": eps.real, "es": eps.imag}
    lengths |= {"R1c": R1.real, "R1s": R1.imag, "R2c": R2.real, "R2s": R2.imag} if "R1c" in values else {}
    return {name: M * v for name, v in scaled.items()} | lengths


def _image(readings: _Readings, values: dict[str, float]) -> dict[str, float]:
    """``kappa(2 Om - w) B + delta conj(A) = 0``."""
    found = readings.get(("z", (-1, 0)))
    if found is None:
        return {}
    w, speed, force, response, sigma = found
    share = -(force / _kappa(values, w)).conj() / _kappa(values, 2 * speed - w) / sigma
    c, s = least_squares(np.array([share, 1j * share]).T, response / sigma, real=True).tolist()
    return {"dK_cos": c, "dK_sin": s}


def _steady(readings: _Readings, values: dict[str, float]) -> dict[str, float]:
    """Parameters from 1x and 2x: over a start-up the whole shaft; at a few speeds the eccentricity, ``kappa(Om) U +
    delta conj(U) = M eps Om^2``, and the side load, ``P = K S + delta conj(S2)``, of the sag itself, or of that in
    ``kappa(2 Om) S2 + delta conj(S) = 0``."""
    found = _start_up(readings, values)
    if found:
        return found
    once, sag, twice = (readings.get(("z", (0, n))) for n in (0, -1, 1))
    delta = _delta(values)
    if once is not None:
        _, speed, _, U, _ = once
        eps = np.mean((_kappa(values, speed) * U + delta * U.conj()) / (values["M"] * speed**2))
        found = {"ec": float(eps.real), "es": float(eps.imag)}
    if sag is not None:
        load = values["K"] * np.mean(sag[3])
    elif twice is not None and delta:
        S = (-_kappa(values, 2 * twice[1]) * twice[3] / delta).conj()
        load = np.mean(values["K"] * S + delta * twice[3].conj())
    else:
        return found
    return found | {"Px": float(load.real), "Py": float(load.imag)}


def _torsion(readings: _Readings, values: dict[str, float]) -> dict[str, float]:
    """``(nu_t^2 - nu^2 + 2j zeta_t nu_t nu) Phi = T/J``, the torque of each kind of line known but for a factor. At w -
    Om the torque is that of the unbalance, ``-j M w^2 A conj(eps)``; at w - 2 Om that of the sag S, ``2j conj(delta) A
    S``; at 2(w - Om) it is ``j conj(delta) A^2``, free of both, and tells J."""
    delta = _delta(values)
    shapes: list[tuple[Float, ComplexArray, Float, ComplexArray, int]] = []
    for place, order in enumerate([(1, 0), (1, -1), (2, 0)]):
        found = readings.get(("twist", order))
        if found is None or (place and not delta):
            continue
        w, speed, force, response, sigma = found
        A = force / _kappa(values, w)
        torque = (-1j * values["M"] * w**2 * A, 2j * delta.conjugate() * A, 1j * delta.conjugate() * A**2)[place]
        shapes.append((order[0] * (w - speed) + order[1] * speed, response, sigma, torque, place))
    if not shapes:
        return {}
    nu = np.concatenate([shape[0] for shape in shapes])
    response, sigma = (np.concatenate([shape[i] for shape in shapes]) for i in (1, 2))
    columns = [response, 1j * nu * response]
    for i in range(len(shapes)):
        own = np.concatenate([other[3] if i == k else 0 * other[3] for k, other in enumerate(shapes)])
        columns += [-own, -1j * own]
    weight = 1 / (sigma * np.abs(nu) ** 2)
    square, damping, *factors = (0.0, 0.0)
    for _ in range(_REWEIGHTINGS):
        equations = (np.array(columns) * weight).T
        square, damping, *factors = least_squares(equations, nu**2 * response * weight, real=True).tolist()
        weight = 1 / (sigma * np.abs(square - nu**2 + 1j * nu * damping))
    pairs = {shape[4]: complex(*factors[2 * i : 2 * i + 2]) for i, shape in enumerate(shapes)}
    return _of_twist(values, max(square, 1.0), abs(damping), pairs)


def _of_twist(values: dict[str, float], square: float, damping: float, factors: dict[int, complex]) -> dict[str, float]:
    """Parameters of ``nu_t^2``, ``2 zeta_t nu_t`` and conj(eps)/J, S/J and 1/J, as far as they were found."""
    eps, load = complex(values["ec"], values["es"]), complex(values["Px"], values["Py"])
    J = values["J"]
    if 2 in factors and factors[2].real > 0:
        J = 1 / factors[2].real
    elif 0 in factors and eps and factors[0]:
        J = abs(eps / factors[0])
    nu = float(np.sqrt(square))
    found = {"J": J, "nu_t": nu, "zeta_t": damping / (2 * nu), "kt": J * square, "ct": J * damping}
    if 0 in factors and not eps:
        eps = (factors[0] * J).conjugate()
        found |= {"ec": eps.real, "es": eps.imag}
    if 1 in factors and not load:
        load = factors[1] * J * values["K"]
        found |= {"Px": load.real, "Py": load.imag}
    return {name: value for name, value in found.items() if name in values}
