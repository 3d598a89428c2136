"""Motion of a rotor with a law of eccentricity under any force in time, at a speed that may change."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.motion.journal import journal
from rotorfit.simulation.integration import IntegrationError

_TOLERANCE = 1e-6  # error of a step as a share of the motion: far below the noise of probes


def nonlinear_path(
    model: RotorModel,
    theta: Float,
    *,
    speed: Callable[[Float], Float],
    force: Callable[[Float], ComplexArray],
    rate: float,
    count: int,
) -> ComplexArray:
    """Displacements of all coordinates at equally spaced times, starting from rest, shape ``(count, n)``.

    The fluid is that at the speed and at the eccentricity of the moment, so that the path goes on beyond the onset of
    instability, on the whirl that the law limits.
    """
    from scipy.integrate import solve_ivp

    seat, n = journal(model), len(model.coordinates)

    def slope(t: float, state: ComplexArray) -> ComplexArray:
        z, velocity, at = state[:n], state[n:], np.array([t])
        eccentricity = float(abs(z[seat.at]) / seat.clearance)
        stiffness, damping, mass = model.functions.values(theta, float(speed(at)[0]), eccentricity)
        push = np.linalg.solve(mass, force(at)[0] - stiffness @ z - damping @ velocity)
        return np.concatenate([velocity, push])

    times = np.arange(count) / rate
    smallest = _TOLERANCE * 1e-3 * seat.clearance  # of displacements; of velocities at 100 rad/s
    absolute = np.repeat([smallest, 100.0 * smallest], n)
    with np.errstate(all="ignore"):  # a trial step beyond the clearance gives NaN and is cut
        found = solve_ivp(
            slope,
            (0.0, float(times[-1])),
            np.zeros(2 * n, dtype=complex),
            method="DOP853",
            t_eval=times,
            rtol=_TOLERANCE,
            atol=absolute,
        )
    path = np.asarray(found.y[:n].T, dtype=complex)
    if not found.success or np.abs(path[:, seat.at]).max() >= seat.clearance:
        where = f"{model.name}: the journal touches the wall after {significant(found.t[-1], 3)} s"
        raise IntegrationError(f"{where}; take a smaller force or a lower speed")
    return path
