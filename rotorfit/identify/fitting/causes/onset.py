"""What causes do to the onset of instability."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.identify.fitting.causes.solution import SolvedCauses
from rotorfit.models import RotorModel, Threshold
from rotorfit.models.motion.neglected_terms import onset_shift
from rotorfit.models.motion.stability import SPEEDS, fastest_growth, first_growth, search_limits


def onset_slopes(model: RotorModel, theta: Float, onset: Threshold, solved: SolvedCauses) -> Float:
    """Derivatives of the threshold speed by the sizes of causes, the fitted values held, shape ``(k,)``."""
    found = []
    for cause in solved.causes:
        term = cause.act.term(model, theta, onset.whirl_frequency)
        values = cause.act.values_at(model, theta, onset.speed)
        slope = 0.0 if values is None else float(onset.gradient @ values)
        found.append(slope + (0.0 if term is None else onset_shift(model, theta, onset, term)))
    return np.array(found)


def onset_with_causes(model: RotorModel, theta: Float, onset: Threshold, solved: SolvedCauses, band: float) -> float:
    """Threshold speed of the rotor with its causes, rad/s, the highest searched without one."""
    acting = [(cause.act, size) for cause, size, _ in solved if size]
    every = [(act.term(model, theta, onset.whirl_frequency), size) for act, size in acting]
    terms = [(term, size) for term, size in every if term is not None]
    beyond = [(term, size) for term, size in terms if max(power for _, power, _ in term.terms) > model.order]
    terms = [one for one in terms if one not in beyond]
    more = sum(size * onset_shift(model, theta, onset, term) for term, size in beyond)
    highest, round_off = search_limits(model, theta, band)

    def growth(speed: Float) -> Float:
        moved = np.tile(theta, (speed.size, 1))
        for act, size in acting:
            values = act.values_at(model, theta, speed)
            moved = moved if values is None else moved + size * values
        coefficients = np.array(model.motion(moved, speed))
        for term, size in terms:
            for row, column, weight in term.entries:
                for factor, power, speeds in term.terms:
                    coefficients[:, power, row, column] += weight * size * factor * speed**speeds
        return fastest_growth(model, coefficients, band) - round_off

    found = first_growth(growth, np.geomspace(1e-4 * highest, highest, SPEEDS)) if acting else onset.speed
    return highest if found is None else found + more
