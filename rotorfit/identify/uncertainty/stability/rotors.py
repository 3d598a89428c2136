"""Many rotors of one model: what a fit or a posterior leaves open, and what the model leaves out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.matching import matched
from rotorfit.base.names import unknown_name
from rotorfit.estimators.inference.cause_acts import Act
from rotorfit.estimators.inference.covariance import spreading
from rotorfit.identify.fitting.causes.slopes import onset_slopes
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import RotorModel, eigenvalues
from rotorfit.models.coefficient_tables import loop_stiffness
from rotorfit.models.line_terms import Weights
from rotorfit.models.motion.neglected_terms import LeftOut, eigenvalues_with
from rotorfit.models.motion.stability import counted, spectrum, whirl_sense

_BLOCK = 1 << 19
"""Numbers that the coefficients of all rotors of a block hold at all speeds, eight megabytes."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rotors:
    """Rotors of one model."""

    model: RotorModel  # the model
    band: float = math.inf  # modulus of eigenvalues that count, rad/s
    theta: Float  # parameter vectors, shape ``(W, P)``
    # of the equation of motion that the model leaves out, and what changes its values
    terms: tuple[LeftOut | Act, ...]
    sizes: Float  # of these terms in each rotor, shape ``(W, T)``
    onset_shifts: tuple[float, ...] = ()  # change of the threshold speed by a unit of each term, rad/s
    # cross-coupled stiffness at planes, N/m, which drives forward whirl; by plane, each shape ``(W,)``
    coupling: Mapping[str, Float]

    def part(self, rows: Index | slice) -> Rotors:
        """Some of the rotors."""
        coupling = {plane: stiffness[rows] for plane, stiffness in self.coupling.items()}
        return replace(self, theta=self.theta[rows], sizes=self.sizes[rows], coupling=coupling)

    def scaled(self, factors: Mapping[str, float]) -> Rotors:
        """With parameters multiplied by factors."""
        names = self.model.parameter_names
        for name, factor in factors.items():
            if name not in names:
                raise ValueError(unknown_name("parameter", name, names))
            if not 0 <= factor < math.inf:
                raise ValueError(f"the factor of {name} in a case is {factor:g}; it is finite and not below zero")
        return replace(self, theta=self.theta * np.array([factors.get(name, 1.0) for name in names]))

    def coupled(self, coupling: Mapping[str, float], factor: Float | float = 1.0) -> Rotors:
        """With cross-coupled stiffness at planes, N/m, times a factor."""
        each = {p: np.broadcast_to(q * np.ravel(factor), (len(self.theta),)) for p, q in coupling.items()}
        return replace(self, coupling=each)

    def eigenvalues(self, speed: float, reference: ComplexArray) -> ComplexArray:
        """Those of each rotor that belong to the reference ones, shape ``(W, modes)``. Left-out terms, which are small,
        move them to first order: some would bring roots far above the band along."""
        motion = self._motion(speed)
        return self._with_terms(motion, speed, matched(spectrum(self.model, motion), reference))

    def modes(self, speed: float) -> ComplexArray:
        """Modes of the first rotor by itself that count, in order of frequency: in x and y one of each pair, and each
        once where no speed tells forward from backward."""
        found = eigenvalues(self.model, self.theta[0], speed)
        found = found[counted(self.model, found, self.band)]
        if self.model.frame == "xy" or not self.model.speed_dependent:
            found = found[found.imag >= 0]
        found = found[np.argsort(found.imag)]
        if self.model.speed_dependent or not found.size:
            return np.asarray(found)
        again = np.abs(np.diff(found)) < 1e-9 * np.abs(found[1:])  # but for round-off
        return np.asarray(found[np.concatenate([[True], ~again])])

    def least_decrement(self, speed: float) -> Float:
        """Logarithmic decrement of the least stable forward mode of each rotor, of all where no speed tells forward
        from backward, shape ``(W,)``."""
        reference = self.modes(speed)
        forward = whirl_sense(self.model, self.theta[0], speed, reference) >= 0
        forward |= not self.model.speed_dependent
        if not forward.any():
            return np.full(len(self.theta), np.inf)
        return np.asarray(decrement(self.eigenvalues(speed, reference)[:, forward]).min(axis=1))

    def growth(self, speed: float) -> Float:
        """Real part of the least stable eigenvalue up to the band of each rotor, shape ``(W,)``."""
        motion = self._motion(speed)
        s = spectrum(self.model, motion)
        inside = counted(self.model, s, self.band)
        rate = np.where(inside, s.real, -np.inf)
        least_stable = 4  # modes that may become the least stable one: two, in x and y each with its conjugate
        count = int(np.clip(inside.sum(axis=1).min(), 1, least_stable))
        least = np.take_along_axis(s, np.argsort(-rate, axis=1)[:, :count], axis=1)
        moved = self._with_terms(motion, speed, least).real.max(axis=1)
        return np.where(inside.any(axis=1), moved, -np.inf)

    def _with_terms(self, motion: ComplexArray, speed: float, s: ComplexArray) -> ComplexArray:
        """Eigenvalues ``(W, modes)`` moved by the left-out terms."""
        own = self._left_out
        return matched(eigenvalues_with(self.model, motion, speed, s, own), s) if own else s

    @property
    def _left_out(self) -> list[tuple[LeftOut, Float]]:
        """Terms of the equation of motion that the model leaves out, with their sizes ``(W,)``."""
        return [(term, size) for term, size in zip(self.terms, self.sizes.T, strict=True) if isinstance(term, LeftOut)]

    def at(self, speed: Float, some: slice = slice(None)) -> Float:
        """Parameter vectors at speeds ``(S,)``, shape ``(W, S, P)``, ``(W, 1, P)`` where they are the same at all."""
        theta = self.theta[some, None]
        at = theta
        for act, size in zip(self.terms, self.sizes[some].T, strict=True):
            values = None if isinstance(act, LeftOut) else act.values_at(self.model, theta, speed)
            if values is not None:
                at = at + size[:, None, None] * values
        return np.asarray(at)

    def _motion(self, speed: float) -> ComplexArray:
        """Coefficient matrices of free motion with the coupling, shape ``(W, order + 1, n, n)``."""
        model = self.model
        motion = np.array(model.motion(self.at(np.array([speed]))[:, 0], np.full(len(self.theta), speed)))
        at = np.arange(motion.shape[-1]) if model.shaft is None else model.shaft.at
        for plane, stiffness in self.coupling.items():
            for i, j, unit in _skew(model, plane):
                motion[:, 0, at[i], at[j]] += unit * stiffness
        return motion

    def response(self, speed: Float, plane: str, unbalance: Mapping[str, float]) -> Float:
        """Largest deflection, m, over a turn, by unbalances, kg m at planes, at speeds ``(S,)``; shape ``(W, S)``."""
        model = self.model
        force = np.zeros((speed.size, len(model.coordinates)), dtype=complex)
        for at, mr in unbalance.items():
            force += model.force_vector(at, speed, mr * speed**2)
        read = [i for i, c in enumerate(model.coordinates) if c.plane == plane and c.axis in "zxy"]
        weights = model.weights

        def largest(some: slice) -> Float:
            theta, s = self.at(speed, some), np.asarray(1j * speed)
            if weights is not None:
                values = model.line_terms(theta, s, force).values
                first, last = (_seen(weights, theta[:, 0], values, i) for i in (read[0], read[-1]))
            else:
                stiffness: ComplexArray = model.dynamic_stiffness(theta, speed, speed)
                stiffness = stiffness + self._added(s, speed, some)
                phasors = np.linalg.solve(stiffness, force[..., None])
                first, last = (np.asarray(phasors[..., i, 0], dtype=complex) for i in (read[0], read[-1]))
            # Major half-axis of the orbit, of phasors of z or of x and y.
            if len(read) == 1:
                return np.abs(first)
            return np.asarray(np.abs(first + 1j * last) + np.abs(first - 1j * last)) / 2

        return np.concatenate([largest(some) for some in self._blocks(speed.size)])

    def sensitivity(self, w: Float, speed: float, plane: str) -> Float:
        """Modulus of the sensitivity function of the force at a plane at frequencies ``(N,)``, shape ``(W, N)``.

        With kappa the stiffness of that force, H the receptance with it and G without it ``S = 1/(1 + G kappa)``, which
        is ``1 - H kappa``.
        """
        model, at, s = self.model, self.model.coordinate(plane, "z"), np.asarray(1j * w)
        speeds, blocks = np.full(w.size, speed), []
        for some in self._blocks(w.size):
            theta = self.at(np.array([speed]), some)
            stiffness: ComplexArray = model.dynamic_stiffness(theta, w, speeds)
            stiffness = stiffness + self._added(s, speeds, some)
            force = loop_stiffness(model, theta[:, 0], s, speed, plane)
            blocks.append(np.abs(1 - np.linalg.inv(stiffness)[..., at, at] * force))
        return np.concatenate(blocks)

    def _blocks(self, lines: int) -> Iterator[slice]:
        """Rotors that are computed together at some lines."""
        size = lines * (self.model.order + 1) * len(self.model.coordinates) ** 2
        step = max(_BLOCK // size, 1)
        return (slice(first, first + step) for first in range(0, len(self.theta), step))

    def _added(self, s: ComplexArray, speed: Float, some: slice) -> ComplexArray:
        """Dynamic stiffness of the terms and the coupling at the coordinates, shape ``(W, S, n, n)``."""
        size = len(self.model.coordinates)
        total = np.zeros((len(self.theta[some]), s.size, size, size), dtype=complex)
        for term, sizes in self._left_out:
            factor = sizes[some, None] * term.factor(s, speed)
            for i, j, weight in term.entries:
                total[..., i, j] += weight * factor
        for plane, stiffness in self.coupling.items():
            for i, j, unit in _skew(self.model, plane):
                total[..., i, j] += unit * stiffness[some, None]
        return total


def _seen(weights: Weights, theta: Float, values: ComplexArray, coordinate: int) -> ComplexArray:
    """What a coordinate does by sums of terms ``(W, T, S)`` of rotors ``(W, P)``, shape ``(W, S)``."""
    own = weights.of(theta, coordinate)
    return np.asarray((own[:, None] @ values[:, weights.seen(coordinate)])[:, 0])


def decrement(s: ComplexArray) -> Float:
    """Logarithmic decrement of eigenvalues; that of overdamped motion without oscillation is infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-2 * math.pi * s.real / np.abs(s.imag))


def _skew(model: RotorModel, plane: str) -> list[tuple[int, int, complex]]:
    """Entries of a unit cross-coupled stiffness, Kxy = -Kyx = 1, which is -j in complex coordinates."""
    if model.frame == "z":
        at = model.coordinate(plane, "z")
        return [(at, at, -1j)]
    x, y = model.coordinate(plane, "x"), model.coordinate(plane, "y")
    return [(x, y, 1.0), (y, x, -1.0)]


def has_planes(model: RotorModel) -> bool:
    """True if free motion is written in displacements of planes, and not in modes."""
    motion = model.motion(model.vector({q.name: q.scale for q in model.parameters}), 1.0)
    return model.shaft is not None or motion.shape[-1] == len(model.coordinates)


# ---- of a fit ----------------------------------------------------------------------------------------------------


def rotors_of(fit: FitResult, theta: Float, group: int, sizes: Float | None = None) -> Rotors:
    """Rotors by their parameters, shape ``(W, P)``, with the sizes of their causes, ``(W, k)``, by default as found.
    The damping of hysteresis is that of a forward whirl, which may become unstable."""
    model, solved = fit.model, fit.settings.solved
    alone = Rotors(
        model=model, band=fit.stability_band, theta=theta, coupling={}, terms=(), sizes=np.zeros((len(theta), 0))
    )
    if solved is None or not has_planes(model):
        return alone
    sizes = np.tile(solved.errors.value, (len(theta), 1)) if sizes is None else sizes
    onset = fit.onset(group)
    shifts = np.zeros(len(solved.causes)) if onset is None else onset_slopes(model, fit.thetas[group], onset, solved)
    terms: list[tuple[LeftOut | Act, int]] = []
    for number, cause in enumerate(solved.causes):
        term = cause.act.term(model, fit.thetas[group], 1.0)
        if term is not None:
            terms.append((term, number))
        elif cause.act.values_at(model, fit.thetas[group], 0.0) is not None:
            terms.append((cause.act, number))
    places = [number for _, number in terms]
    own = tuple(shifts[places].tolist())
    return replace(alone, terms=tuple(term for term, _ in terms), sizes=sizes[:, places], onset_shifts=own)


def unseen_rotors(fit: FitResult, group: int) -> Rotors:
    """Rotors that no datum tells from the fitted one, a tenth of the parameters' own sizes away."""
    null = fit.identifiability.null_space
    x = fit.x[: null.shape[0]] + null.T / 10
    return rotors_of(fit, fit.problem.space.theta(x)[:, group] if null.size else fit.thetas[:0, :], group)


def drawn_rotors(fit: FitResult, group: int, draws: int, thetas: Float | None = None) -> Rotors:
    """Rotors within the errors of a fit, or of a posterior's draws ``thetas`` of shape ``(W, P)``: values and causes
    together, with the tails of Student's t where an error has few degrees of freedom."""
    rng, solved = np.random.default_rng(0), fit.settings.solved
    sizes, moved = None, np.zeros((draws if thetas is None else len(thetas), fit.x.size))
    covar = fit.covar
    if solved is not None:
        sizes = solved.errors.drawn(len(moved), rng)
        moved = (sizes - solved.errors.value) @ solved.errors.moves.T
        covar = covar - solved.errors.covariance
    if thetas is not None:  # which hold what causes did to the values already
        return rotors_of(fit, thetas, group, sizes)
    errors = rng.normal(size=moved.shape) @ spreading(covar).T
    freedom = min((p.freedom for p in fit.params.values() if p.vary and p.resolved), default=math.inf)
    if math.isfinite(freedom):
        errors *= np.sqrt(freedom / rng.chisquare(freedom, size=(draws, 1)))
    return rotors_of(fit, np.asarray(fit.problem.space.theta(fit.x + errors + moved)[:, group]), group, sizes)
