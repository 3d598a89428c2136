"""State of one minimisation: the objective made dimensionless, the best point, and the judgement of convergence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ROUND_OFF
from rotorfit.estimators.minimisation.objective import HessianKind, Matrix, Objective, Options, Status, Vector

HANDOVER_OFFSET = 1e-3  # relative offset, its square the relative excess cost, at which refinement takes over
COST_FLOOR = 1e-40  # of the starting cost: keeps the logarithm finite on zero-residual problems


@dataclass(frozen=True)
class _Point:
    """One evaluation with derivatives, in scaled variables and divided by the cost (so cost = 1)."""

    u: Vector
    cost: float
    gradient: Vector
    matrix: Matrix


def solve_symmetric(matrix: Matrix, right: Vector) -> Vector:
    """Solution of a symmetric system, of one right side ``(n,)`` or several ``(n, k)``; of smallest norm where the
    matrix is not definite, or by round-off only."""
    try:  # positive definite? LAPACK's dposv does both at once, but importing it from SciPy takes as long as a fit
        pivots = np.linalg.cholesky(matrix).diagonal() ** 2
        if (pivots <= ROUND_OFF * matrix.diagonal()).any():  # the quotient of two round-offs is no step
            raise np.linalg.LinAlgError
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        solution = np.full_like(right, np.nan)
    if math.isfinite(float(solution.sum())):
        return np.asarray(solution)
    # Unit diagonal first, so that what counts as singular does not depend on the units.
    scale = 1 / np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
    unit = matrix * scale[:, None] * scale
    if not math.isfinite(float(unit.sum())):
        return np.full_like(right, np.nan)
    values, vectors = np.linalg.eigh(unit)
    keep = values > ROUND_OFF
    weights = np.zeros_like(values)
    weights[keep] = 1 / values[keep]
    inverse = (scale[:, None] * vectors * weights) @ (vectors.T * scale)
    return np.asarray(inverse @ right)


@dataclass(frozen=True)
class _Candidate:
    """A point, the Gauss-Newton step that remains from it and the relative size of that step."""

    point: _Point
    step: Vector
    offset: float


class Minimisation:
    """State of one minimisation: the objective in scaled variables, the best point, the progress."""

    def __init__(
        self, objective: Objective, start: Vector, bounds: tuple[Vector, Vector], scale: Vector, options: Options
    ) -> None:
        self.objective = objective
        self.options = options
        self.lower, self.upper = bounds
        self.scale = scale
        self.low, self.high = self.lower / scale, self.upper / scale
        self.kind: HessianKind = "exact" if options.hessian == "exact" else "gauss-newton"
        self.error: BaseException | None = None
        self.n_iterations = 0
        self.n_evaluations = 0
        self.reference = 0.0  # cost at the start
        self.point: _Point | None = None  # last evaluation with derivatives
        self.history: list[tuple[float, float]] = []  # (cost, offset) of the iterates of this descent
        self._key = b""
        self.start = start / scale
        self.best = _Candidate(_Point(self.start, math.inf, self.start, np.eye(start.size)), self.start, math.inf)

    # -- evaluation ---------------------------------------------------------------------------------------

    def unscaled(self, u: Vector) -> Vector:
        """The caller's variables; clipped because Ipopt may leave a bound by a rounding error."""
        return np.clip(u * self.scale, self.lower, self.upper)

    def unit(self, cost: float) -> float:
        """Divisor of derivatives: the cost, kept from zero."""
        return max(cost, COST_FLOOR * self.reference) or 1.0

    def evaluate(self, u: Vector) -> _Point | None:
        """The objective with derivatives at ``u``, from memory if asked twice; None where undefined."""
        key = u.tobytes()
        if key == self._key:
            return self.point
        self._key, self.point = key, None
        self.n_evaluations += 1
        cost, gradient, matrix = self.objective.gauss_newton(self.unscaled(u))
        cost = float(cost)
        if not math.isfinite(cost + float(gradient.sum()) + float(matrix.sum())):
            return None
        if cost < 0:
            raise ValueError(f"the objective returned the cost {cost}; a cost must not be negative")
        unit = self.unit(cost)
        scale = self.scale
        self.point = _Point(u.copy(), cost, gradient * (scale / unit), matrix * (scale[:, None] * (scale / unit)))
        return self.point

    def value(self, u: Vector) -> float:
        """Logarithm of the cost over that of the start; most trials of a line search are accepted: derivatives too."""
        point = self.evaluate(u)
        # The constant keeps the function away from zero: Ipopt's allowance for round-off is relative to it.
        return math.nan if point is None else 10.0 + math.log(max(point.cost / self.reference, COST_FLOOR))

    def gradient(self, u: Vector) -> Vector | None:
        """Gradient of the logarithm of the cost."""
        point = self.evaluate(u)
        return None if point is None else point.gradient

    def hessian(self, u: Vector) -> Matrix | None:
        """Hessian of the cost over the cost: with it the Newton step is that of the cost itself."""
        point = self.evaluate(u)
        if point is None:
            return None
        return point.matrix if self.kind == "gauss-newton" else self._exact_hessian(point)

    def _exact_hessian(self, point: _Point) -> Matrix:
        """Exact Hessian at a point, scaled like its Gauss-Newton matrix."""
        unit = self.unit(point.cost)
        return np.asarray(self.objective.hessian(self.unscaled(point.u))) * (self.scale[:, None] * (self.scale / unit))

    # -- convergence ---------------------------------------------------------------------------------------

    def _newton_step(self, point: _Point, matrix: Matrix) -> Vector:
        """Step to the minimum of the local quadratic model inside the bounds, gᵀd + dᵀHd/2 for low <= d <= high, by
        correcting a guess of the bounds it rests on."""
        gradient, low, high = point.gradient, self.low - point.u, self.high - point.u
        step = solve_symmetric(matrix, -gradient)
        if not ((step < low) | (step > high)).any():
            return step
        # An interior-point iterate is near its bounds, not on them: those near and pressed on start the guess.
        near = 1e-3 * np.abs(step)
        at_low, at_high = (low >= -near) & (gradient > 0), (high <= near) & (gradient < 0)
        for _ in range(2 * gradient.size):
            free = np.flatnonzero(~(at_low | at_high))
            step = np.where(at_low, low, np.where(at_high, high, 0.0))
            if free.size:
                right = -gradient[free] - matrix[free] @ step
                step[free] = solve_symmetric(matrix[np.ix_(free, free)], right)
            slope = gradient + matrix @ step
            low_next = (at_low & (slope > 0)) | (step < low)
            high_next = (at_high & (slope < 0)) | (step > high)
            if (low_next == at_low).all() and (high_next == at_high).all():
                break
            at_low, at_high = low_next, high_next
        return np.clip(step, low, high)

    def assess(self, point: _Point) -> _Candidate:
        """The step that remains, relative to the misfit or to the parameters, whichever is smaller."""
        step = self._newton_step(point, point.matrix)
        gain = -float(point.gradient @ step) - float(step @ point.matrix @ step) / 2  # linear towards a bound
        offset = math.sqrt(max(gain, 0.0))
        least_size = 1e-3  # of a scaled variable, against which its change is judged
        change = float((np.abs(step) / np.maximum(np.abs(point.u), least_size)).max())
        change_weight = 100.0  # a relative change of the parameters must be this much smaller than an offset
        return _Candidate(point, step, min(offset, change_weight * change))

    def keep(self, candidate: _Candidate) -> None:
        """Remember the better of two points: smaller cost, or the smaller offset at equal cost."""
        best = self.best
        slack = ROUND_OFF * best.point.cost
        gain = best.point.cost - candidate.point.cost
        if gain > slack or (gain >= -slack and candidate.offset < best.offset):
            self.best = candidate

    def monitor(self) -> bool:
        """Called once per Ipopt iteration; True ends the descent."""
        if self.point is None:
            return False
        candidate = self.assess(self.point)
        self.keep(candidate)
        self.history.append((candidate.point.cost, candidate.offset))
        self.n_iterations += len(self.history) > 1
        enough = HANDOVER_OFFSET if self.kind == "gauss-newton" else self.options.acceptable
        return candidate.offset <= enough or self.exhausted() or self.stuck()

    def exhausted(self) -> bool:
        """True if the iterations allowed are used up."""
        return self.n_iterations >= self.options.max_iterations

    def stuck(self) -> bool:
        """True if the last iterations brought nothing, or little enough to try the exact Hessian."""
        window = 6  # iterations over which progress is judged
        if len(self.history) <= window:
            return False
        (cost_then, offset_then), (cost, offset) = self.history[-1 - window], self.history[-1]
        if cost_then - cost <= ROUND_OFF * cost_then and offset > 0.1 * offset_then:
            return True
        slow = cost > 0.9 * cost_then and offset > 0.1 * offset_then
        return slow and self.kind == "gauss-newton" and self.options.hessian == "auto"

    def approach(self) -> None:
        """Undamped Gauss-Newton steps from the best point while each lowers the cost and most of the offset."""
        largest_offset = 0.5  # relative offset from which Gauss-Newton steps without a line search are tried first
        slow_share = 0.3  # share of the offset that one of them may leave
        for _ in range(6):
            before = self.best
            if not HANDOVER_OFFSET < before.offset <= largest_offset or self.kind == "exact" or self.exhausted():
                return
            point = self.evaluate(np.clip(before.point.u + before.step, self.low, self.high))
            self.n_iterations += 1
            if point is None or point.cost > before.point.cost:
                return
            candidate = self.assess(point)
            self.keep(candidate)
            if candidate.offset > slow_share * before.offset:
                return

    def descend(self, enough: float = HANDOVER_OFFSET) -> None:
        """Gauss-Newton steps down to an offset, shortened after Marquardt where one does not lower the cost."""
        least, most = 1e-6, 1e12  # damping, in units of the diagonal of the Gauss-Newton matrix
        damping = 0.0
        while self.best.offset > enough and damping <= most and not self.exhausted():
            before = self.best
            diagonal = before.point.matrix.diagonal()
            matrix = before.point.matrix + np.diag(damping * np.where(diagonal > 0, diagonal, 1.0))
            step = self._newton_step(before.point, matrix)
            point = self.evaluate(np.clip(before.point.u + step, self.low, self.high))
            self.n_iterations += 1
            if point is not None:
                self.keep(self.assess(point))
            smaller = damping / 10 if damping > least else 0.0
            damping = max(10 * damping, least) if self.best is before else smaller

    def refine(self) -> None:
        """Undamped Newton steps from the best point while each pays; exact Hessian once the first is slow."""
        exact = self.kind == "exact"
        slow_share = 0.1  # share of the offset that one of them may leave before the exact Hessian is asked
        cost_noise = 1e-9  # relative rise of the cost that refinement tolerates: residuals far below the data are noisy
        for _ in range(8):
            before = self.best
            if not self.options.tolerance < before.offset <= HANDOVER_OFFSET or self.exhausted():
                return
            step = self._newton_step(before.point, self._exact_hessian(before.point)) if exact else before.step
            point = self.evaluate(np.clip(before.point.u + step, self.low, self.high))
            self.n_iterations += 1
            allowed = before.point.cost * (1 + cost_noise) + COST_FLOOR * self.reference
            if point is not None and point.cost <= allowed:
                candidate = self.assess(point)
                if candidate.offset < before.offset:
                    self.best = candidate
            ratio = self.best.offset / before.offset
            if exact and ratio > 0.5:
                return
            exact = exact or (ratio > slow_share and self.options.hessian == "auto")

    def converged(self) -> bool:
        """True if the best point is a minimum within the tolerances."""
        best = self.best
        return best.offset <= self.options.acceptable or best.point.cost <= COST_FLOOR * self.reference

    def singular_throughout(self) -> bool:
        """True if some change of the parameters leaves all residuals unchanged, and so it was at the start already, in
        as many directions: the data see none of them anywhere."""
        first = self.evaluate(self.start)
        return first is not None and 0 < self._unseen(self.best.point) <= self._unseen(first)

    def _unseen(self, point: _Point) -> int:
        """Directions, away from the bounds, that leave all residuals unchanged."""
        free = (point.u > self.low) & (point.u < self.high)
        diagonal = point.matrix.diagonal()
        dead = free & ~(diagonal > 0)
        seen = free & ~dead
        matrix, size = point.matrix, np.sqrt(diagonal[seen])
        if size.size < free.size:
            matrix = matrix[np.ix_(seen, seen)]
        matrix = matrix / size[:, None] / size
        return int(dead.sum()) + int((np.linalg.eigvalsh(matrix) < ROUND_OFF).sum())

    def status(self) -> Status:
        """How the run stands."""
        if self.converged():
            return Status.SINGULAR if self._unseen(self.best.point) else Status.CONVERGED
        return Status.ITERATION_LIMIT if self.exhausted() else Status.STALLED
