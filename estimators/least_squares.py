"""Nonlinear least squares with CasADi's Ipopt, driven by numerical callbacks.

The objective is a plain Python object that returns numbers: the cost (half a sum of squares, or its robust
counterpart), its gradient and the Gauss-Newton matrix.  Ipopt does the descent; this module makes the problem
dimensionless, decides when it is solved, and reports in words how it ended.

Three choices matter for anyone reading the code:

* Ipopt minimises the *logarithm* of the cost.  For half a sum of squares this is the concentrated Gaussian
  likelihood; the Newton direction is unchanged, and every tolerance, line-search and barrier constant of
  Ipopt becomes relative to the current misfit instead of to the misfit of the starting guess.
* Convergence is judged by the relative offset of Bates and Watts: the length, measured in residual space, of
  the step that remains to the minimum of the local quadratic model inside the bounds, divided by the length
  of the residual vector.  It does not depend on the units of the data or of the parameters.
* Close to the minimum cost differences drown in round-off, and no line search can rank two points.  Ipopt is
  therefore stopped once the cost is within a millionth of its minimum; the last digits come from undamped
  Newton steps, accepted only while the offset keeps shrinking.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Literal, Protocol, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dposv

__all__ = ["Objective", "Options", "Solution", "Status", "SymbolicResiduals", "minimise"]

Vector: TypeAlias = NDArray[np.float64]
Matrix: TypeAlias = NDArray[np.float64]
HessianKind: TypeAlias = Literal["gauss-newton", "exact"]

_HANDOVER = 1e-3  # relative offset, its square the relative excess cost, at which refinement takes over
_CHANGE_WEIGHT = 100.0  # a relative change of the parameters must be this much smaller than an offset
_REFINEMENTS = 8
_SINGULAR = 1e-13  # eigenvalue of the Gauss-Newton matrix, unit diagonal, that counts as zero
_WINDOW = 6  # iterations over which progress is judged
_COST_FLOOR = 1e-40  # of the starting cost: keeps the logarithm finite on zero-residual problems
_COST_NOISE = (
    1e-9  # relative rise of the cost that refinement tolerates: residuals far below the data are noisy
)
_ROUND_OFF = 1e-13  # relative cost change that is indistinguishable from none


class Objective(Protocol):
    """A cost to minimise: half a sum of squared residuals, or a robustified one; never negative.

    ``x`` has shape (n,) in the caller's units.  A point where the model is undefined is reported by a
    non-finite cost; the line search then backtracks.  An exception aborts the fit and reaches the caller.
    """

    def cost(self, x: Vector) -> float:
        """Cost at ``x``; ``nan`` or ``inf`` where the model is undefined."""
        ...

    def gauss_newton(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Cost, gradient of shape (n,) and the Gauss-Newton matrix JᵀJ of shape (n, n)."""
        ...

    def hessian(self, x: Vector) -> Matrix:
        """Exact Hessian of the cost, shape (n, n)."""
        ...


class Status(Enum):
    """How a minimisation ended; the value is the message for the user."""

    CONVERGED = "converged: the remaining step is negligible against the misfit"
    ITERATION_LIMIT = "stopped at the iteration limit: the estimate is the best point seen, not a minimum"
    SINGULAR = "not unique: the cost is minimal, but some change of the parameters leaves it unchanged"
    STALLED = "stalled: no further decrease was possible, yet the best point seen is not a minimum"
    INFEASIBLE_START = "not started: the cost or its derivatives are not finite at the starting point"


