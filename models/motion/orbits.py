"""Centred orbits and static equilibria of a nonlinear rotor: roots of one scalar equation in the eccentricity.

Under a circular force the journal of an isotropic rotor runs on a circle, its eccentricity is constant, and the
one-phasor equation ``kappa(w, |A_b|) A = F`` is exact. A constant load is the case w = 0. Condensed to the journal,
``|u / (1 + h Delta(eps))| = eps`` with u the journal's response (over clearance) and h the drive-point receptance of
the centred rotor. There may be several roots; jumps are changes from one to another. Of several
journals each has its equation, the others held; all together are solved by Newton's method or by turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
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


@dataclass(frozen=True, eq=False, kw_only=True)
class CentredMotion:
    """Receptance and forced motion of a rotor on centred journals, and as its journals leave the centre."""

    theta: Float  # parameter vectors, shape ``(..., L or 1, P)``
    frequency: Float  # w of each line, rad/s
    speed: Float  # rotative speed, rad/s
    receptance: ComplexArray  # shape ``(n, n, ..., L)``
    amplitude: ComplexArray  # response to the forces, shape ``(n, ..., L)``

    def changed(self, at: int, change: ComplexArray) -> Self:
        """The same with another drive-point stiffness at one coordinate: a rank-one change of the inverse."""
        H = self.receptance
        gain = change / (1.0 + change * H[at, at])
        column = gain * H[:, at]
        return replace(
            self,
            receptance=H - column[:, None] * H[at],
            amplitude=self.amplitude - column * self.amplitude[at],
        )

    def select(self, lines: Index) -> Self:
        """The motion in some lines, numbered as if all were in one row."""
        size, *shape = self.amplitude.shape
        count = self.theta.shape[-1]
        return replace(
            self,
            theta=np.broadcast_to(self.theta, (*shape, count)).reshape(-1, count)[lines],
            frequency=np.broadcast_to(self.frequency, shape).ravel()[lines],
            speed=np.broadcast_to(self.speed, shape).ravel()[lines],
            receptance=self.receptance.reshape(size, size, -1)[:, :, lines],
            amplitude=self.amplitude.reshape(size, -1)[:, lines],
        )

    def equation(self, journal: Journal) -> OrbitEquation:
        """The scalar equation of one journal."""
        at = journal.at
        return OrbitEquation(
            theta=self.theta,
            frequency=self.frequency,
            speed=self.speed,
            drive=np.abs(self.amplitude[at]) / journal.clearance,
            receptance=self.receptance[at, at],
        )


def nearest_together(journals: Sequence[Journal], centred: CentredMotion, target: Float) -> tuple[Float, ComplexArray]:
    """Eccentricities of several journals nearest to targets, shape ``(J, L)`` or ``(J, ..., L)``, and the changes of
    their drive-point stiffness, shape ``(J, ..., L)``."""
    shape = (len(journals), *centred.amplitude.shape[1:])
    aim = np.broadcast_to(target.reshape(len(journals), *[1] * (len(shape) - target.ndim), *target.shape[1:]), shape)
    near = 0.05  # roots this close to their targets need no search for others
    eps, settled = _newton(journals, centred, aim)
    rest = np.flatnonzero(~(settled & (np.abs(eps - aim) <= near).all(axis=0)))
    if rest.size:
        part = centred.select(rest)
        found = _by_turns(journals, part, aim.reshape(len(journals), -1)[:, rest], lambda *of: nearest_orbits(*of)[0])
        eps.reshape(len(journals), -1)[:, rest] = _newton(journals, part, found)[0]
    return eps, _changes(journals, centred, eps)


def followed_together(journals: Sequence[Journal], centred: CentredMotion, sweep: Index) -> tuple[Float, ComplexArray]:
    """The same along sweeps, each journal by :func:`followed_roots` with the others held."""
    rest = np.zeros((len(journals), *centred.amplitude.shape[1:]))
    found = _by_turns(journals, centred, rest, lambda seat, orbit, _: followed_roots(seat, orbit, sweep))
    eps, _ = _newton(journals, centred, found)
    return eps, _changes(journals, centred, eps)


def _changes(journals: Sequence[Journal], centred: CentredMotion, eps: Float) -> ComplexArray:
    return np.stack([centred.equation(seat).change(seat, own) for seat, own in zip(journals, eps, strict=True)])


def _by_turns(
    journals: Sequence[Journal],
    centred: CentredMotion,
    begin: Float,
    solve: Callable[[Journal, OrbitEquation, Float], Float],
) -> Float:
    """Eccentricities, one after the other solved with the others held, until Newton's method can go on."""
    turns, near = 30, 1e-3
    eps = np.array(begin)
    for _ in range(turns):
        before = eps.copy()
        for k, journal in enumerate(journals):
            held = centred
            for other, seat in enumerate(journals):
                if other != k:
                    held = held.changed(seat.at, centred.equation(seat).change(seat, eps[other]))
            eps[k] = solve(journal, held.equation(journal), eps[k])
        if (np.abs(eps - before) < near).all():
            break
    return eps


def _newton(journals: Sequence[Journal], centred: CentredMotion, begin: Float) -> tuple[Float, Bool]:
    """Eccentricities by Newton's method for all journals together, and which lines have settled."""
    steps, tolerance = 12, 1e-7  # of the last step: convergence is quadratic
    eps = np.clip(begin, 0.0, LARGEST_ECCENTRICITY)
    settled: Bool = np.zeros(eps.shape[1:], dtype=bool)
    with np.errstate(all="ignore"):  # lines without a root are searched
        for _ in range(steps):
            step = _newton_step(journals, centred, eps)
            eps = np.clip(eps + step, 0.0, LARGEST_ECCENTRICITY)
            settled = np.asarray((np.abs(step) < tolerance).all(axis=0))
            if settled.all():
                break
    return eps, settled


def _newton_step(journals: Sequence[Journal], centred: CentredMotion, eps: Float) -> Float:
    """Step of all eccentricities together, zero where one fills its gap."""
    found = [centred.equation(seat).at(seat, own) for seat, own in zip(journals, eps, strict=True)]
    motion = centred
    for seat, (_, _, re, im, _, _) in zip(journals, found, strict=True):
        motion = motion.changed(seat.at, re + 1j * im)
    at = np.array([seat.at for seat in journals])
    clearance = np.array([seat.clearance for seat in journals])
    moving = np.moveaxis(motion.amplitude[at], 0, -1)
    slope = np.stack([np.broadcast_to(by_re + 1j * by_im, eps.shape[1:]) for *_, by_re, by_im in found], axis=-1)
    H = np.moveaxis(motion.receptance[at[:, None], at], (0, 1), (-2, -1))
    size = np.abs(moving)
    pointer = np.divide(moving.conj(), size * clearance, out=np.zeros_like(moving), where=size > 0)
    excess = size / clearance - np.moveaxis(eps, 0, -1)
    by_eps = -(pointer[..., None] * H * (slope * moving)[..., None, :]).real - np.eye(at.size)
    step = np.linalg.solve(by_eps, -excess[..., None])[..., 0]
    inside = (np.moveaxis(eps, 0, -1) < LARGEST_ECCENTRICITY).all(axis=-1, keepdims=True)
    return np.moveaxis(np.where(inside, step, 0.0), -1, 0)
