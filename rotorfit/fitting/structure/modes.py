"""Modes of a fitted rotor with their errors, and half-power bandwidths of the data beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.fitting.quantities import Quantity
from rotorfit.fitting.structure.mode_table import Mode, Modes
from rotorfit.models import eigenvalues
from rotorfit.models.array_types import Float
from rotorfit.models.motion.modes import VibrationMode, vibration_modes
from rotorfit.models.motion.stability import eigenvalue_gradient, is_image, whirls_forward
from rotorfit.models.parameters import unknown_name
from rotorfit.models.shafts.angular_rates import angular_rate

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult


def natural_frequencies(fit: FitResult, speed: float, at: Mapping[str, Any] | None) -> list[tuple[Quantity, Quantity]]:
    """Damped natural frequency (rad/s, signed) and damping ratio of each mode; see the result's method."""
    speed = angular_rate(speed)
    theta, model = fit.theta(at), fit.model
    modes = []
    back = 1j * speed if model.turns else 0.0  # from turning coordinates
    for found in eigenvalues(model, theta, speed).tolist():
        if not np.isfinite(found) or abs(found) > fit.stability_band or is_image(model, theta, speed, found):
            continue
        _, by_theta = eigenvalue_gradient(model, theta, speed, found)
        s = found + back
        size = abs(s)
        # zeta = -Re s / |s|
        slope = -by_theta.real / size + s.real * (s.real * by_theta.real + s.imag * by_theta.imag) / size**3
        turn = -1.0 if model.frame == "xy" and not whirls_forward(model, theta, speed, np.array([found]))[0] else 1.0
        frequency = fit.propagate(turn * s.imag, turn * by_theta.imag, "rad/s", at)
        modes.append((frequency, fit.propagate(-s.real / size, slope, "1", at)))
    return modes


def modes_of(fit: FitResult, speed: float, normalise: str | None, at: Mapping[str, Any] | None) -> Modes:
    """See :meth:`FitResult.modes`."""
    speed, theta, model = angular_rate(speed), fit.theta(at), fit.model
    names = [c.plane if c.axis == "z" else f"{c.plane}.{c.axis}" for c in model.coordinates]
    if normalise is not None and normalise not in names:
        raise KeyError(unknown_name("plane of the rotor", normalise, names))
    place = names.index(normalise) if normalise is not None else 0
    found = vibration_modes(model, theta, speed, normalised_at=place)
    slopes = _slopes(fit, theta, speed, place, found)
    curves = list(_measured(fit))
    back = speed if model.turns else 0.0  # from turning coordinates
    kept = [k for k, mode in enumerate(found) if abs(mode.s) <= fit.stability_band]
    modes = []
    for k in kept:
        values, slope = _numbers(found[k]).tolist(), slopes[k]
        units = ("rad/s", "1", "kg", "N/m", "N s/m")
        own = [fit.propagate(v, s, u, at) for v, s, u in zip(values[:5], slope[:5], units, strict=True)]
        n = len(names)
        sizes = [fit.propagate(v, s, "1", at) for v, s in zip(values[5 : 5 + n], slope[5 : 5 + n], strict=True)]
        turns = [fit.propagate(v, s, "rad", at) for v, s in zip(values[5 + n :], slope[5 + n :], strict=True)]
        passive = np.isfinite(found[k].mass)
        frequency = Quantity(own[0].value + back, own[0].stderr, own[0].unit, own[0].freedom)
        modes.append(
            Mode(
                frequency=frequency,
                damping_ratio=own[1],
                half_power=half_power(curves, frequency.value),
                shape=dict(zip(names, sizes, strict=True)),
                phase=dict(zip(names, turns, strict=True)),
                mass=own[2] if passive else None,
                stiffness=own[3] if passive else None,
                damping=own[4] if passive else None,
            )
        )
    return Modes(tuple(modes), speed)