@dataclass(frozen=True)
class Options:
    """Settings of the solver; all tolerances are dimensionless.

    Attributes:
        max_iterations: Ipopt iterations allowed in total, both Hessians together; at least 1.
        tolerance: relative offset (remaining step over residual length), or a hundred times the remaining
            relative change of the parameters, at which refinement stops.
        acceptable: relative offset that still counts as converged when round-off prevents ``tolerance``; for
            m residuals 1e-6 is a step of about 1e-6 √m standard errors.
        hessian: "auto" starts with Gauss-Newton and falls back to the exact Hessian when that stalls; the
            other two values force one of them.
        barrier: Ipopt's initial barrier parameter, in units of the logarithm of the cost.
        print_level: Ipopt's output, 0 (silent) to 12.
    """

    max_iterations: int = 200
    tolerance: float = 1e-10
    acceptable: float = 1e-6
    hessian: Literal["auto", "gauss-newton", "exact"] = "auto"
    barrier: float = 1e-4
    print_level: int = 0

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations is {self.max_iterations}; it must be at least 1")
        if not 0.0 < self.tolerance <= self.acceptable < 1.0:
            raise ValueError(
                f"tolerance is {self.tolerance} and acceptable is {self.acceptable}; "
                "they must satisfy 0 < tolerance <= acceptable < 1"
            )
        if self.hessian not in ("auto", "gauss-newton", "exact"):
            raise ValueError(f"hessian is {self.hessian!r}; allowed: 'auto', 'gauss-newton', 'exact'")
        if not self.barrier > 0.0:
            raise ValueError(f"barrier is {self.barrier}; it must be positive")


@dataclass(frozen=True)
class Solution:
    """Outcome of :func:`minimise`.

    Attributes:
        x: best point seen, shape (n,), the caller's units; never outside the bounds.
        cost: cost at ``x``.
        status: how the run ended.
        n_iterations: Ipopt iterations plus refinement steps.
        n_evaluations: evaluations of the objective, with or without derivatives.
        hessian: the Hessian Ipopt used last.
        offset: what the tolerances are compared with: the length of the step that remains over the residual
            length, or a hundred times the relative change of the parameters in that step if that is smaller
            (which matters for residuals near round-off only).
    """

    x: Vector
    cost: float
    status: Status
    n_iterations: int
    n_evaluations: int
    hessian: HessianKind
    offset: float

    @property
    def success(self) -> bool:
        """Whether ``x`` is a minimum within the tolerances."""
        return self.status is Status.CONVERGED

    @property
    def message(self) -> str:
        """The status in words."""
        return self.status.value


