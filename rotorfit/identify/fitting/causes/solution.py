"""Causes solved with the fitted values: Gauss-Newton steps on both, columns worked out anew at each point."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.significance import OPEN_ERRORS
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.estimators.inference.causes import Cause, columns, with_causes
from rotorfit.estimators.inference.covariance import prior_curvature, prior_slope
from rotorfit.estimators.inference.joint_errors import JointErrors, error_factor, joint_step
from rotorfit.estimators.inference.linear_causes import LinearCauses
from rotorfit.estimators.misfit.problem import Problem, robust_weights
from rotorfit.estimators.noise.run_effects import inverse_of_determined
from rotorfit.identify.fitting.causes.calibration import Calibration
from rotorfit.identify.fitting.causes.listing import listed


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedCauses:
    """Causes of a fit as they were solved with its values."""

    causes: tuple[Cause, ...]
    errors: JointErrors
    shift: tuple[ComplexArray, ...]  # what they add to the predictions of each block, shape ``(R,)``
    plain: Float  # fitted vector without causes
    plain_square: float  # sum of squares there
    raised: tuple[str, ...] = ()  # causes whose sizes were too small for what the data show, and were raised to that
    factor: float = 1.0  # on all sizes, which are too small as a whole

    def __iter__(self) -> Iterator[tuple[Cause, float, float]]:
        """Each cause with its size and its standard deviation."""
        return zip(self.causes, self.errors.value.tolist(), self.errors.deviation.tolist(), strict=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class JointSearch:
    """Where a search of fitted values and causes ended."""

    problem: Problem  # with the effect of the causes taken out of its readings
    x: Float
    causes: tuple[Cause, ...]
    sizes: Float  # of the causes
    J: ComplexArray  # derivatives of the whitened residuals by the fitted vector where the causes act, shape ``(R, p)``
    columns: ComplexArray  # likewise by a unit of each cause, shape ``(R, k)``
    shift: tuple[ComplexArray, ...]
    plain: Float  # fitted vector without causes
    plain_square: float  # sum of squares there
    square: float  # sum of squares with them, what is known of them before the data included
    missed: float  # square by which the residuals miss those that the derivatives promised
    raised: tuple[str, ...] = ()  # as of :class:`SolvedCauses`
    factor: float = 1.0  # likewise

    @property
    def before(self) -> Float:
        """Standard uncertainties of the causes before the data."""
        return np.array([cause.size for cause in self.causes])

    def solved(self, errors: JointErrors) -> SolvedCauses:
        """The causes as a fit keeps them, with the errors that they leave."""
        return SolvedCauses(
            causes=self.causes,
            errors=errors,
            shift=self.shift,
            plain=self.plain,
            plain_square=self.plain_square,
            raised=self.raised,
            factor=self.factor,
        )

    def errors(self, widening: float) -> JointErrors:
        """The errors that the causes leave. ``widening``: variance of the residuals over that of the noise. Noise that
        is larger than given weighs the data less. A misfit that no listed cause explains widens all errors alike, lest
        causes be found that are not there."""
        if widening > UNLISTED:
            return replace(self.weighed, widened=widening)
        return self.weighed if widening == 1 else self.weighed.in_noise(widening)

    @cached_property
    def weighed(self) -> JointErrors:
        """The errors where the noise is what the problem takes it for, by the derivatives where the causes act: beside
        those of the rotor without them, what the fitted values take up would seem to be told by the data."""
        r = self.problem.residuals(self.x)
        root = np.sqrt(robust_weights(self.problem.loss, np.abs(r) ** 2)[1])
        r, J, B = r - self.columns @ self.sizes, self.J, self.columns
        if (root != 1).any():
            r, J, B = r * root, J * root[:, None], B * root[:, None]
        information = np.asarray((J.conj().T @ J).real) + np.diag(prior_curvature(self.problem, self.x))
        found = JointErrors.of(
            r,
            J,
            B,
            inverse=inverse_of_determined(information)[0],
            size=self.before,
            one_sided=np.array([cause.one_sided for cause in self.causes]),
            runs=_few_runs(self.problem, self.x, root),
        )
        # The sizes that go with the fitted values: along what nothing determines, others are as good.
        return replace(found, free=self.sizes)


def _few_runs(problem: Problem, x: Float, root: Float) -> ComplexArray | None:
    """Changes of the residuals by what each of a few runs may differ by, its gain and the angle of its mark, shape
    ``(R, m)``; nothing for one run and for many, whose differences the residuals tell."""
    few = 12  # runs up to which an effect of theirs may pass for a cause; of more its scatter tells it. Chosen.
    names, number = words(problem.run)
    if not 2 <= len(names) <= few or len(problem.responses) < len(problem.blocks):
        return None
    whitened = np.concatenate(problem.predict(x)) / problem.sigma * root
    by_phase = np.concatenate([block.by_phase for block in problem.responses]) * whitened
    columns = np.zeros((2 * len(names), whitened.size), dtype=complex)
    rows = np.arange(whitened.size)
    columns[number, rows], columns[number + len(names), rows] = RUN_GAIN * whitened, RUN_ANGLE * by_phase
    return columns.T


RUN_GAIN, RUN_ANGLE = 0.005, math.radians(0.5)
"""Standard deviations by which repeats of a run differ in gain and angle: measured, 0.3 to 1 % of 3 to 13 um."""
NEGLIGIBLE = 0.01
"""Square by which residuals may miss those that the derivatives promise: a tenth of a standard error of any result."""
NOISE_LIKE = 0.2
"""The same over the scatter of the sum of squares, where the residuals are only to be studied. Chosen."""
UNLISTED = 1.3
"""Mean square of residuals from which no listed cause explains the misfit. Chosen."""


def search(
    problem: Problem,
    x: Float,
    given: Mapping[str, float],
    calibration: Calibration | None = None,
    *,
    begin: JointSearch | None = None,
    for_noise: bool = False,
) -> JointSearch | None:
    """Solve for causes beside fitted values from their optimum without any; nothing where the list is empty.

    A size that is too small for what the data show holds the estimate back: it is raised to what was found, and all
    are where they are too small as a whole. Of a misfit that no listed cause explains nothing is concluded.

    Args:
        problem: what is fitted.
        x: fitted vector without causes.
        given, calibration: as for :func:`~rotorfit.identify.fitting.causes.listing.listed`.
        begin: where another search ended: effects of runs, which would pass for causes at their optimum without any,
            are to be solved about it.
        for_noise: solve only as closely as a study of the residuals asks for.
    """
    causes = listed(problem, x, given, calibration)
    if not causes:
        return None
    known = None
    if begin is not None:
        before = {cause.name: size for cause, size in zip(begin.causes, begin.sizes.tolist(), strict=True)}
        known = begin.x, np.array([before.get(cause.name, 0.0) for cause in causes])
    near = NOISE_LIKE * math.sqrt(2 * problem.n_data) if for_noise else NEGLIGIBLE
    found = _solved(problem, x, causes, near, known)
    raised: dict[str, None] = {}
    for _ in range(3):
        errors = found.weighed
        if found.square > UNLISTED * (problem.n_data - x.size):
            break
        pulled = np.abs(np.nan_to_num(errors.pull)) > OPEN_ERRORS
        if not pulled.any():
            break
        raised |= dict.fromkeys(np.array([cause.name for cause in causes])[pulled].tolist())
        sizes = np.where(pulled, np.abs(errors.value), [cause.size for cause in causes]).tolist()
        causes = tuple(replace(cause, size=size) for cause, size in zip(causes, sizes, strict=True))
        found = _solved(problem, x, causes, near, (found.x, found.sizes))
    told = errors.determined > 0.3  # which the data tell well enough for their pulls to say something
    factor = error_factor(errors.pull[told].tolist()) if found.square <= UNLISTED * (problem.n_data - x.size) else 1.0
    if factor > 1:
        causes = tuple(replace(cause, size=factor * cause.size) for cause in causes)
        found = _solved(problem, x, causes, near, (found.x, found.sizes))
    return replace(found, raised=tuple(raised), factor=factor) if raised or factor > 1 else found


def _solved(
    problem: Problem, x: Float, causes: tuple[Cause, ...], near: float, known: tuple[Float, Float] | None = None
) -> JointSearch:
    """Gauss-Newton steps on fitted values and causes, from where they are known to be close to, or from none, until the
    residuals are those that the derivatives promised but for a square of ``near``. What one more step would gain is at
    most that."""
    size = np.array([cause.size for cause in causes])
    one_sided = np.array([cause.one_sided for cause in causes])
    at = begin = _Point.of(problem, x, causes, np.zeros(size.size), size)
    if known is not None:
        close = _Point.of(problem, known[0], causes, known[1], size)
        at = close if close.square < begin.square else begin
    told, left = None, math.inf
    # Mostly one or two; many more would let the search wander along what nothing determines.
    for _ in range(6):
        B, (r, J) = columns(at.problem, at.x, causes), at.problem.jacobian(at.x)
        curvature, slope = prior_curvature(problem, at.x), prior_slope(problem, at.x)
        if told is None:
            told = _told(J, curvature) if at is begin else _told(problem.jacobian(x)[1], prior_curvature(problem, x))
        J = (told.T @ J.T).T
        root = np.sqrt(robust_weights(problem.loss, np.abs(r) ** 2)[1])
        dx, sizes, square = joint_step(
            (r - B @ at.sizes) * root,
            J * root[:, None],
            B * root[:, None],
            size=size,
            one_sided=one_sided,
            prior=curvature,
            prior_slope=slope,
        )
        now = float(np.sum(np.abs(r * root) ** 2) + np.sum((at.sizes / size) ** 2) - (2 * slope + curvature * dx) @ dx)
        ahead = _accepted(problem, at, causes, dx, sizes - at.sizes, size)
        if ahead is None:
            left = 0.0
            break
        missed = (ahead.residuals - r - J @ dx - B @ (sizes - at.sizes)) * root
        at, left = ahead, min(now - square, float(np.vdot(missed, missed).real))
        if left < near:
            break
    plain = problem.predict(at.x)
    shift = tuple(
        found - alone - (own.measured - block.measured)
        for found, alone, own, block in zip(
            at.problem.predict(at.x), plain, at.problem.blocks, problem.blocks, strict=True
        )
    )
    return JointSearch(
        problem=shifted(problem, shift), x=at.x, causes=causes, sizes=at.sizes, J=J,
        columns=B, shift=shift, plain=x, plain_square=begin.square, square=at.square, missed=left,
    )  # fmt: skip


def _told(J: ComplexArray, curvature: Float) -> Float:
    """Projection of the fitted vector onto what the data tell where no cause acts, shape ``(p, p)``. A cause may make
    alike values act apart, but says nothing of them: it is not known itself."""
    information = np.asarray((J.conj().T @ J).real) + np.diag(curvature)
    return np.asarray(inverse_of_determined(information)[0] @ information)


def solved_before(problem: Problem, x: Float, solved: SolvedCauses) -> JointSearch:
    """Causes that were solved already, beside fitted values of the problem with their effect taken out."""
    acting = with_causes(problem, x, solved.causes, solved.errors.value)
    J = acting.jacobian(x)[1] @ _told(problem.jacobian(x)[1], prior_curvature(problem, x))
    return JointSearch(
        problem=problem, x=x, causes=solved.causes, sizes=solved.errors.value, J=J,
        columns=columns(acting, x, solved.causes), shift=solved.shift, plain=solved.plain,
        plain_square=solved.plain_square, square=math.nan, missed=0.0, raised=solved.raised, factor=solved.factor,
    )  # fmt: skip


def not_found_yet(problem: Problem, x: Float, causes: tuple[Cause, ...]) -> SolvedCauses:
    """Causes that readings will be solved with which are as the fitted values predict them: none is found, and the
    errors are those that a fit of such readings prints."""
    none, same = np.zeros(len(causes)), tuple(np.zeros_like(block.measured) for block in problem.blocks)
    J = problem.jacobian(x)[1]
    ahead = JointSearch(
        problem=problem, x=x, causes=causes, sizes=none, J=J @ _told(J, prior_curvature(problem, x)),
        columns=columns(problem, x, causes), shift=same, plain=x, plain_square=0.0, square=0.0, missed=0.0,
    )  # fmt: skip
    return SolvedCauses(causes=causes, errors=ahead.errors(1.0), shift=same, plain=x, plain_square=0.0)


def linear_causes(problem: Problem, x: Float, solved: SolvedCauses) -> LinearCauses:
    """The causes to first order about the joint optimum, as wide as the errors have them. The columns are of the same
    predictions as the Jacobian of the problem, which has the causes taken out: what both take up alike must cancel."""
    size = solved.errors.size
    found = LinearCauses(
        columns=columns(problem, x, solved.causes) * size,
        at=solved.errors.value / size,
        size=size,
        one_sided=solved.errors.one_sided,
    )
    return found.wider(math.sqrt(solved.errors.widened))


def shifted(problem: Problem, shift: Sequence[ComplexArray]) -> Problem:
    """The problem with what causes add to the predictions taken out of its readings."""
    if [np.shape(part) for part in shift] != [b.measured.shape for b in problem.blocks]:
        raise ValueError("what its causes add to the readings is not of as many readings as the data have")
    blocks = (b.with_measured(b.measured - part) for b, part in zip(problem.blocks, shift, strict=True))
    return replace(problem, blocks=tuple(blocks))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Point:
    """Fitted values and sizes, the problem with these causes, and the sum of squares there."""

    problem: Problem
    x: Float
    sizes: Float
    residuals: ComplexArray
    square: float

    @classmethod
    def of(cls, problem: Problem, x: Float, causes: Sequence[Cause], sizes: Float, before: Float) -> _Point:
        """Evaluate."""
        own = with_causes(problem, x, causes, sizes)
        residuals = own.residuals(x)
        rho = robust_weights(problem.loss, np.abs(residuals) ** 2)[0]
        priors = sum(2 * float(prior.terms(float(x[prior.entry]))[0]) for prior in problem.priors)
        square = float(rho.sum()) + float(np.sum((sizes / before) ** 2)) + priors
        return cls(problem=own, x=x, sizes=sizes, residuals=residuals, square=square)


def _accepted(
    problem: Problem, at: _Point, causes: Sequence[Cause], dx: Float, dc: Float, before: Float
) -> _Point | None:
    """The point after a step, or a share of it, that lowers the sum of squares; nothing where none does."""
    space, share = problem.space, 1.0
    for _ in range(6):
        x = np.clip(at.x + share * dx, space.lower, space.upper)
        ahead = _Point.of(problem, x, causes, at.sizes + share * dc, before)
        if np.isfinite(ahead.square) and ahead.square < at.square:
            return ahead
        share /= 4
    return None
