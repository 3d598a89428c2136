"""Nonlinear least squares by Gauss-Newton steps and CasADi's Ipopt, mostly driven by numerical callbacks.

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

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.estimators.minimisation.descent import HANDOVER_OFFSET, Minimisation
from rotorfit.estimators.minimisation.ipopt import borrowed, descend_on_graph
from rotorfit.estimators.minimisation.objective import Objective, Options, Solution, Status, Vector

_DEFAULTS = Options()

__all__ = ["Objective", "Options", "Solution", "Status", "minimise"]


def minimise(
    objective: Objective,
    start: ArrayLike,
    *,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    scale: ArrayLike | None = None,
    options: Options = _DEFAULTS,
    graph: ca.Function | None = None,
) -> Solution:
    """Minimise a least-squares objective from ``start``, inside bounds. ``graph``, the cost as a CasADi function of
    ``x``, is what Ipopt as chosen method descends on; the objective judges its end. May be called from several threads
    and from within an objective, which itself is called by one thread."""
    x = np.array(start, dtype=float, ndmin=1)
    low, high = (np.broadcast_to(np.asarray(bound, dtype=float), x.shape) for bound in (lower, upper))
    if ((x < low) | (x > high)).any():
        raise ValueError(f"start is {x.tolist()}; its bounds allow {low.tolist()} to {high.tolist()}")
    scales = _default_scale(objective, x) if scale is None else np.asarray(scale, dtype=float)
    # Scaling by powers of two near the sizes is exact and commutes with the bounds.
    run = Minimisation(objective, x, (low, high), np.exp2(np.round(np.log2(scales))), options)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a trial point may well be absurd
        status = _descend(run, graph)
        if status is Status.STALLED:  # where the exact Hessian leads nowhere, as between kinks of a robust loss
            run.descend(options.acceptable)
            run.refine()
            status = run.status()
    best = run.best
    return Solution(
        x=run.unscaled(best.point.u),
        cost=math.nan if status is Status.INFEASIBLE_START else best.point.cost,
        status=status,
        n_iterations=run.n_iterations,
        n_evaluations=run.n_evaluations,
        hessian=run.kind,
        offset=best.offset,
    )


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


def _descend(run: Minimisation, graph: ca.Function | None) -> Status:
    """By the method chosen. "auto" is Gauss-Newton, then the exact Hessian from the best point, last from the start,
    for a step that leapt to where residuals no longer respond; not where they do not respond at the start either: a
    descent would wander until round-off is all that it finds."""
    first = run.evaluate(run.start)
    if first is None:
        return Status.INFEASIBLE_START
    run.reference = first.cost
    run.best = run.assess(first)
    if run.options.method == "gauss-newton":
        run.descend()
        run.refine()
        return run.status()
    if run.options.method == "ipopt" and graph is not None:
        descend_on_graph(run, graph)
        run.refine()
        return run.status()
    if run.options.method == "auto":
        run.approach()
        if run.best.offset <= HANDOVER_OFFSET:  # as good as the point where Ipopt would hand over
            run.refine()
            status = run.status()
            if status is Status.CONVERGED or (status is Status.SINGULAR and run.singular_throughout()):
                return status
    with borrowed(run.start.size, run.options) as engine:
        engine.descend(run, run.start)
        run.refine()
        if run.options.hessian != "auto":
            return run.status()
        if not run.converged() and not run.exhausted():
            run.kind = "exact"
            engine.descend(run, run.best.point.u)
            run.refine()
        status = run.status()
        if status is Status.STALLED or (status is Status.SINGULAR and not run.singular_throughout()):
            run.kind = "exact"
            engine.descend(run, run.start)
            run.refine()
            status = run.status()
        return status