class SymbolicResiduals:
    """An :class:`Objective` from a CasADi expression: half the sum of squares of ``residuals(x)``.

    Args:
        residuals: dense or sparse ``casadi.SX`` column of m residuals.
        x: the ``casadi.SX`` column of n symbols they depend on.

    Raises:
        ValueError: if either argument is not a column or the residuals contain other symbols.
    """

    def __init__(self, residuals: Any, x: Any) -> None:
        for name, value in (("residuals", residuals), ("x", x)):
            if value.shape[1] != 1 or value.shape[0] < 1:
                raise ValueError(f"{name} has shape {value.shape}; a column with at least one row is needed")
        foreign = sorted({str(s) for s in ca.symvar(residuals)} - {str(s) for s in ca.symvar(x)})
        if foreign:
            raise ValueError(f"residuals depend on {foreign}, which are not among the variables {x}")
        residuals = ca.densify(residuals)
        half = ca.sumsqr(residuals) / 2
        self._residuals = _Evaluator(ca.Function("residuals", [x], [residuals]))
        self._jacobian = _Evaluator(ca.Function("jacobian", [x], [ca.densify(ca.jacobian(residuals, x))]))
        self._hessian = _Evaluator(ca.Function("hessian", [x], [ca.densify(ca.hessian(half, x)[0])]))

    def residuals(self, x: Vector) -> Vector:
        """Residuals at ``x``, shape (m,)."""
        return self._residuals(x)[:, 0]

    def jacobian(self, x: Vector) -> Matrix:
        """Derivatives of the residuals, shape (m, n)."""
        return self._jacobian(x)

    def cost(self, x: Vector) -> float:
        """Half the sum of squares at ``x``."""
        r = self.residuals(x)
        return 0.5 * float(r @ r)

    def gauss_newton(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Cost, gradient Jᵀr and matrix JᵀJ at ``x``."""
        r = self.residuals(x)
        J = self.jacobian(x)
        return 0.5 * float(r @ r), r @ J, J.T @ J

    def hessian(self, x: Vector) -> Matrix:
        """Exact Hessian of half the sum of squares at ``x``, shape (n, n)."""
        return self._hessian(x)


class _Evaluator:
    """A CasADi function of one vector with one dense output, called without building CasADi matrices."""

    def __init__(self, function: Any) -> None:
        rows, columns = function.size_out(0)
        self._buffer, self._trigger = function.buffer()
        self._input = np.zeros(function.size1_in(0))
        self._output = np.zeros((columns, rows))  # CasADi stores columns first
        self._buffer.set_arg(0, self._input.data)
        self._buffer.set_res(0, self._output.data)
        self._lock = threading.Lock()

    def __call__(self, x: Vector) -> Matrix:
        with self._lock:
            self._input[:] = x
            self._trigger()
            return self._output.T.copy()


@dataclass(frozen=True)
class _Point:
    """One evaluation with derivatives, in scaled variables and divided by the cost (so cost = 1)."""

    u: Vector
    cost: float
    gradient: Vector
    matrix: Matrix


def _box_step(gradient: Vector, matrix: Matrix, low: Vector, high: Vector) -> Vector:
    """Minimiser of gᵀd + dᵀHd/2 for low <= d <= high, by correcting a guess of the bounds it rests on."""
    n = gradient.size
    step = _solve(matrix, -gradient)
    if not ((step < low) | (step > high)).any():
        return step
    # An interior-point iterate is near its bounds, not on them: those near and pressed on start the guess.
    near = 1e-3 * np.abs(step)
    at_low, at_high = (low >= -near) & (gradient > 0), (high <= near) & (gradient < 0)
    for _ in range(2 * n):
        free = np.flatnonzero(~(at_low | at_high))
        step = np.where(at_low, low, np.where(at_high, high, 0.0))
        if free.size:
            right = -gradient[free] - matrix[free] @ step
            step[free] = _solve(matrix[np.ix_(free, free)], right)
        slope = gradient + matrix @ step
        low_next = (at_low & (slope > 0)) | (step < low)
        high_next = (at_high & (slope < 0)) | (step > high)
        if (low_next == at_low).all() and (high_next == at_high).all():
            break
        at_low, at_high = low_next, high_next
    return np.clip(step, low, high)


def _solve(matrix: Matrix, right: Vector) -> Vector:
    """Solution of a symmetric system; of smallest norm when the matrix is not positive definite."""
    _, solution, info = dposv(matrix, right)
    if info == 0 and math.isfinite(float(solution.sum())):
        return np.asarray(solution)
    # Unit diagonal first, so that what counts as singular does not depend on the units.
    scale = 1 / np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    keep = values > values.size * np.finfo(float).eps * max(float(values[-1]), 0.0)
    weights = np.zeros_like(values)
    weights[keep] = 1 / values[keep]
    return np.asarray(scale * (vectors @ (weights * (vectors.T @ (scale * right)))))


@dataclass(frozen=True)
class _Candidate:
    """A point, the Gauss-Newton step that remains from it and the relative size of that step."""

    point: _Point
    step: Vector
    offset: float


class _Run:
    """State of one minimisation: the objective in scaled variables, the best point, the progress."""

    def __init__(
        self,
        objective: Objective,
        start: Vector,
        bounds: tuple[Vector, Vector],
        scale: Vector,
        options: Options,
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
        self._trial_key = b""
        self._trial_cost = math.nan
        self._trials = 0
        self.start = start / scale
        self.best = _Candidate(
            _Point(self.start, math.inf, self.start, np.eye(start.size)), self.start, math.inf
        )

    # -- evaluation ---------------------------------------------------------------------------------------

    def unscaled(self, u: Vector) -> Vector:
        """The caller's variables; clipped because Ipopt may leave a bound by a rounding error."""
        return np.clip(u * self.scale, self.lower, self.upper)

    def unit(self, cost: float) -> float:
        """What derivatives are divided by: the cost, kept from zero."""
        return max(cost, _COST_FLOOR * self.reference) or 1.0

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
        self.point = _Point(
            u.copy(), cost, gradient * (scale / unit), matrix * (scale[:, None] * (scale / unit))
        )
        return self.point

    def log_cost(self, cost: float) -> float:
        # The constant keeps the function away from zero: Ipopt's allowance for round-off is relative to it.
        return 10.0 + math.log(max(cost / self.reference, _COST_FLOOR))

    def value(self, u: Vector) -> float:
        """Logarithm of the cost.  The first trial of a line search is usually accepted: derivatives too."""
        key = u.tobytes()
        if self._trials == 0 or key == self._key:
            self._trials += key != self._key
            point = self.evaluate(u)
            return math.nan if point is None else self.log_cost(point.cost)
        if key != self._trial_key:
            self._trials += 1
            self.n_evaluations += 1
            self._trial_key, self._trial_cost = key, float(self.objective.cost(self.unscaled(u)))
        cost = self._trial_cost
        return self.log_cost(cost) if math.isfinite(cost) and cost >= 0 else math.nan

    def gradient(self, u: Vector) -> Vector | None:
        """Gradient of the logarithm of the cost; asked for accepted points only."""
        self._trials = 0
        point = self.evaluate(u)
        return None if point is None else point.gradient

    def hessian(self, u: Vector) -> Matrix | None:
        """Hessian of the cost over the cost: with it the Newton step is that of the cost itself."""
        point = self.evaluate(u)
        if point is None:
            return None
        return point.matrix if self.kind == "gauss-newton" else self.exact_hessian(point)

    def exact_hessian(self, point: _Point) -> Matrix:
        unit = self.unit(point.cost)
        return np.asarray(self.objective.hessian(self.unscaled(point.u))) * (
            self.scale[:, None] * (self.scale / unit)
        )

    # -- convergence ---------------------------------------------------------------------------------------

    def newton_step(self, point: _Point, matrix: Matrix) -> Vector:
        """Step to the minimum of the local quadratic model inside the bounds."""
        return _box_step(point.gradient, matrix, self.low - point.u, self.high - point.u)

    def assess(self, point: _Point) -> _Candidate:
        """The step that remains, relative to the misfit or to the parameters, whichever is smaller."""
        step = self.newton_step(point, point.matrix)
        offset = math.sqrt(max(float(step @ point.matrix @ step), 0.0) / 2)
        change = float((np.abs(step) / np.maximum(np.abs(point.u), 1e-3)).max())
        return _Candidate(point, step, min(offset, _CHANGE_WEIGHT * change))

    def keep(self, candidate: _Candidate) -> None:
        """Remember the better of two points: smaller cost, or the smaller offset at equal cost."""
        best = self.best
        slack = _ROUND_OFF * best.point.cost
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
        enough = _HANDOVER if self.kind == "gauss-newton" else self.options.acceptable
        return candidate.offset <= enough or self.exhausted() or self.stuck()

    def exhausted(self) -> bool:
        return self.n_iterations >= self.options.max_iterations

    def stuck(self) -> bool:
        """Whether the last iterations brought nothing, or little enough to try the exact Hessian."""
        if len(self.history) <= _WINDOW:
            return False
        (cost_then, offset_then), (cost, offset) = self.history[-1 - _WINDOW], self.history[-1]
        if cost_then - cost <= _ROUND_OFF * cost_then and offset > 0.1 * offset_then:
            return True
        slow = cost > 0.9 * cost_then and offset > 0.1 * offset_then
        return slow and self.kind == "gauss-newton" and self.options.hessian == "auto"

    def refine(self) -> None:
        """Undamped Newton steps from the best point while each pays; exact Hessian once the first is slow."""
        exact = self.kind == "exact"
        for _ in range(_REFINEMENTS):
            before = self.best
            if not self.options.tolerance < before.offset <= _HANDOVER or self.exhausted():
                return
            step = self.newton_step(before.point, self.exact_hessian(before.point)) if exact else before.step
            point = self.evaluate(np.clip(before.point.u + step, self.low, self.high))
            self.n_iterations += 1
            allowed = before.point.cost * (1 + _COST_NOISE) + _COST_FLOOR * self.reference
            if point is not None and point.cost <= allowed:
                candidate = self.assess(point)
                if candidate.offset < before.offset:
                    self.best = candidate
            ratio = self.best.offset / before.offset
            if exact and ratio > 0.5:
                return
            exact = exact or (ratio > 0.1 and self.options.hessian == "auto")

    def converged(self) -> bool:
        best = self.best
        return best.offset <= self.options.acceptable or best.point.cost <= _COST_FLOOR * self.reference

    def singular(self) -> bool:
        """Whether some change of the parameters, away from the bounds, leaves all residuals unchanged."""
        point = self.best.point
        free = (point.u > self.low) & (point.u < self.high)
        matrix = point.matrix[np.ix_(free, free)]
        if matrix.size == 0:
            return False
        diagonal = matrix.diagonal()
        if not (diagonal > 0).all():
            return True
        size = np.sqrt(diagonal)
        return float(np.linalg.eigvalsh(matrix / np.outer(size, size))[0]) < _SINGULAR

    def status(self) -> Status:
        if self.converged():
            return Status.SINGULAR if self.singular() else Status.CONVERGED
        return Status.ITERATION_LIMIT if self.exhausted() else Status.STALLED


class _Callback(ca.Callback):
    """A CasADi function computed by Python on raw buffers, which avoids CasADi's matrix conversions."""

    def __init__(
        self,
        name: str,
        inputs: list[tuple[str, Any]],
        outputs: list[tuple[str, Any]],
        compute: Callable[[Any, Any], None],
    ) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._compute = inputs, outputs, compute
        self.construct(name, {"enable_fd": False})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        return self._inputs[i][0]

    def get_name_out(self, i: int) -> str:
        return self._outputs[i][0]

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i][1]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i][1]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        self._compute(arguments, results)
        return 0


