"""Modes from responses in closed form: poles by a rational fit, shapes by singular values.

Responses of many lines have their poles by vector fitting (``vector_fitting.py``), more of them than the model has
modes: those are taken that explain the responses best, so that modes beside those of the model spoil no start. Few
lines, as of weights at some speeds, are fitted with as few numbers as a model of so many modes has: with the
denominator ``d(s) = s^2n + a_(2n-1) s^(2n-1) + ... + a_0`` common to all responses and real coefficients,
``d(s) H_pr(s)`` is a polynomial with complex coefficients for each probe p and force plane r: linear least squares,
with the last denominator as weight (Sanathanan and Koerner). The residue of each pair of poles is a matrix of rank one,
gain times participation over modal mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.signals.ratios import best_ratio
from rotorfit.estimators.significance import P_FALSE_ALARM
from rotorfit.estimators.starting.vector_fitting import Response, common_poles
from rotorfit.models import Modal
from rotorfit.models.array_types import Bool, ComplexArray, Float, Index

_DAMPING = (1e-3, 0.5)
"""Damping ratios that a start may have."""


class PolesOfOrder(NamedTuple):
    """Poles that responses have in common when so many pairs are looked for."""

    order: int  # pairs of poles
    frequency: Float  # natural frequencies, rad/s, ascending
    damping: Float  # damping ratios
    stable: Bool  # whether the order before had each pole too, in frequency and in damping


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """Responses per unit force along one axis, one entry a reading."""

    frequency: Float  # signed where forward and backward are apart, rad/s, shape ``(R,)``
    value: ComplexArray  # response over force, m/N, shape ``(R,)``
    weight: Float  # one over its standard deviation, shape ``(R,)``
    probe: Index  # number of the plane of each probe, shape ``(R,)``
    plane: Index  # number of the plane of each force, shape ``(R,)``


def modal_start(
    model: Modal, blocks: Sequence[Responses], *, turned: bool = False, unknown: bool = True
) -> tuple[dict[str, float], float]:
    """Parameters of a modal model, and the common datum angle, rad, from responses. Returns values by name, and the
    lead of the responses over the forces at the first plane. Modal masses are as if the responses were turned back by
    that angle (``turned``), or as they are."""
    forced, probe = (model.planes.index(names[0]) for names in (model.force_planes, model.probe_planes))
    axes = ("x", "y") if model.frame == "xy" else ("z",)
    along = {axis: lines for axis in axes if (lines := _lines_along(model, blocks, axis)).value.size}
    every = _joined(along, len(model.planes))
    values: dict[str, float] = {}
    unit: ComplexArray | None = None  # exp(j datum) / M of each mode
    datum = 0.0
    for axis, lines in along.items():
        end = axis if model.apart else ""
        own = lines if model.apart else every
        wn, zeta, shown = _poles(own, model.modes)
        if unknown and shown < model.modes:
            raise ValueError(
                f"the responses show {shown} of {model.modes} modes: what one more explains is noise. Fit with "
                f"modes={shown} (--modes {shown}), or say which natural frequencies are known"
            )
        parts = _residues(lines, wn, zeta, len(model.planes))
        if unit is None:
            unit = np.where(parts[:, probe, forced] == 0, np.abs(parts).max(axis=(1, 2)), parts[:, probe, forced])
        datum = float(np.angle(unit[0]))
        sign = np.sign((unit * np.exp(-1j * datum) if turned else unit).real)
        for i, part in enumerate(parts):
            tag = str(i + 1) if model.modes > 1 else ""
            values |= {_name(f"wn{tag}", end): float(wn[i]), _name(f"zeta{tag}", end): float(zeta[i])}
            values.setdefault(f"M{tag}", float((1.0 if forced == probe else sign[i]) / np.abs(unit[i])))
            shape = np.linalg.svd(part)[2][0]  # participations up to a factor
            shape = shape / (shape[forced] if shape[forced] else 1.0)
            gain = part @ shape.conj() / np.vdot(shape, shape).real / unit[i]
            for place, plane in enumerate(model.planes):
                values |= _pair(f"phi{tag}_{plane}", complex(shape[place]))
                values |= _pair(_name(f"g{tag}_{plane}", axis.strip("z")), complex(gain[place]))
    return {name: values[name] for name in model.parameter_names if name in values}, datum


def stabilisation(model: Modal, blocks: Sequence[Responses], most: int) -> list[PolesOfOrder]:
    """Poles of rising order: those of modes stay where they are, those of noise do not."""
    axes = ("x", "y") if model.frame == "xy" else ("z",)
    along = {axis: lines for axis in axes if (lines := _lines_along(model, blocks, axis)).value.size}
    responses = _responses(_joined(along, len(model.planes)))
    same_frequency, same_damping = 0.01, 0.05  # changes from order to order of a stable pole, as usual
    found: list[PolesOfOrder] = []
    for order in range(1, most + 1):
        if min(one.value.size for one in responses) < 2 * (2 * order + 1):
            break
        poles = common_poles(responses, order)
        wn, zeta = np.abs(poles), -poles.real / np.abs(poles)
        stable: Bool = np.zeros(wn.size, dtype=bool)
        if found:
            change = np.abs(wn[:, None] - found[-1].frequency) / wn[:, None]
            damping = np.abs(zeta[:, None] - found[-1].damping) / np.maximum(np.abs(zeta[:, None]), 1e-12)
            stable = np.asarray(((change < same_frequency) & (damping < same_damping)).any(axis=1))
        found.append(PolesOfOrder(order, wn, zeta, stable))
    return found


def _joined(along: dict[str, Lines], planes: int) -> Lines:
    """Readings of all axes together, the probes of each axis numbered after those of the last."""
    parts = [replace(lines, probe=lines.probe + planes * i) for i, lines in enumerate(along.values())]
    return Lines(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Lines)})


def _name(name: str, axis: str) -> str:
    return f"{name}_{axis}" if axis else name


def _pair(name: str, value: complex) -> dict[str, float]:
    return {name: value.real, f"{name}_im": value.imag}


def _lines_along(model: Modal, blocks: Sequence[Responses], axis: str) -> Lines:
    """Responses of the planes' probes along an axis, x, y or (combined) z, to a unit force along it."""
    at = [model.coordinate(plane, axis) for plane in model.planes]
    parts = []
    for block in blocks:
        force = block.force[:, at]
        plane = np.argmax(np.abs(force), axis=1)
        strength = force[np.arange(plane.size), plane][block.line]
        keep = np.isin(block.coordinate, at) & (strength != 0) & (np.count_nonzero(force, axis=1) == 1)[block.line]
        line, drive = block.line[keep], strength[keep]
        w = block.frequency[line] if axis == "z" else np.abs(block.frequency[line])
        probe = np.array([at.index(place) for place in block.coordinate[keep].tolist()], dtype=np.intp)
        parts.append((w, block.measured[keep] / drive, np.abs(drive) / block.sigma[keep], probe, plane[line]))
    frequency, value, weight, probe, plane = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Lines(frequency=frequency, value=value, weight=weight, probe=probe, plane=plane)


