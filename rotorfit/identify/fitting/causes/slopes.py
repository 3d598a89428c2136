"""What causes do to results: to what is made of values of the model, to eigenvalues, to the onset of instability."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.identify.fitting.causes.solution import SolvedCauses
from rotorfit.models import RotorModel, Threshold
from rotorfit.models.motion.neglected_terms import eigenvalue_shift, onset_shift
from rotorfit.models.motion.stability import SPEEDS, fastest_growth, first_growth, search_limits, seats


def value_slopes(
    model: RotorModel, theta: Float, gradient: Float, speed: Float | float | None, solved: SolvedCauses
) -> Float:
    """Derivatives of a result by the sizes of causes that change values of the model, shape ``(..., k)``.

    Args:
        model: the rotor.
        theta: its parameter vector, shape ``(P,)``.
        gradient: derivatives by it, shape ``(..., P)``.
        speed: rotative speed, rad/s, that the result belongs to, or one each; none for one at the values themselves.
        solved: the causes.
    """
    found = [cause.act.values_at(model, theta, speed) for cause in solved.causes]
    zero = np.zeros(gradient.shape[:-1])
    return np.stack([zero if one is None else (gradient * one).sum(axis=-1) for one in found], axis=-1)


def stiffness_slopes(
    model: RotorModel, theta: Float, frequency: Float, speed: Float, solved: SolvedCauses
) -> ComplexArray:
    """Derivatives of the dynamic stiffness at frequencies and speeds, rad/s, by the sizes of causes that act on the
    rotor beside its values, shape ``(k, W, n, n)``."""
    n = len(model.coordinates)
    found = np.zeros((len(solved.causes), frequency.size, n, n), dtype=complex)
    for one, cause in zip(found, solved.causes, strict=True):
        for here, whirl in ((frequency >= 0, 1.0), (frequency < 0, -1.0)):
            if (term := cause.act.term(model, theta, whirl)) is None:
                continue
            for i, j, weight in term.entries:
                one[here, i, j] += weight * term.factor(np.asarray(1j * frequency[here]), speed[here])
    return found


def eigenvalue_slopes(model: RotorModel, theta: Float, speed: float, s: complex, solved: SolvedCauses) -> ComplexArray:
    """Derivatives of an eigenvalue by the sizes of causes that act on the rotor beside its values, shape ``(k,)``."""
    terms = [cause.act.term(model, theta, s.imag) for cause in solved.causes]
    own = [term for term in terms if term is not None]
    moved = iter(eigenvalue_shift(model, model.motion(theta, speed), speed, np.asarray(s), own) if own else ())
    return np.array([0j if term is None else next(moved) for term in terms])


def onset_slopes(model: RotorModel, theta: Float, onset: Threshold, solved: SolvedCauses) -> Float:
    """Derivatives of the threshold speed by the sizes of causes, the fitted values held, shape ``(k,)``."""
    by_values = value_slopes(model, theta, onset.gradient, onset.speed, solved)
    return by_values + onset_term_slopes(model, theta, onset, solved)


def onset_term_slopes(model: RotorModel, theta: Float, onset: Threshold, solved: SolvedCauses) -> Float:
    """Those of causes that act on the rotor beside its values; none of a rotor unstable from standstill on."""
    if not onset.speed:
        return np.zeros(len(solved.causes))
    terms = (cause.act.term(model, theta, onset.whirl_frequency) for cause in solved.causes)
    return np.array([0.0 if term is None else onset_shift(model, theta, onset, term) for term in terms])


def onset_with_causes(model: RotorModel, theta: Float, onset: Threshold, solved: SolvedCauses, band: float) -> float:
    """Threshold speed of the rotor with its causes, rad/s, the highest searched without one."""
    acting = [(cause.act, size) for cause, size, _ in solved if size]
    every = [(act.term(model, theta, onset.whirl_frequency), size) for act, size in acting]
    terms = [(term, size) for term, size in every if term is not None]
    beyond = [
        (term, size) for term, size in terms if max((power for _, power, _ in term.terms), default=0) > model.order
    ]
    terms = [one for one in terms if one not in beyond]
    more = sum(size * onset_shift(model, theta, onset, term) for term, size in beyond)
    (highest, round_off), at = search_limits(model, theta, band), seats(model)

    def growth(speed: Float) -> Float:
        moved = np.tile(theta, (speed.size, 1))
        for act, size in acting:
            values = act.values_at(model, theta, speed)
            moved = moved if values is None else moved + size * values
        coefficients = np.array(model.motion(moved, speed))
        for term, size in terms:
            for row, column, weight in term.entries:
                for factor, power, speeds in term.terms:
                    coefficients[:, power, at[row], at[column]] += weight * size * factor * speed**speeds
        return fastest_growth(model, coefficients, band) - round_off

    found = first_growth(growth, np.geomspace(1e-4 * highest, highest, SPEEDS)) if acting else onset.speed
    return highest if found is None else found + more