def _share(function: Any, arguments: dict[str, Vector]) -> tuple[Any, Callable[[], None]]:
    """A CasADi function reading the given arrays in place: the buffer, to be kept alive, and the call."""
    buffer, call = function.buffer()
    for name, array in arguments.items():
        buffer.set_arg(function.index_in(name), array.data)
    return buffer, call


class _Engine:
    """One Ipopt instance for n variables, serving one :class:`_Run` at a time.

    Building an instance costs several milliseconds, a solve about one, so instances are kept and reused.
    """

    def __init__(self, n: int, options: Options) -> None:
        self.run: _Run | None = None
        self._triangle = np.ravel_multi_index(np.tril_indices(n), (n, n))  # upper triangle, columns first
        dense = ca.Sparsity.dense
        x, p = ("x", dense(n, 1)), ("p", dense(0, 1))
        f, g = ("f", dense(1, 1)), ("g", dense(0, 1))
        lam = [("lam_f", dense(1, 1)), ("lam_g", dense(0, 1))]
        monitored = [dense(n, 1), dense(1, 1), dense(0, 1), dense(n, 1), dense(0, 1), dense(0, 1)]
        upper = ca.Sparsity.upper(n)
        # CasADi holds no references to Python callbacks: they must live as long as the solver.
        self._callbacks = {
            "nlp": _Callback("nlp", [x, p], [f, g], self._value),
            "grad_f": _Callback("grad_f", [x, p], [f, ("grad_f_x", dense(n, 1))], self._gradient),
            "jac_g": _Callback("jac_g", [x, p], [g, ("jac_g_x", dense(0, n))], self._nothing),
            "hess_lag": _Callback("hess_lag", [x, p, *lam], [("triu_hess_gamma_x_x", upper)], self._hessian),
            "iteration_callback": _Callback(
                "monitor",
                list(zip(ca.nlpsol_out(), monitored, strict=True)),
                [("stop", dense(1, 1))],
                self._monitor,
            ),
        }
        settings = {k: v for k, v in self._callbacks.items() if k != "nlp"} | _ipopt_settings(options)
        self._solver = ca.nlpsol("least_squares", "ipopt", self._callbacks["nlp"], settings)
        # Start and bounds go through memory shared with CasADi, results come back through the callbacks.
        self._start, self._low, self._high = np.zeros(n), np.zeros(n), np.zeros(n)
        shared = {"x0": self._start, "lbx": self._low, "ubx": self._high}
        self._buffer, self._solve = _share(self._solver, shared)

    def descend(self, run: _Run, start: Vector) -> None:
        """Let Ipopt descend from ``start`` (scaled); the outcome is in ``run``."""
        self.run = run
        run.history.clear()
        run.error = None
        try:
            self._start[:], self._low[:], self._high[:] = start, run.low, run.high
            self._solve()
        finally:
            self.run = None
        if run.error is not None:
            raise run.error

    def _guard(self, compute: Callable[[_Run, Vector], Any], arguments: Any) -> Any:
        """Run Python inside Ipopt: exceptions are kept for :meth:`descend`, the point counts as undefined."""
        run = self.run
        if run is None or run.error is not None:
            return None
        try:
            return compute(run, np.frombuffer(arguments[0]))
        except BaseException as error:  # also a keyboard interrupt must travel around the C++ frames
            run.error = error
            return None

    def _value(self, arguments: Any, results: Any) -> None:
        value = self._guard(_Run.value, arguments)
        if results[0] is not None:
            np.frombuffer(results[0])[0] = math.nan if value is None else value

    def _gradient(self, arguments: Any, results: Any) -> None:
        gradient = self._guard(_Run.gradient, arguments)
        if results[0] is not None:
            self._value(arguments, results)
        if results[1] is not None:
            np.frombuffer(results[1])[:] = math.nan if gradient is None else gradient

    def _hessian(self, arguments: Any, results: Any) -> None:
        matrix = self._guard(_Run.hessian, arguments)
        if results[0] is not None:
            out = np.frombuffer(results[0])
            if matrix is None:
                out[:] = math.nan
            else:
                np.multiply(matrix.take(self._triangle), np.frombuffer(arguments[2])[0], out=out)

    def _monitor(self, arguments: Any, results: Any) -> None:
        stop = self._guard(lambda run, _: run.monitor(), arguments)
        if results[0] is not None:
            np.frombuffer(results[0])[0] = 1.0 if stop is None or stop else 0.0

    def _nothing(self, arguments: Any, results: Any) -> None:
        """There are no constraints, hence no derivatives of them."""