def _poles(lines: Lines, modes: int) -> tuple[Float, Float, int]:
    """Natural frequencies, rad/s, ascending, damping ratios, and how many modes explain more than noise would."""
    responses = _responses(lines)
    enough = 1.2  # mean square of what is left over the noise, from which more poles would explain noise
    most = _explained_by_chance(len(responses), lines.value.size)
    tried = [(np.full(1, np.inf), np.zeros(0), np.zeros(0))]
    least = np.full(modes, np.inf)  # misfit of one pole, two, ..., whatever else was looked for
    shown = modes
    for more in (0, 2, 4):  # poles beside those of the model, for modes that it does not have and for noise
        unknown = 2 * (modes + more) + 1  # of each response beside the poles
        if min(one.value.size for one in responses) < 4 * unknown:
            continue
        misfit, wn, zeta = _best_of(common_poles(responses, modes + more), responses, modes)
        tried.append((misfit, wn, zeta))
        least[: misfit.size] = np.minimum(least[: misfit.size], misfit)
        found = least[np.isfinite(least)]
        noise = max(1.0, float(least.min()) / (2 * lines.value.size))
        shown = int(np.flatnonzero(-np.diff(found, prepend=np.inf) > most * noise)[-1]) + 1 if found.size else modes
        if misfit[-1] < enough * 2 * lines.value.size and shown == modes:
            break
    misfit, wn, zeta = min(tried, key=lambda one: float(one[0][-1]))
    if wn.size != modes:
        return *_few_lines(lines, modes), modes
    return wn, np.clip(zeta, *_DAMPING), shown


