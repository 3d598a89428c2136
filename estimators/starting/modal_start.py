"""Modes from responses in closed form: poles by a rational fit, shapes by singular values.

Responses of many lines have their poles by vector fitting (:func:`common_poles`), more of them than the model has
modes: those are taken that explain the responses best, so that modes beside those of the model spoil no start. Few
lines, as of weights at some speeds, are fitted with as few numbers as a model of so many modes has: with the
denominator ``d(s) = s^2n + a_(2n-1) s^(2n-1) + ... + a_0`` common to all responses and real coefficients,
``d(s) H_pr(s)`` is a polynomial with complex coefficients for each probe p and force plane r: linear least squares,
with the last denominator as weight (Sanathanan and Koerner). The residue of each pair of poles is a matrix of rank one,
gain times participation over modal mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.significance import P_FALSE_ALARM
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.signals.ratios import best_ratio
from rotorfit.models import Modal

_DAMPING = (1e-3, 0.5)
"""Damping ratios that a start may have."""


class PolesOfOrder(NamedTuple):
    """Poles that responses have in common when so many pairs are looked for."""

    order: int  # pairs of poles
    frequency: Float  # natural frequencies, rad/s, ascending
    damping: Float  # damping ratios
    stable: Bool  # whether the order before had each pole too, in frequency and in damping


class Response(NamedTuple):
    """Readings of the response of one probe to a unit force at one plane, along one axis."""

    frequency: Float  # signed where forward and backward are apart, rad/s, shape ``(L,)``
    value: ComplexArray  # m/N, shape ``(L,)``
    weight: Float  # one over the standard deviation of each, shape ``(L,)``
    probe: int = 0  # number of its plane
    plane: int = 0  # number of the plane of the force


def modal_start(
    model: Modal, blocks: Sequence[Responses], *, turned: bool = False, unknown: bool = True
) -> tuple[dict[str, float], float]:
    """Parameters of a modal model, and the common datum angle, rad, from responses. Returns values by name, and the
    lead of the responses over the forces at the first plane. Modal masses are as if the responses were turned back by
    that angle (``turned``), or as they are."""
    forced, probe = (model.planes.index(name) for name in model.normalised_at)
    along = _responses(model, blocks)
    every = [response for own in along.values() for response in own]
    values: dict[str, float] = {}
    unit: ComplexArray | None = None  # exp(j datum) / M of each mode
    datum = 0.0
    for axis, responses in along.items():
        end = axis if model.apart else ""
        wn, zeta, shown = _poles(responses if model.apart else every, model.modes, rests=model.residuals is True)
        if unknown and shown < model.modes:
            raise ValueError(
                f"the responses show {shown} of {model.modes} modes: what one more explains is noise. Fit with "
                f"modes={shown} (--modes {shown}), or say which natural frequencies are known"
            )
        parts, rests = _residues(responses, wn, zeta, len(model.planes), rests=model.residuals is True)
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
        for letter, rest in zip("ca", rests, strict=False):
            for (at, force), value in np.ndenumerate(np.exp(-1j * datum) * rest if turned else rest):
                values |= _pair(model.rest(letter, model.planes[at], axis, model.planes[force]), complex(value))
    return {name: values[name] for name in model.parameter_names if name in values}, datum


def stabilisation(model: Modal, blocks: Sequence[Responses], most: int) -> list[PolesOfOrder]:
    """Poles of rising order: those of modes stay where they are, those of noise do not."""
    responses = [response for own in _responses(model, blocks).values() for response in own]
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


def _name(name: str, axis: str) -> str:
    return f"{name}_{axis}" if axis else name


def _pair(name: str, value: complex) -> dict[str, float]:
    return {name: value.real, f"{name}_im": value.imag}


def _responses(model: Modal, blocks: Sequence[Responses]) -> dict[str, list[Response]]:
    """Responses of each axis that has any: x, y or (combined) z."""
    found: dict[str, list[Response]] = {}
    for axis in ("x", "y") if model.frame == "xy" else ("z",):
        at = [model.coordinate(plane, axis) for plane in model.planes]
        parts = []
        for block in blocks:
            force = block.force[:, at]
            plane = np.argmax(np.abs(force), axis=1)
            strength = force[np.arange(plane.size), plane][block.line]
            alone = (np.count_nonzero(force, axis=1) == 1)[block.line]
            keep = np.isin(block.coordinate, at) & (strength != 0) & alone
            line, drive = block.line[keep], strength[keep]
            w = block.frequency[line] if axis == "z" else np.abs(block.frequency[line])
            probe = np.array([at.index(place) for place in block.coordinate[keep].tolist()], dtype=np.intp)
            pair = probe * len(at) + plane[line]
            parts.append((w, block.measured[keep] / drive, np.abs(drive) / block.sigma[keep], pair))
        *columns, pair = (np.concatenate(column) for column in zip(*parts, strict=True))
        for one in np.unique(pair).tolist():
            own = (column[pair == one] for column in columns)
            found.setdefault(axis, []).append(Response(*own, *divmod(one, len(at))))
    return found


def _poles(responses: Sequence[Response], modes: int, *, rests: bool) -> tuple[Float, Float, int]:
    """Natural frequencies, rad/s, ascending, damping ratios, and how many modes explain more than noise would; beside
    ``rests``, terms of modes outside the band."""
    from scipy.special import chdtri  # late: loading it takes longer than a fit

    count = sum(one.value.size for one in responses)
    enough = 1.2  # mean square of what is left over the noise, from which more poles would explain noise
    # Sum of squares over the noise that a pole at any of so many lines explains of noise, but once in many tests.
    most = float(chdtri(2 * len(responses) + 2, P_FALSE_ALARM / count))
    tried = [(np.full(1, np.inf), np.zeros(0), np.zeros(0))]
    least = np.full(modes, np.inf)  # misfit of one pole, two, ..., whatever else was looked for
    shown = modes
    for more in (0, 2, 4):  # poles beside those of the model, for modes that it does not have and for noise
        unknown = 2 * (modes + more) + 1  # of each response beside the poles
        if min(one.value.size for one in responses) < 4 * unknown:
            continue
        misfit, wn, zeta = _best_of(common_poles(responses, modes + more), responses, modes, rests=rests)
        tried.append((misfit, wn, zeta))
        least[: misfit.size] = np.minimum(least[: misfit.size], misfit)
        found = least[np.isfinite(least)]
        noise = max(1.0, float(least.min()) / (2 * count))
        shown = int(np.flatnonzero(-np.diff(found, prepend=np.inf) > most * noise)[-1]) + 1 if found.size else modes
        if misfit[-1] < enough * 2 * count and shown == modes:
            break
    misfit, wn, zeta = min(tried, key=lambda one: float(one[0][-1]))
    if wn.size != modes:
        return *_few_lines(responses, modes), modes
    return wn, np.clip(zeta, *_DAMPING), shown


def _best_of(
    poles: ComplexArray, responses: Sequence[Response], modes: int, *, rests: bool
) -> tuple[Float, Float, Float]:
    """Misfits of one pole, two, ..., frequencies and damping ratios of those that explain most, one by one: each time
    that which lowers the sum of squares most beside those that were taken."""
    wn, zeta = np.abs(poles), -poles.real / np.abs(poles)
    parts = [_products(one, wn, zeta, rests=rests) for one in responses]
    products, along = (np.array(some) for some in zip(*parts, strict=True))
    left = float(sum(np.sum(np.abs(one.value * one.weight) ** 2) for one in responses))
    size = np.einsum("ckk->ck", products).real.copy()
    chosen: list[int] = []
    misfit: list[float] = []
    waiting = list(range(2)) if rests else []
    for _ in range(len(waiting) + min(modes, wn.size)):
        power = np.einsum("ckk->ck", products).real
        new = power > 1e-10 * size  # the rest is a combination of what was taken
        gain = np.divide(np.abs(along) ** 2, power, out=np.zeros_like(power), where=new).sum(axis=0)
        best = waiting.pop(0) if waiting else _first_best(gain, chosen, 2 * rests)
        left -= float(gain[best])
        factor = np.divide(1.0, power[:, best], out=np.zeros(len(power)), where=new[:, best])
        column = products[:, :, best] * factor[:, None]
        along = along - column * along[:, best, None]
        products = products - column[:, :, None] * products[:, best, None, :]
        if best >= 2 * rests:
            chosen = sorted([*chosen, best - 2 * rests])
            misfit.append(max(left, 0.0))
    return np.array(misfit or [np.inf]), wn[chosen], zeta[chosen]


def _first_best(gain: Float, chosen: Sequence[int], first: int) -> int:
    """The pole of most gain among those not chosen."""
    gain = gain.copy()
    gain[:first] = -np.inf
    gain[[first + one for one in chosen]] = -np.inf
    return int(np.argmax(gain))


def _columns(one: Response, wn: Float, zeta: Float, *, rests: bool) -> ComplexArray:
    """Terms of a response, weighed: of modes outside the band where these are asked for, then of each mode."""
    w = one.frequency[:, None]
    modes = 1 / (wn**2 - w**2 + 2j * zeta * wn * w)
    outside = [np.ones_like(w), -np.divide(1.0, w**2, out=np.zeros_like(w), where=w != 0)] if rests else []
    return np.asarray(np.hstack([*outside, modes]) * one.weight[:, None], dtype=complex)


def _products(one: Response, wn: Float, zeta: Float, *, rests: bool) -> tuple[ComplexArray, ComplexArray]:
    """Products of the terms of a response with each other and with its readings."""
    basis = _columns(one, wn, zeta, rests=rests)
    return basis.conj().T @ basis, basis.conj().T @ (one.value * one.weight)


def _few_lines(responses: Sequence[Response], modes: int) -> tuple[Float, Float]:
    """The same by a rational fit of as many numbers as so many modes have."""
    frequency, value, weight = (np.concatenate([one[i] for one in responses]) for i in range(3))
    top = float(np.abs(frequency).max())
    own = np.repeat(np.eye(len(responses), dtype=complex), [one.value.size for one in responses], axis=0)
    powers = np.asarray((1j * frequency[:, None] / top) ** np.arange(2 * modes + 1), dtype=complex)
    numerator = (own[:, :, None] * powers[:, None, : 2 * modes - 1]).reshape(value.size, -1)
    denominator, _, _ = best_ratio(value, 1 / weight, powers, numerator, real=True)
    roots = np.roots(denominator[::-1])
    roots = roots[roots.imag > 1e-6]
    roots = roots[np.argsort(np.abs(roots))][:modes]
    beyond = 1.5  # where a mode that the data do not show is put, over the highest frequency
    missing = beyond ** np.arange(1, modes - roots.size + 1)
    wn = np.concatenate([np.abs(roots), missing * max(1.0, np.abs(roots).max(initial=0.0))])
    zeta = np.concatenate([-roots.real / np.maximum(np.abs(roots), 1e-12), np.full(missing.size, 0.02)])
    order = np.argsort(wn)
    return wn[order] * top, np.clip(zeta[order], *_DAMPING)


def _residues(
    responses: Sequence[Response], wn: Float, zeta: Float, planes: int, *, rests: bool
) -> tuple[ComplexArray, ComplexArray]:
    """Strength of each mode between force and probe planes, 1/kg, shape ``(modes, planes, planes)``, and of terms of
    modes outside the band, above and below it; zero where unseen.
    ``H_pr = sum_i R_ipr / (wn_i^2 - w^2 + 2 j zeta_i wn_i w) + c_pr - a_pr / w^2``."""
    found = np.zeros((2 * rests + wn.size, planes, planes), dtype=complex)
    for one in responses:
        basis = _columns(one, wn, zeta, rests=rests)
        found[:, one.probe, one.plane] = np.linalg.lstsq(basis, one.value * one.weight, rcond=1e-10)[0]
    return found[2 * rests :], found[: 2 * rests]


def common_poles(responses: Sequence[Response], pairs: int) -> ComplexArray:
    """Stable poles with positive imaginary part common to all responses, rad/s, ascending; none that become real. By
    relaxed vector fitting (Gustavsen and Semlyen 1999, Gustavsen 2006): each response times a scalar function sigma(s)
    is a sum over trial poles, and so is sigma, whose zeros are the next trial poles. Partial fractions stay well
    conditioned where polynomials in s do not. (SciPy's AAA takes one response without noise.)"""
    top = max(float(np.abs(one.frequency).max()) for one in responses)
    low = min(float(np.abs(one.frequency).min()) for one in responses) / top
    damping = 0.01  # of the trial poles at the beginning: between lightly and well damped
    at = np.linspace(max(low, 0.5 / pairs), 1.0, pairs + 2)[1:-1] if pairs > 1 else np.array([np.sqrt(max(low, 0.1))])
    poles = np.asarray(at * (1j - damping), dtype=complex)
    real: Float = np.zeros(0)
    for _ in range(12):
        before = poles
        poles, real = _relocated(responses, top, poles, real)
        if poles.size == before.size and np.abs(poles - before).max(initial=0.0) < 1e-6:
            break
    return np.asarray(poles * top, dtype=complex)


def _relocated(
    responses: Sequence[Response], top: float, poles: ComplexArray, real: Float
) -> tuple[ComplexArray, Float]:
    """Zeros of sigma, turned to the stable side: those with positive imaginary part, and real ones. What belongs to one
    response alone is eliminated by a QR factorisation of its own equations (Deschrijver et al. 2008)."""
    every = np.concatenate([poles, poles.conj(), real])
    rows: list[Float] = []
    total: ComplexArray = np.zeros(2 * poles.size + real.size + 1, dtype=complex)
    bases: dict[bytes, tuple[ComplexArray, ComplexArray]] = {}  # of responses at the same lines with like weights
    for one in responses:
        shape = one.weight / (one.weight.max() or 1.0)
        key = one.frequency.tobytes() + shape.tobytes()
        if key not in bases:
            s = np.asarray(1j * one.frequency / top)
            own = np.hstack([1 / (s[:, None] - every), np.ones((s.size, 1))]) * shape[:, None]
            bases[key] = _basis(s, poles, real), np.linalg.qr(own)[0]
        sigma, left = bases[key]
        value = one.value * one.weight
        size = np.sqrt(np.mean(np.abs(value) ** 2)) or 1.0
        A = sigma * (value / -size)[:, None]
        A -= left @ (left.conj().T @ A)
        rows.append(np.asarray(np.linalg.qr(np.concatenate([A.real, A.imag]), mode="r")))
        total = total + sigma.sum(axis=0)
    strength = float(np.sqrt(sum(np.sum(row**2) for row in rows)))
    mean = total.real / sum(one.frequency.size for one in responses)
    relaxed = mean[None, :] * strength  # sigma is one on average, which keeps noise from pulling it to zero
    A, b = np.concatenate([*rows, relaxed]), np.zeros(sum(map(len, rows)) + 1)
    b[-1] = strength
    columns = np.linalg.norm(A, axis=0)
    columns = np.where(columns > 0, columns, 1.0)
    c = np.linalg.lstsq(A / columns, b, rcond=1e-12)[0] / columns
    least = 1e-8  # constant of sigma below which dividing by it says nothing
    zeros = np.linalg.eigvals(_state_matrix(poles, real, c[:-1] / (c[-1] if abs(c[-1]) > least else least)))
    zeros = np.where(zeros.real > 0, -zeros.conj(), zeros)
    straight = np.abs(zeros.imag) <= 1e-9 * np.abs(zeros)
    found = zeros[(zeros.imag > 0) & ~straight]
    return found[np.argsort(np.abs(found))], zeros[straight].real


def _basis(s: ComplexArray, poles: ComplexArray, real: Float) -> ComplexArray:
    """Terms of sigma with real coefficients: two for a pair of poles, one for a real pole, and a constant."""
    ahead, behind = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    single = 1 / (s[:, None] - real)
    return np.hstack([ahead + behind, 1j * (ahead - behind), single, np.ones((s.size, 1))])


def _state_matrix(poles: ComplexArray, real: Float, c: Float) -> Float:
    """Matrix whose eigenvalues are the zeros of ``1 + sum c_i basis_i``."""
    n, size = poles.size, 2 * poles.size + real.size
    A, b = np.zeros((size, size)), np.zeros(size)
    first, second = np.arange(n), np.arange(n, 2 * n)
    A[first, first] = A[second, second] = poles.real
    A[first, second], A[second, first] = poles.imag, -poles.imag
    b[first] = 2.0
    A[np.arange(2 * n, size), np.arange(2 * n, size)], b[2 * n :] = real, 1.0
    return A - np.outer(b, c)