def _ipopt_settings(options: Options) -> dict[str, Any]:
    """CasADi and Ipopt settings; scaling and stopping are ours, so Ipopt's own are switched off."""
    return {
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "calc_lam_x": False,
        "calc_f": False,
        "calc_g": False,
        "print_time": False,
        "record_time": False,
        "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt.sb": "yes",
        "ipopt.print_level": options.print_level,
        "ipopt.nlp_scaling_method": "none",
        "ipopt.tol": 1e-16,  # the monitor stops the run
        "ipopt.acceptable_iter": 0,
        "ipopt.max_iter": options.max_iterations,
        "ipopt.fast_step_computation": "yes",  # without equality constraints refinement gains nothing
        "ipopt.max_soc": 0,
        # A full step must earn a tenth of its promise: Gauss-Newton likes to leap to where the model is flat.
        "ipopt.eta_phi": 0.1,
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.honor_original_bounds": "yes",
        "ipopt.bound_push": 1e-8,
        "ipopt.bound_frac": 1e-8,
        "ipopt.bound_mult_init_method": "mu-based",
        "ipopt.mu_init": options.barrier,
        "ipopt.fixed_variable_treatment": "make_parameter",
    }


_pool: dict[tuple[int, Options], list[_Engine]] = {}


def _borrow(n: int, options: Options) -> _Engine:
    """An idle engine.  ``list.pop`` and ``append`` are atomic: threads and nested fits never share one."""
    try:
        return _pool.setdefault((n, options), []).pop()
    except IndexError:
        return _Engine(n, options)


