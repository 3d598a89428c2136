"""Observed dynamic stiffness: what a trial weight, a start-up or a few speeds say of the whole rotor at once.

The paper's balancing section: the force of a known unbalance over the 1x motion that it adds. The direct part against
the square of the speed is a line with the observed stiffness and mass, the quadrature part against speed one with the
observed damping; a change of either is the earliest sign that the rotor or its supports have changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.text_table import Printed, Wide, text_table
from rotorfit.base.units import RPM_PER_RAD_S, in_rad_s
from rotorfit.estimators.inference.covariance import widening
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.several_forces import refuse_several
from rotorfit.lab.observing.circular import observe
from rotorfit.lab.observing.measured_stiffness import IsotropicPlanes
from rotorfit.models.parameters import MATRIX_UNITS


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ObservedStiffness(ByValue, Printed):
    """Observed dynamic stiffness of one date, between one force plane and one probe plane.

    Attributes:
        date: of the test, as the file has it; empty if it does not say.
        source: where the data came from.
        force_plane, plane: of the weight and of the probes.
        speed: rad/s, ascending, shape ``(N,)``.
        stiffness: force over motion, forward, complex, N/m, shape ``(N,)``.
        sigma: standard deviation of its real and of its imaginary part, N/m, shape ``(N,)``.
        observed: K, M and D of the straight lines with their standard errors, SI units; empty where the speeds are too
            few or too close.
        redchi: chi-squared of the lines over the degrees of freedom; NaN without lines.
    """

    date: str
    source: str
    force_plane: str
    plane: str
    speed: Float
    stiffness: ComplexArray
    sigma: Float
    observed: Mapping[str, tuple[float, float]]
    redchi: float

    def __str__(self) -> str:
        head = f"{self.date or self.source or 'test'}: force at {self.force_plane}, motion at {self.plane}"
        columns = (self.speed * RPM_PER_RAD_S, self.stiffness.real, self.stiffness.imag)
        rows: list[list[str | Wide]] = [
            [*(significant(value, 5) for value in row), significant(sigma, 2)]
            for *row, sigma in zip(*columns, self.sigma, strict=True)
        ]
        lines = [
            f"  {name} {significant(value, 5)} +- {significant(error, 2)} {MATRIX_UNITS[name]}"
            for name, (value, error) in self.observed.items()
        ]
        more: list[str | Wide] = [Wide(f"       ... {len(rows) - 12} speeds more", 4, remark=True)]
        shown = rows if len(rows) <= 12 else [*rows[:6], more, *rows[-6:]]
        table = text_table([["rpm", "direct N/m", "quadrature", "sigma"], *shown], ">10 >15 >15 >11")
        return "\n".join([head, *table, *lines])


def observed_stiffness(
    test: PerturbationTest, *, speed: tuple[float, float] | None = None, speed_rpm: tuple[float, float] | None = None
) -> list[ObservedStiffness]:
    """Observed dynamic stiffness of a synchronous test, for every date, force plane and probe plane.

    Args:
        test: a synchronous test of known weights, with residual unbalance taken out: pairs at 0 and 180 degrees, or a
            run without the weight (``rf.read`` differences both). An attribute ``date`` parts it into dates.
        speed: range of speeds, rad/s.
        speed_rpm: range of speeds to use; observed K, M and D are those of one mode, so stay below the next critical.

    Returns:
        one entry a date, force plane and probe plane, in the order of the data.

    Raises:
        ValueError: not a synchronous test, or nothing forced in the range of speeds.

    Example:
        >>> for found in rf.observed_stiffness(rf.datasets.two_disk(), speed_rpm=(250, 1500)):
        ...     print(found.force_plane, found.plane, f"{1e-3 * found.observed['K'][0]:.0f} N/mm")
        inboard inboard 38 N/mm
        inboard outboard 44 N/mm
        outboard inboard 44 N/mm
        outboard outboard 40 N/mm
    """
    where = test.source or "the test"
    if not test.synchronous:
        raise ValueError(f"{where} is not synchronous: observed stiffness needs frequency = speed on all rows")
    refuse_several(test, "observed stiffness")
    rows = (test.force != 0) & (test.speed > 0)
    used = in_rad_s("speed", speed, needed=False, rpm=speed_rpm)
    if used is not None:
        low, high = used
        rows &= (test.speed >= low) & (test.speed <= high)
    if not rows.any():
        raise ValueError(
            f"{where} has no reading under a known weight" + (" at these speeds" if used is not None else "")
        )
    test = test.select(rows)
    dates = test.attributes["date"].astype(str) if "date" in test.attributes else np.full(len(test), "")
    found = []
    for date, force_plane, plane in product(dict.fromkeys(dates.tolist()), test.force_planes, test.planes):
        chosen = (dates == date) & (test.force_plane == force_plane) & (test.plane == plane)
        if chosen.any():
            found.append(_observed(test.select(chosen), date, force_plane, plane))
    return found


def _observed(test: PerturbationTest, date: str, force_plane: str, plane: str) -> ObservedStiffness:
    names = tuple(dict.fromkeys([force_plane, plane]))
    seen = observe(IsotropicPlanes(names), test, np.zeros(len(test), dtype=np.intp))
    order = np.argsort(seen.speed[seen.line], kind="stable")
    speed = seen.speed[seen.line][order]
    force = seen.force[seen.line, 0][order]
    stiffness = force / seen.measured[order]
    sigma = seen.sigma[order] * np.abs(stiffness) ** 2 / np.abs(force)
    observed, redchi = straight_lines(speed, stiffness, sigma)
    return ObservedStiffness(
        date=date,
        source=test.source,
        force_plane=force_plane,
        plane=plane,
        speed=speed,
        stiffness=stiffness,
        sigma=sigma,
        observed=observed,
        redchi=redchi,
    )


def straight_lines(speed: Float, stiffness: ComplexArray, sigma: Float) -> tuple[dict[str, tuple[float, float]], float]:
    """K and M from the direct part against the squared speed, D from the quadrature part against speed. Returns the
    value and standard error by name, widened by ``sqrt(redchi)`` where that exceeds one; and redchi."""
    # Ratio of the largest to the smallest speed from which stiffness and mass can be separated
    least_speed_ratio = 1.05
    if np.unique(speed).size < 2 or speed.max() < least_speed_ratio * speed.min():
        return {}, float("nan")
    scale = speed.max()
    design = np.zeros((2 * speed.size, 3))
    design[: speed.size, 0], design[: speed.size, 1] = 1.0, -((speed / scale) ** 2)
    design[speed.size :, 2] = speed / scale
    weight = 1 / np.concatenate([sigma, sigma])
    y = np.concatenate([stiffness.real, stiffness.imag]) * weight
    solution, rest, _, _ = np.linalg.lstsq(design * weight[:, None], y, rcond=None)
    freedom = y.size - 3
    redchi = float(rest[0] / freedom) if rest.size else float("nan")
    covariance = np.linalg.inv((design * weight[:, None]).T @ (design * weight[:, None]))
    errors = np.sqrt(np.diag(covariance) * widening(redchi, "linear"))
    units = (1.0, scale**2, scale)
    names: Sequence[str] = tuple(MATRIX_UNITS)
    return {
        name: (float(value / unit), float(error / unit))
        for name, value, error, unit in zip(names, solution, errors, units, strict=True)
    }, redchi
