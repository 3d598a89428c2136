"""Small motion of a nonlinear rotor about an off-centre equilibrium, and the equilibria themselves.

A static load moves the journal to z_s. The force ``F = sum_k C_k(|z_b| / clearance) d^k z / dt^k`` has there the
derivative ``dF = sum_k C_k d^k dz/dt^k + N (dz_b + exp(2 j phi) conj(dz_b))``, phi being the direction of z_s and N
half the eccentricity times the slope of the static stiffness. The conjugate couples forward and backward motion:
``dz = A exp(jwt) + B exp(-jwt)`` obeys one matrix equation for A and conj(B), of twice the size.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Index
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.journal import journal, known_structure, line_stiffness
from rotorfit.models.motion.neglected_terms import LeftOut
from rotorfit.models.motion.orbits import OrbitEquation, all_roots
from rotorfit.models.motion.stability import SPEEDS, Threshold, first_growth, mode_vectors, seats, spectrum
from rotorfit.models.shafts.angular_rates import angular_rate
from rotorfit.models.shafts.turning import beside


def static_equilibria(model: RotorModel, theta: ArrayLike, speed: float, load: ArrayLike) -> list[ComplexArray]:
    """Every displacement ``(n,)`` under a constant load ``(n,)``, m, the smallest first; one of a linear model."""
    speed, load = angular_rate(speed), np.asarray(load, dtype=complex)
    H = model.receptance(theta, 0.0, speed)
    centred = H @ load
    if not model.eccentricity_dependent:
        return [centred]
    seat = journal(model)
    equation = OrbitEquation(
        theta=np.asarray(theta, dtype=float)[None],
        frequency=np.zeros(1),
        speed=np.array([speed], dtype=float),
        drive=np.abs(centred[[seat.at]]) / seat.clearance,
        receptance=H[[seat.at], seat.at],
    )
    roots = all_roots(seat, equation)[0]
    return [model.receptance(theta, 0.0, speed, eps) @ load for eps in roots.tolist()]


def coupled_stiffness(
    model: RotorModel,
    theta: ArrayLike,
    frequency: ArrayLike,
    speed: ArrayLike,
    eccentricity: ArrayLike,
    attitude: ArrayLike = 0.0,
) -> ComplexArray:
    """Dynamic stiffness of small motion on (A, conj(B)), forward and backward, shape ``(..., L, 2n, 2n)``."""
    w, speed, eps, phi = np.broadcast_arrays(*np.atleast_1d(np.abs(frequency), speed, eccentricity, attitude))
    theta = np.asarray(theta, dtype=float)
    graph = line_stiffness(model)
    forward = graph.values(theta, w, speed, eps)
    backward = graph.values(theta, -w, speed, eps).conj()
    if model.shaft is not None:
        forward = forward + known_structure(model, theta, 1j * w, speed).values
        backward = backward + known_structure(model, theta, -1j * w, speed).values.conj()
    n = forward.shape[0]
    total = np.zeros((2 * n, 2 * n, *forward.shape[2:]), dtype=complex)
    total[:n, :n], total[n:, n:] = forward, backward
    if model.eccentricity_dependent:  # forward and backward motion are coupled at the journal
        seat = journal(model)
        at, other, N, turn = seat.at, seat.at + n, seat.coupling(theta, speed, eps), np.exp(2j * phi)
        total[at, at] += N
        total[at, other] += N * turn
        total[other, at] += (N * turn).conj()
        total[other, other] += N.conj()
    return np.moveaxis(total, (0, 1), (-2, -1))


def free_motion(model: RotorModel, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
    """Coefficient matrices of small free motion, acting on (z, conj(z)), shape ``(..., order + 1, 2N, 2N)``."""
    C = np.array(model.motion(theta, speed))
    places = seats(model)
    size = C.shape[-1]
    if model.eccentricity_dependent:
        change = model.coefficients(theta, speed, eccentricity) - model.coefficients(theta, speed)
        C[..., places[:, None], places] += change
    total = beside([C, C.conj()])
    if model.eccentricity_dependent:
        seat = journal(model)
        at = int(places[seat.at])
        N = seat.coupling(theta, speed, eccentricity)
        for row, column, entry in ((0, 0, N), (0, size, N), (size, 0, N.conj()), (size, size, N.conj())):
            total[..., 0, at + row, at + column] += entry
    return total


def off_centre_eigenvalues(
    model: RotorModel, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike
) -> ComplexArray:
    """Eigenvalues of small free motion by imaginary part, ``(..., order 2N)``; infinite ones of several are NaN."""
    s = spectrum(model, free_motion(model, theta, speed, eccentricity))
    s = s[np.isfinite(s)] if s.ndim == 1 else s
    return np.asarray(np.take_along_axis(s, np.argsort(s.imag, axis=-1), axis=-1))


def off_centre_gradient(
    model: RotorModel, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike, s: ComplexArray | complex
) -> ComplexArray:
    """Derivatives of simple eigenvalues by the parameters and, last, the eccentricity, shape ``(..., P + 1)``."""
    if model.shaft is not None and np.ndim(s):
        lines = zip(np.asarray(theta), np.asarray(speed), np.asarray(eccentricity), np.asarray(s), strict=True)
        return np.array([off_centre_gradient(model, *line) for line in lines])
    s = np.asarray(s, dtype=complex)
    C = free_motion(model, theta, speed, eccentricity)
    size = C.shape[-1] // 2
    u, v, by_s = mode_vectors(C, s)
    places = seats(model)
    total = np.zeros((len(model.parameters) + 2, *s.shape), dtype=complex)
    parts: list[tuple[CoefficientJacobian, Index, float]]
    if model.shaft is None:
        parts = [(model.functions.jacobian(theta, speed, eccentricity), places, 1.0)]
    else:
        parts = [(model.motion_jacobian(theta, float(np.asarray(speed))), np.arange(size), 1.0)]
        if model.eccentricity_dependent:
            parts.append((model.functions.jacobian(theta, speed, eccentricity), places, 1.0))
            centred = model.functions.jacobian(theta, speed)
            values = np.where(centred.inputs == len(model.parameters) + 1, 0.0, centred.values)
            parts.append((replace(centred, values=values), places, -1.0))
    for jacobian, place, sign in parts:
        rows, columns = place[jacobian.rows], place[jacobian.columns]
        entries = u[..., rows] * v[..., columns] * jacobian.values
        entries = entries + u[..., size + rows] * v[..., size + columns] * jacobian.values.conj()
        np.add.at(total, jacobian.inputs, np.moveaxis(sign * s[..., None] ** jacobian.powers * entries, -1, 0))
    result = np.moveaxis(np.delete(total, -2, axis=0), 0, -1)  # without that by the speed
    if model.eccentricity_dependent:
        seat = journal(model)
        at = int(places[seat.at])
        slope = np.moveaxis(seat.coupling_jacobian(theta, speed, eccentricity), 0, -1)
        moved = v[..., at] + v[..., size + at]
        result = result + (u[..., at] * moved)[..., None] * slope
        result = result + (u[..., size + at] * moved)[..., None] * slope.conj()
    return np.asarray(-result / by_s[..., None])


def off_centre_shift(
    model: RotorModel, theta: ArrayLike, speed: float, eccentricity: float, s: complex, ahead: LeftOut, behind: LeftOut
) -> complex:
    """Change of a simple eigenvalue by a unit of a term that the model leaves out, as it is for motion that whirls
    forward and backward."""
    C = free_motion(model, theta, speed, eccentricity)
    places, size = seats(model), C.shape[-1] // 2
    u, v, by_s = mode_vectors(C, np.asarray(s, dtype=complex))
    total = 0j
    for entries, factor, side in (
        (ahead.entries, ahead.factor(np.asarray(s), np.asarray(speed)), 0),
        (behind.entries, behind.factor(np.asarray(s).conj(), np.asarray(speed)).conj(), size),
    ):
        total += sum(weight * factor * u[side + places[i]] * v[side + places[j]] for i, j, weight in entries)
    return complex(-total / by_s)


def off_centre_threshold(
    model: RotorModel, theta: ArrayLike, eccentricity: float, *, band: float = math.inf
) -> Threshold | None:
    """Lowest rotative speed at which small motion about equilibria of one eccentricity becomes unstable. The load that
    keeps the journal at this eccentricity changes with the speed. At ``eccentricity = 0`` this is
    :func:`~rotorfit.models.threshold_speed`."""
    theta = np.asarray(theta, dtype=float)
    if not model.speed_dependent:
        return None

    def critical(speed: float) -> complex:
        s = off_centre_eigenvalues(model, theta, speed, eccentricity)
        return complex(s[np.argmax(np.where(np.abs(s) <= band, s.real, -np.inf))])

    still = np.abs(off_centre_eigenvalues(model, theta, 0.0, eccentricity))
    counted = np.sort(still[(still <= band) & (still > 0)])[: 2 * model.order * len(model.coordinates)]
    speeds = np.geomspace(3e-3, 30.0, SPEEDS) * (float(counted[-1]) if counted.size else 300.0)
    round_off = 1e-13 * float(still.max()) if model.shaft is not None else 0.0
    onset = first_growth(lambda at: np.array([critical(v).real for v in at.tolist()]) - round_off, speeds)
    if onset is None:
        return None
    s = critical(onset)
    if onset == 0:
        return Threshold(0.0, abs(s.imag), theta * np.nan)
    step = 1e-5 * onset
    by_speed = (critical(onset + step).real - critical(onset - step).real) / (2 * step)
    gradient = off_centre_gradient(model, theta, onset, eccentricity, s)[:-1]
    return Threshold(onset, abs(s.imag), np.asarray(-gradient.real / by_speed))