def minimise(
    objective: Objective,
    start: ArrayLike,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    scale: ArrayLike | None = None,
    options: Options = Options(),
) -> Solution:
    """Minimise a least-squares objective from ``start``, inside bounds.

    A failed run returns the best point seen together with a status that says so.  The function may be called
    from several threads and from within an objective; the objective itself is called by one thread.

    Args:
        objective: the cost with its derivatives.
        start: starting point, shape (n,), within the bounds.
        lower: lower bounds, shape (n,) or a scalar, ``-inf`` where absent; equal bounds fix a variable.
        upper: upper bounds likewise.
        scale: typical sizes of the variables, shape (n,), positive.  By default ``abs(start)``, and where
            that is zero the change that alters the residuals by their own length.
        options: tolerances and limits.

    Returns:
        The best point with its cost and status.

    Raises:
        ValueError: if shapes disagree, the start is outside the bounds or not finite, a scale is not
            positive, or the objective returns a negative cost.
        Exception: whatever the objective raises.
    """
    x = np.array(start, dtype=float, ndmin=1)
    if x.ndim != 1 or x.size == 0 or not np.isfinite(x).all():
        raise ValueError(f"start is {start!r}; a non-empty vector of finite numbers is needed")
    bounds = _bound("lower", lower, -np.inf, x.size), _bound("upper", upper, np.inf, x.size)
    _check_inside(x, *bounds)
    if scale is not None:
        scales = np.broadcast_to(np.asarray(scale, dtype=float), x.shape)
        if not (np.isfinite(scales).all() and (scales > 0).all()):
            raise ValueError(f"scale is {scales.tolist()}; every entry must be finite and positive")
    else:
        scales = _default_scale(objective, x)
    # Powers of two, so that scaling is exact and commutes with the bounds.
    run = _Run(objective, x, bounds, np.exp2(np.round(np.log2(scales))), options)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a trial point may well be absurd
        status = _descend(run)
    best = run.best
    if status is Status.INFEASIBLE_START:
        return Solution(x, math.nan, status, 0, run.n_evaluations, run.kind, math.inf)
    return Solution(
        run.unscaled(best.point.u),
        best.point.cost,
        status,
        run.n_iterations,
        run.n_evaluations,
        run.kind,
        best.offset,
    )


