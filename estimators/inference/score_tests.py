"""Score tests of terms that a model leaves out: one more column of the Jacobian each, and no fit.

Near the estimate the whitened residuals are ``r + J dx + c t`` with ``c`` what one unit of a left-out term does to the
predictions. The part of ``c`` that the fitted parameters cannot take up determines ``t``; the rest of ``c`` is how far
the estimate moves with it (the score, or Lagrange multiplier, test of Rao 1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, ComplexArray, Float, Index
from rotorfit.estimators.blocks.nonlinear import OrbitResponses, responses_of
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.small_motion import FreeVibrations, OffCentreResponses
from rotorfit.estimators.inference.smooth_causes import Cause, Motion, cause_change, load_change, whitened
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.motion.neglected_terms import LeftOut


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Score tests of left-out terms, one entry each, taken one by one."""

    estimate: Float  # size of the term that the residuals ask for, in its units; NaN where parameters take up all of it
    stderr: Float  # its standard error, infinite there
    shift: Float  # change of the fitted vector by one unit of the term, shape ``(T, p)``


def score_tests(residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float) -> Scores:
    """Test terms that are left out of a model, and tell how far each would move the estimate."""
    r, c, J = _stacked(residuals, jacobian, columns, priors)
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 0, size, 1.0)
    left, singular, right = np.linalg.svd(J / size, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular.max(initial=0.0)
    within = left[:, kept].T @ c
    taken = (right[kept].T / singular[kept]) @ within / size[:, None]
    rest = c - left[:, kept] @ within
    whole, free = np.linalg.norm(c, axis=0), np.linalg.norm(rest, axis=0)
    seen = free > np.sqrt(RANK_TOLERANCE) * whole
    power = np.where(seen, free, 1.0) ** 2
    return Scores(
        estimate=np.where(seen, -(rest.T @ r) / power, np.nan),
        stderr=np.where(seen, 1.0 / np.sqrt(power), np.inf),
        shift=-taken.T,
    )


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Share of the residuals that groups of columns explain beside the fitted parameters, one entry a group."""

    gain: Float  # fall of the sum of squares
    rank: Float  # columns that parameters do not take up
    square: float  # sum of squares without any
    freedom: int  # its degrees of freedom


def joint_gains(
    residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float, groups: Sequence[Index]
) -> Gains:
    """Sums of squares that groups of columns explain, each group on its own."""
    r, c, J = _stacked(residuals, jacobian, columns, priors)
    left = _basis(J)
    rest, whole = c - left @ (left.T @ c), np.linalg.norm(c, axis=0)
    r = r - left @ (left.T @ r)
    seen = np.linalg.norm(rest, axis=0) > np.sqrt(RANK_TOLERANCE) * whole
    bases = [_basis(rest[:, own[seen[own]]]) for own in groups]
    return Gains(
        gain=np.array([float(np.sum((basis.T @ r) ** 2)) for basis in bases]),
        rank=np.array([float(basis.shape[1]) for basis in bases]),
        square=float(r @ r),
        freedom=2 * residuals.size - left.shape[1],
    )


def _basis(columns: Float) -> Float:
    """Orthonormal basis of what columns span."""
    size = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(left[:, singular > RANK_TOLERANCE * singular.max(initial=0.0)])


def _stacked(
    residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, priors: Float
) -> tuple[Float, Float, Float]:
    """Residuals, columns and derivatives as real numbers, with a row for each prior."""
    known = np.zeros((priors.size, columns.shape[1]))
    J = np.concatenate([jacobian.real, jacobian.imag, np.diag(np.sqrt(priors))])
    c = np.concatenate([columns.real, columns.imag, known])
    return np.concatenate([residuals.real, residuals.imag, np.zeros(priors.size)]), c, J


@dataclass(frozen=True, kw_only=True)
class Offset:
    """A probe or a force that is not at its plane, but a share of the way towards another."""

    kind: str  # "probe" or "force"
    at: int  # coordinate at which it is taken to be
    towards: int  # coordinate towards which it lies


@dataclass(frozen=True)
class Clearance:
    """The radial clearance that a model with a law of eccentricity takes as known; its size is a share of it."""


@dataclass(frozen=True, kw_only=True)
class Gain:
    """A gain that all readings share, of the force or of the chain, or those of one coordinate; its size is a share."""

    at: int | None = None  # coordinate


@dataclass(frozen=True, kw_only=True)
class Rest:
    """A journal that rests off centre. A model without a law of eccentricity sees the fluid of that place."""

    change: Float  # of the parameters by one unit of eccentricity, from that place to the centre, shape ``(P,)``
    eccentricity: float  # of which that is the secant


Term: TypeAlias = LeftOut | Offset | Clearance | Gain | Rest | Cause | int
"""A term of the equation of motion, an offset, the clearance, a gain, the place at rest, a smooth cause by a unit of
its size, or the place of a known parameter of the model."""


def whitened_columns(problem: Problem, x: Float, terms: Sequence[Term]) -> ComplexArray:
    """Derivatives of the whitened residuals by terms left out, shape ``(R, T)``."""

    def changes(block: Block, theta: Float) -> ComplexArray:
        return np.array([term_change(block, theta, term) for term in terms]).reshape(len(terms), block.measured.size)

    return whitened(problem, x, changes)


def is_linear(block: Block) -> bool:
    """True if a block holds responses of a linear rotor to circular forces, which left-out terms act on."""
    base = responses_of(block)
    return isinstance(base, Responses) and not isinstance(block, OrbitResponses) and not base.imposed


def _resized(block: Block, factor: float) -> Block:
    """A block in a bearing of another clearance, positions in metres kept; eccentricities that were given stay."""
    if not isinstance(block, OrbitResponses | OffCentreResponses | FreeVibrations):
        return block
    model = block.model.variant(clearance_um=1e6 * factor * (block.model.clearance or 0.0))
    eccentricity = block.eccentricity / factor
    if isinstance(block, OrbitResponses):
        return replace(block, base=replace(block.base, model=model), eccentricity=eccentricity)
    if isinstance(block, FreeVibrations):
        eccentricity = np.where(block.position_read, eccentricity, block.eccentricity)
    return replace(block, model=model, eccentricity=eccentricity)


def term_change(block: Block, theta: Float, term: Term) -> ComplexArray:
    """Change of the predictions of a block by a unit of a term, shape ``(R,)``."""
    if isinstance(term, Cause):
        return cause_change(block, theta, term)
    step = 1e-4  # share of the clearance for a central difference: truncated at 1e-8, rounded at 1e-12
    base = responses_of(block)
    change: ComplexArray = np.zeros(block.measured.size, dtype=complex)
    if isinstance(term, int):
        change = block.predict_jacobian(theta)[1][:, term]
    elif isinstance(term, Clearance):
        up, down = (_resized(block, 1 + sign * step).predict(theta) for sign in (1, -1))
        change = (up - down) / (2 * step)
    elif isinstance(term, Rest) and isinstance(block, OrbitResponses):
        load = term.eccentricity / float(block.compliance(theta).mean())  # that moves the journal there
        change = load_change(block, theta, load) / term.eccentricity
    elif isinstance(term, Gain) and base is not None:
        change = np.where(term.at is None or base.coordinate == term.at, block.predict(theta), 0.0)
    elif isinstance(term, Rest) and is_linear(block):
        change = -block.predict_jacobian(theta)[1] @ term.change
    elif isinstance(term, LeftOut | Offset) and base is not None and is_linear(block):
        change = _linear_change(Motion(base=base, theta=theta), term)
    return np.asarray(change)


def _linear_change(motion: Motion, term: LeftOut | Offset) -> ComplexArray:
    base, H, amplitude = motion.base, motion.receptance, motion.planes
    line, read = base.line, base.coordinate
    if isinstance(term, LeftOut):
        factor = term.factor(base.s, base.speed)
        pressed = np.zeros_like(amplitude)
        for i, j, weight in term.entries:
            pressed[:, i] += weight * factor * amplitude[:, j]
        change = -np.einsum("lij,lj->li", H, pressed)[line, read]
    elif term.kind == "probe":
        change = np.where(read == term.at, amplitude[line, term.towards] - amplitude[line, term.at], 0.0)
    else:
        change = (base.force[:, term.at, None] * (H[:, :, term.towards] - H[:, :, term.at]))[line, read]
    return np.asarray(change * motion.factors)
