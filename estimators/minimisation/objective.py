"""What the least-squares engine minimises, how it is set, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Vector: TypeAlias = NDArray[np.float64]
Matrix: TypeAlias = NDArray[np.float64]
HessianKind: TypeAlias = Literal["gauss-newton", "exact"]


class Objective(Protocol):
    """A cost to minimise: half a sum of squared residuals, or a robustified one; never negative.

    ``x`` has shape (n,) in the caller's units.  A point where the model is undefined is reported by a
    non-finite cost; the line search then backtracks.  An exception aborts the fit and reaches the caller.
    """

    def cost(self, x: Vector) -> float:
        """Cost at ``x``; ``nan`` or ``inf`` where the model is undefined.

        Args:
            x: point in the caller's units, shape (n,).
        """
        ...

    def gauss_newton(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Cost, gradient of shape (n,) and the Gauss-Newton matrix JᵀJ of shape (n, n).

        Args:
            x: point in the caller's units, shape (n,).
        """
        ...

    def hessian(self, x: Vector) -> Matrix:
        """Exact Hessian of the cost, shape (n, n).

        Args:
            x: point in the caller's units, shape (n,).
        """
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


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Outcome of :func:`~rotorfit.estimators.minimisation.least_squares.minimise`.

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