def _bound(name: str, value: ArrayLike | None, absent: float, n: int) -> Vector:
    bound = np.asarray(absent if value is None else value, dtype=float)
    if bound.shape not in ((), (n,)):
        raise ValueError(f"{name} has shape {bound.shape}; a scalar or shape ({n},) is needed")
    if np.isnan(bound).any():
        raise ValueError(f"{name} is {bound.tolist()}; nan is not allowed, use infinities for absent bounds")
    return np.broadcast_to(bound, (n,))


def _check_inside(x: Vector, lower: Vector, upper: Vector) -> None:
    outside = np.flatnonzero((x < lower) | (x > upper) | (lower > upper))
    if outside.size:
        i = int(outside[0])
        raise ValueError(f"start[{i}] is {x[i]}; its bounds allow {lower[i]} to {upper[i]}")


def _default_scale(objective: Objective, x: Vector) -> Vector:
    """Absolute start values; for a zero the change that alters the residuals by their own length."""
    scale = np.abs(x)
    if not scale.all():
        cost, _, matrix = objective.gauss_newton(x)
        diagonal = np.diag(matrix)
        usable = np.isfinite(diagonal) & (diagonal > 0) & (cost > 0) & math.isfinite(cost)
        natural = np.sqrt(2 * cost / np.where(usable, diagonal, 1.0)) if usable.any() else np.ones_like(x)
        scale = np.where(scale > 0, scale, np.where(usable, natural, 1.0))
    return scale


def _descend(run: _Run) -> Status:
    """Gauss-Newton, then the exact Hessian from the best point, last the exact Hessian from the start.

    The last attempt is for a Gauss-Newton step that leapt to where the residuals no longer respond.
    """
    first = run.evaluate(run.start)
    if first is None:
        return Status.INFEASIBLE_START
    run.reference = first.cost
    run.best = run.assess(first)
    if run.best.offset <= _HANDOVER:  # a start as good as the point where Ipopt would hand over
        run.refine()
        if run.status() is Status.CONVERGED:
            return Status.CONVERGED
    key = (run.start.size, run.options)
    engine = _borrow(*key)
    try:
        engine.descend(run, run.start)
        run.refine()
        if run.options.hessian != "auto":
            return run.status()
        if not run.converged() and not run.exhausted():
            run.kind = "exact"
            engine.descend(run, run.best.point.u)
            run.refine()
        status = run.status()
        if status in (Status.SINGULAR, Status.STALLED):
            run.kind = "exact"
            engine.descend(run, run.start)
            run.refine()
            status = run.status()
        return status
    finally:
        _pool.setdefault(key, []).append(engine)