def own_modes(fit: FitResult) -> Modes | None:
    """Modes of a passive rotor that rotation does not change, each with a mass of its own; None of other rotors."""
    model = fit.model
    if model.frame != "z" or model.shaft is not None or model.speed_dependent or len(fit.thetas) > 1:
        return None
    found = fit.modes() if len(model.coordinates) > 1 else ()
    return found if isinstance(found, Modes) and found and found[0].mass is not None else None


def _numbers(mode: VibrationMode) -> Float:
    """Frequency, damping ratio, mass, stiffness, damping, sizes and phases of the shape."""
    passive = np.isfinite(mode.mass)
    parts = (mode.mass, mode.stiffness, mode.damping) if passive else (0.0, 0.0, 0.0)
    sizes = mode.shape.real if passive else np.abs(mode.shape)
    turns = 0.0 * sizes if passive else np.angle(mode.shape)
    return np.concatenate([[mode.frequency, mode.damping_ratio, *parts], sizes, turns])


def _slopes(fit: FitResult, theta: Float, speed: float, place: int, modes: list[VibrationMode]) -> list[Float]:
    """Derivatives of a mode's numbers by the parameters, shape ``(numbers, P)``, by central differences."""
    fitted = np.flatnonzero((fit.problem.space.index >= 0).any(axis=0))
    found = [np.zeros((_numbers(mode).size, theta.size)) for mode in modes]
    relative = 1e-6  # relative step of central differences: errors of 1e-10 of smooth functions
    for i in fitted.tolist():
        step = np.zeros(theta.size)
        step[i] = relative * (abs(theta[i]) or fit.model.parameters[i].scale)
        sides = [vibration_modes(fit.model, theta + sign * step, speed, normalised_at=place) for sign in (1, -1)]
        for mode, slope in zip(modes, found, strict=True):
            near = (min(side, key=lambda m: abs(m.s - mode.s)) for side in sides)
            ahead, behind = (_numbers(replace(m, turn=mode.turn)) for m in near)
            change = ahead - behind
            turns = slice(5 + mode.shape.size, None)
            change[turns] = (change[turns] + np.pi) % (2 * np.pi) - np.pi
            change[[5 + place, 5 + mode.shape.size + place]] = 0.0  # normalised there
            slope[:, i] = change / (2 * step[i])
    return found


def _measured(fit: FitResult) -> Iterator[tuple[Float, Float]]:
    """Signed frequencies, ascending, and sizes of each measured response per unit force."""
    for block in fit.problem.blocks:
        base = responses_of(block)
        if base is None or base.imposed:
            continue
        drive = np.abs(base.force).max(axis=1)[base.line]
        w = base.frequency[base.line]
        for label in np.unique(base.label):
            for side in (w > 0, w < 0):
                rows = np.flatnonzero((base.label == label) & side & (drive > 0))
                rows = rows[np.argsort(w[rows])]
                if rows.size:
                    yield w[rows], np.abs(base.measured[rows]) / drive[rows]


def half_power(curves: Sequence[tuple[Float, Float]], frequency: float) -> float:
    """Damping ratio from where measured responses fall to half the power of their peak near a frequency, rad/s, median
    over the responses (frequencies, ascending, and sizes); NaN where none has a peak there with both of its sides."""
    found = []
    for w, size in curves:
        near = np.flatnonzero(np.abs(w / frequency - 1) < 0.2)
        if near.size < 3:
            continue
        peak = int(near[np.argmax(size[near])])
        ends = [_crossing(w, size, peak, step) for step in (-1, 1)]
        if peak not in (near[0], near[-1]) and np.isfinite(ends).all():
            found.append(abs(ends[1] ** 2 - ends[0] ** 2) / (4 * w[peak] ** 2))
    return float(np.median(found)) if found else float("nan")


def _crossing(w: Float, size: Float, peak: int, step: int) -> float:
    """Frequency at which a response has fallen to half the power of its peak, between two readings."""
    level, k = size[peak] / np.sqrt(2), peak
    while 0 <= k + step < w.size and size[k + step] > level:
        k += step
    if not 0 <= k + step < w.size:
        return float("nan")
    share = (size[k] - level) / (size[k] - size[k + step])
    return float(w[k] + share * (w[k + step] - w[k]))