def _explained_by_chance(responses: int, lines: int) -> float:
    """Sum of squares over the noise that a pole at any of so many lines explains of noise, but once in many tests."""
    from scipy.special import chdtri  # late: loading it takes longer than a fit

    return float(chdtri(2 * responses + 2, P_FALSE_ALARM / lines))


def _responses(lines: Lines) -> list[Response]:
    """The response of each pair of a probe and a force plane."""
    pair = lines.probe * (lines.plane.max() + 1) + lines.plane
    rows = [np.flatnonzero(pair == one) for one in np.unique(pair)]
    return [Response(lines.frequency[mine], lines.value[mine], lines.weight[mine]) for mine in rows]


def _best_of(poles: ComplexArray, responses: Sequence[Response], modes: int) -> tuple[Float, Float, Float]:
    """Misfits of one pole, two, ..., frequencies and damping ratios of those that explain most, one by one."""
    wn, zeta = np.abs(poles), -poles.real / np.abs(poles)
    basis = [
        np.asarray(one.weight[:, None] / (wn**2 - w**2 + 2j * zeta * wn * w), dtype=complex)
        for one in responses
        for w in (one.frequency[:, None],)
    ]
    given = [one.value * one.weight for one in responses]
    chosen: list[int] = []
    misfit: list[float] = []
    for _ in range(min(modes, wn.size)):
        left = {
            one: sum(_left(B[:, [*chosen, one]], z) for B, z in zip(basis, given, strict=True))
            for one in range(wn.size)
            if one not in chosen
        }
        best = min(left, key=left.__getitem__)
        chosen = sorted([*chosen, best])
        misfit.append(left[best])
    return np.array(misfit or [np.inf]), wn[chosen], zeta[chosen]


def _left(basis: ComplexArray, given: ComplexArray) -> float:
    """Sum of squares that a linear combination leaves."""
    along = np.linalg.qr(basis)[0].conj().T @ given
    return float(np.vdot(given, given).real - np.vdot(along, along).real)


def _few_lines(lines: Lines, modes: int) -> tuple[Float, Float]:
    """The same by a rational fit of as many numbers as so many modes have."""
    top = float(np.abs(lines.frequency).max())
    s = 1j * lines.frequency / top
    pairs, pair = np.unique(lines.probe * (lines.plane.max() + 1) + lines.plane, return_inverse=True)
    own = np.zeros((s.size, pairs.size), dtype=complex)
    own[np.arange(s.size), pair.reshape(-1)] = 1.0
    powers = np.asarray(s[:, None] ** np.arange(2 * modes + 1), dtype=complex)
    numerator = (own[:, :, None] * powers[:, None, : 2 * modes - 1]).reshape(s.size, -1)
    denominator, _, _ = best_ratio(lines.value, 1 / lines.weight, powers, numerator, real=True)
    roots = np.roots(denominator[::-1])
    roots = roots[roots.imag > 1e-6]
    roots = roots[np.argsort(np.abs(roots))][:modes]
    beyond = 1.5  # where a mode that the data do not show is put, over the highest frequency
    missing = beyond ** np.arange(1, modes - roots.size + 1)
    wn = np.concatenate([np.abs(roots), missing * max(1.0, np.abs(roots).max(initial=0.0))])
    zeta = np.concatenate([-roots.real / np.maximum(np.abs(roots), 1e-12), np.full(missing.size, 0.02)])
    order = np.argsort(wn)
    return wn[order] * top, np.clip(zeta[order], *_DAMPING)


def _residues(lines: Lines, wn: Float, zeta: Float, planes: int) -> ComplexArray:
    """Strength of each mode between force and probe planes, 1/kg, shape ``(modes, planes, planes)``; zero where unseen.
    ``H_pr = sum_i R_ipr / (wn_i^2 - w^2 + 2 j zeta_i wn_i w)``."""
    w = lines.frequency[:, None]
    basis = 1 / (wn**2 - w**2 + 2j * zeta * wn * w) * lines.weight[:, None]
    found = np.zeros((wn.size, planes, planes), dtype=complex)
    for p in range(planes):
        for r in range(planes):
            mine = (lines.probe == p) & (lines.plane == r)
            if mine.any():
                found[:, p, r] = np.linalg.lstsq(basis[mine], (lines.value * lines.weight)[mine], rcond=1e-10)[0]
    return found
