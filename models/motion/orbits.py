"""Centred orbits and static equilibria of a nonlinear rotor: roots of one scalar equation in the eccentricity.

Under a circular force the journal of an isotropic rotor runs on a circle, its eccentricity is constant, and the
one-phasor equation ``kappa(w, |A_b|) A = F`` is exact. A constant load is the case w = 0. Condensed to the journal,
``|u / (1 + h Delta(eps))| = eps`` with u the journal's response (over clearance) and h the drive-point receptance of
the centred rotor. There may be several roots; jumps are changes from one to another.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.models.motion.journal import Journal

LARGEST_ECCENTRICITY = 1.0 - 1e-9
"""Largest eccentricity searched: at 1 the journal touches."""


@dataclass(frozen=True, eq=False, kw_only=True)
class OrbitEquation:
    """The scalar equation of many lines, arrays that broadcast to ``(..., L)``; theta is ``(..., L or 1, P)``."""

    theta: Float  # parameter vectors
    frequency: Float  # w, rad/s
    speed: Float  # rotative speed, rad/s
    drive: Float  # size of the journal's response of the centred rotor, over clearance
    receptance: ComplexArray  # drive-point receptance of the centred rotor at the journal, m/N

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of the roots."""
        return np.broadcast_shapes(
            self.theta.shape[:-1], self.frequency.shape, self.speed.shape, self.drive.shape, self.receptance.shape
        )

    def select(self, lines: Index | tuple[Index, ...]) -> Self:
        """The equation of some lines, in one row."""
        shape = self.shape
        return type(self)(
            theta=np.broadcast_to(self.theta, (*shape, self.theta.shape[-1]))[lines],
            frequency=np.broadcast_to(self.frequency, shape)[lines],
            speed=np.broadcast_to(self.speed, shape)[lines],
            drive=np.broadcast_to(self.drive, shape)[lines],
            receptance=np.broadcast_to(self.receptance, shape)[lines],
        )

    def at(self, journal: Journal, eccentricity: Float) -> Float:
        """Answer of :meth:`~rotorfit.models.motion.journal.Journal.excess` for these lines, shape ``(6, ...)``."""
        extra = (...,) + (None,) * (eccentricity.ndim - len(self.shape))
        w, speed, drive = (values[extra] for values in (self.frequency, self.speed, self.drive))
        return journal.excess(self.theta[(*extra, slice(None))], w, speed, drive, self.receptance[extra], eccentricity)

    def change(self, journal: Journal, eccentricity: Float) -> ComplexArray:
        """Change of the drive-point stiffness against the centred journal, N/m."""
        found = self.at(journal, eccentricity)
        return np.asarray(found[2] + 1j * found[3])


def nearest_orbits(journal: Journal, equation: OrbitEquation, target: Float) -> tuple[Float, ComplexArray]:
    """Root nearest to a target for each line, and the change of the drive-point stiffness there, shape ``(..., L)``.
    Where the orbit would pass the clearance there is no root and the answer is :data:`LARGEST_ECCENTRICITY`."""
    # Newton steps lead to the nearest root without doubt where no other is as near: beyond the target, where that would
    # be, the slope changes by about as much again as up to it; twice that change leaves none.
    eps = np.clip(target, 0.0, LARGEST_ECCENTRICITY)
    newton_steps = 3  # Newton steps from a measured eccentricity that all lines take together
    tolerance = 1e-7  # last step whose square is round-off: convergence is quadratic
    near_target = 0.05  # a root this close to its target, with no sign change between, needs no search for others
    with np.errstate(all="ignore"):  # lines without a root are searched
        here = equation.at(journal, eps)
        first = here[1]
        for _ in range(newton_steps - 1):
            eps = np.clip(eps - here[0] / here[1], 0.0, LARGEST_ECCENTRICITY)
            here = equation.at(journal, eps)
        step = here[0] / here[1]
        found = eps - step
        settled = (np.abs(step) < tolerance) & (found >= 0) & (found < LARGEST_ECCENTRICITY)
        alone = (np.abs(found - target) <= near_target) & (first < -2 * np.abs(here[1] - first))
        change = np.empty(found.shape, dtype=complex)
        change.real, change.imag = here[2] - here[4] * step, here[3] - here[5] * step
    if not (settled & alone).all():
        rest = np.nonzero(~(settled & alone))
        part, aim = equation.select(rest), np.broadcast_to(target, found.shape)[rest]
        roots = zip(all_roots(journal, part), aim, strict=True)
        found[rest] = [each[np.argmin(np.abs(each - near))] for each, near in roots]
        change[rest] = part.change(journal, found[rest])
    return found, change


def all_roots(journal: Journal, equation: OrbitEquation) -> list[Float]:
    """All eccentricities that solve each line's equation, ascending, to the resolution of a grid of 129 points."""
    grid_points = 129  # eccentricities at which a search looks for sign changes
    grid = np.linspace(0.0, LARGEST_ECCENTRICITY, grid_points)
    value = equation.at(journal, np.broadcast_to(grid, (*equation.shape, grid_points)))[0]
    line, cell = np.nonzero((value[:, :-1] >= 0) != (value[:, 1:] >= 0))
    low, high = grid[cell], grid[cell + 1]
    part = equation.select(line.astype(np.intp))
    falling = value[line, cell] >= 0
    for _ in range(52):
        middle = 0.5 * (low + high)
        left = (part.at(journal, middle)[0] >= 0) == falling
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    roots = [0.5 * (low + high)[line == number] for number in range(equation.shape[0])]
    return [found if found.size else np.array([LARGEST_ECCENTRICITY]) for found in roots]


def followed_roots(journal: Journal, equation: OrbitEquation, sweep: Index) -> Float:
    """Roots along sweeps, as a rig would run, from the lowest on; where a branch ends the nearest other: the jump."""
    shape = equation.shape
    if len(shape) > 1:  # every vector's sweeps are its own
        flat = equation.select(tuple(place.ravel() for place in np.indices(shape)))
        vectors = int(np.prod(shape[:-1]))
        own = np.arange(vectors)[:, None] * (sweep.max() + 1) + sweep
        return followed_roots(journal, flat, own.ravel()).reshape(shape)
    roots = all_roots(journal, equation)
    eps = np.zeros(sweep.size)
    last: dict[int, float] = {}
    for line, number in enumerate(sweep.tolist()):
        stable = roots[line][::2]  # excess falls through stable roots: the first, the third, ...
        eps[line] = stable[np.argmin(np.abs(stable - last.get(number, 0.0)))]
        last[number] = float(eps[line])
    return eps
