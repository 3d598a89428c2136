"""A fit as a plain optimisation problem: which parameters are free, and how well a vector of them fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.observations import Block, Responses
from rotorfit.models import RotorModel

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Index = NDArray[np.intp]
Loss = Literal["linear", "soft_l1", "huber", "cauchy"]

LOSSES: tuple[Loss, ...] = ("linear", "soft_l1", "huber", "cauchy")
_PIECE = 8192  # readings whose derivatives are held at once
LOSS_SCALE = 2.0
"""Whitened residual modulus beyond which a robust loss discounts; the noise's own rms modulus is sqrt(2)."""


@dataclass(frozen=True, eq=False)
class ParameterSpace:
    """The fitted vector: free parameters, some of them one value a group, then nuisance parameters.

    Attributes:
        model: the rotor.
        names: names of the free entries, ``D[speed_rpm=1000]`` for one value of several.
        base: names without the group suffix, the model's own.
        template: parameter vectors of the groups with known values in place, shape ``(G, P)``.
        index: entry of the fitted vector that feeds each place of the template, -1 where known, shape ``(G, P)``.
        lower, upper: bounds, shape ``(p,)``.
        nuisance: names of nuisance entries, which follow the parameters.
    """

    model: RotorModel
    names: tuple[str, ...]
    base: tuple[str, ...]
    template: Float
    index: Index
    lower: Float
    upper: Float
    nuisance: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Length of the fitted vector."""
        return len(self.names) + len(self.nuisance)

    def theta(self, x: Float) -> Float:
        """Parameter vectors of the groups, shape ``(..., G, P)``, of fitted vectors of shape ``(..., p)``."""
        free = self.index >= 0
        theta = np.broadcast_to(self.template, (*x.shape[:-1], *self.template.shape)).copy()
        theta[..., free] = x[..., self.index[free]]
        return theta

    def group(self, at: Mapping[str, Any] | None = None) -> int:
        """Number of the parameter group with given attribute values, ``{"speed_rpm": 1000}``.

        Raises:
            ValueError: parameters were fitted per attribute and ``at`` does not name one group.
        """
        if self.index.shape[0] == 1:
            return 0
        suffixes = [
            {name.partition("[")[2][:-1] for name in (self.names[i] for i in row if i >= 0) if "[" in name}
            for row in self.index
        ]
        matches = [
            g
            for g, suffix in enumerate(suffixes)
            if at and all(any(_is_value(label, name, value) for label in suffix) for name, value in at.items())
        ]
        if len(matches) != 1:
            raise ValueError(
                "parameters differ between tests: say which with at={attribute: value}; there are "
                + "; ".join(", ".join(sorted(s)) for s in suffixes)
            )
        return matches[0]


def _is_value(label: str, name: str, value: Any) -> bool:
    """Whether a suffix ``name=value`` is that of a value, numbers to six digits: speeds in rpm are seldom round."""
    attribute, _, text = label.partition("=")
    if attribute != name or not isinstance(value, Real):
        return label == f"{name}={value}"
    try:
        return math.isclose(float(text), float(value), rel_tol=1e-6)
    except ValueError:
        return False


@dataclass(frozen=True, eq=False)
class Prior:
    """Logarithm of a prior density of one entry and its two derivatives."""

    entry: int
    distribution: Any  # a frozen scipy.stats distribution

    @cached_property
    def _moments(self) -> tuple[float, float]:
        return float(self.distribution.mean()), float(self.distribution.std())

    def terms(self, value: float) -> tuple[float, float, float]:
        """Minus log of the density over its largest, at a value, its slope and its curvature (none below zero)."""
        mean, sd = self._moments
        if self.distribution.dist.name == "norm":
            pull = (value - mean) / sd
            return 0.5 * pull**2, pull / sd, 1.0 / sd**2
        step = 1e-4 * sd
        # One call: SciPy's checks cost far more than the arithmetic.
        low, here, high = (-self.distribution.logpdf(value + np.array([-step, 0.0, step]))).tolist()
        rise = max(here - self._least, 0.0) if np.isfinite(here) else np.inf
        if not np.isfinite([low, here, high]).all():
            return rise, 0.0, 0.0
        return rise, (high - low) / (2 * step), max((high - 2 * here + low) / step**2, 0.0)

    @cached_property
    def _least(self) -> float:
        """Minus log density where it is largest: a cost is never negative, however narrow a prior is."""
        from scipy.optimize import minimize_scalar

        at = self.distribution.ppf(np.linspace(0.0, 1.0, 201))
        with np.errstate(all="ignore"):  # at the ends of the support a density may be zero or infinite
            height = -self.distribution.logpdf(at)
        at, height = at[np.isfinite(at + height)], height[np.isfinite(at + height)]
        best = int(np.argmin(height))
        ends = float(at[max(best - 1, 0)]), float(at[min(best + 1, at.size - 1)])
        found = minimize_scalar(
            lambda v: -self.distribution.logpdf(v), bounds=ends, options={"xatol": 1e-10 * (ends[1] - ends[0])}
        )
        return float(min(height[best], found.fun))


def within_support(space: ParameterSpace, priors: Sequence[Prior]) -> ParameterSpace:
    """The space with its bounds narrowed to where the priors are not zero."""
    lower, upper = space.lower.copy(), space.upper.copy()
    for prior in priors:
        low, high = prior.distribution.support()
        lower[prior.entry] = max(lower[prior.entry], float(low))
        upper[prior.entry] = min(upper[prior.entry], float(high))
    return replace(space, lower=lower, upper=upper)


def robust_weights(loss: Loss, size2: Float) -> tuple[Float, Float]:
    """Robust cost of squared whitened residual moduli, and the factor by which each residual's pull shrinks.

    Args:
        loss: one of :data:`LOSSES`.
        size2: ``|r|^2``, shape ``(R,)``.

    Returns:
        ``rho`` with cost = sum(rho)/2, and ``d rho / d size2``.
    """
    if loss == "linear":
        return size2, np.ones_like(size2)
    c2 = LOSS_SCALE**2
    z = size2 / c2
    if loss == "soft_l1":
        root = np.sqrt(1 + z)
        return 2 * c2 * (root - 1), 1 / root
    if loss == "huber":
        root = np.sqrt(np.maximum(z, 1))
        return np.where(z <= 1, size2, c2 * (2 * root - 1)), 1 / root
    return c2 * np.log1p(z), 1 / (1 + z)


@dataclass(frozen=True, eq=False)
class Problem:
    """Weighted least squares on complex observations, an :class:`~rotorfit.estimators.least_squares.Objective`.

    Attributes:
        space: the fitted vector.
        blocks: the observations.
        loss: "linear" or a robust one, applied to the modulus of each whitened complex residual.
        priors: priors on entries of the fitted vector.
        factors: for each block, sensitivities of the logarithm of its predictions to the nuisance entries (j for a
            phase, 1 for a gain), shape ``(R, n_nuisance)``, or ``None``.
    """

    space: ParameterSpace
    blocks: tuple[Block, ...]
    loss: Loss = "linear"
    priors: tuple[Prior, ...] = ()
    factors: tuple[ComplexArray | None, ...] = field(default=())

    @property
    def n_data(self) -> int:
        """Number of real data: two for each complex observation."""
        return 2 * sum(block.measured.size for block in self.blocks)

    def _nuisance_factor(self, number: int, x: Float) -> ComplexArray | float:
        if not self.factors or self.factors[number] is None:
            return 1.0
        return np.asarray(np.exp(np.asarray(self.factors[number]) @ x[len(self.space.names) :]))

    def predict(self, x: Float) -> list[ComplexArray]:
        """Predicted observations of each block."""
        theta = self.space.theta(x)
        return [block.predict(theta) * self._nuisance_factor(i, x) for i, block in enumerate(self.blocks)]

    def residuals(self, x: Float) -> ComplexArray:
        """Whitened complex residuals of all blocks, predicted minus measured over sigma, shape ``(R,)``."""
        pairs = zip(self.predict(x), self.blocks, strict=True)
        return np.concatenate([(predicted - block.measured) / block.sigma for predicted, block in pairs])

    def jacobian(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Whitened residuals and their derivatives, shapes ``(R,)`` and ``(R, p)``."""
        theta = self.space.theta(x)
        count = self.n_data // 2
        residuals = np.empty(count, dtype=complex)
        rows = np.zeros((self.space.size, count), dtype=complex)  # parameter by parameter: contiguous along the lines
        stop = 0
        for number, block in enumerate(self.blocks):
            start, stop = stop, stop + block.measured.size
            predicted, by_theta = block.predict_jacobian(theta)
            part = rows[:, start:stop]
            self._scatter(block, by_theta.T, part)
            if self.factors and self.factors[number] is not None:
                factor = np.asarray(self._nuisance_factor(number, x))
                predicted = predicted * factor
                part *= factor
                part[len(self.space.names) :] = np.asarray(self.factors[number]).T * predicted
            residuals[start:stop] = (predicted - block.measured) / block.sigma
        rows.view(float)[:] *= self._weight
        return residuals, rows.T

    @cached_property
    def _weight(self) -> Float:
        """One over sigma, twice in a row for the real and the imaginary part of each reading."""
        return np.repeat(np.concatenate([1 / block.sigma for block in self.blocks]), 2)

    def _scatter(self, block: Block, by_theta: ComplexArray, out: ComplexArray) -> None:
        """Write derivatives by the groups' parameters as derivatives by the fitted vector, readings along the rows."""
        group = block.reading_group
        for g, index in enumerate(self.space.index):
            places = np.flatnonzero(index >= 0)
            if len(self.space.index) == 1:
                out[index[places]] = by_theta[places]
            else:
                rows = np.flatnonzero(group == g)
                out[np.ix_(index[places], rows)] = by_theta[np.ix_(places, rows)]

    # ---- the optimiser's view -------------------------------------------------------------------------------------

    def cost(self, x: Float) -> float:
        """Half the (robust) sum of squares plus minus the log prior."""
        misfit = sum(piece._misfit(x) for piece in self._pieces)
        return misfit + sum(prior.terms(float(x[prior.entry]))[0] for prior in self.priors)

    @cached_property
    def _pieces(self) -> tuple[Problem, ...]:
        """The problem in pieces that fit the processor's cache; derivatives of millions of readings fit no memory."""
        pieces: list[Problem] = []
        for number, block in enumerate(self.blocks):
            parts = block.split(_PIECE) if isinstance(block, Responses) else [block]
            factors = self.factors[number] if self.factors else None
            stops = np.cumsum([part.measured.size for part in parts])
            rows = [None] * len(parts) if factors is None else np.split(factors, stops[:-1])
            pieces += [
                Problem(self.space, (part,), self.loss, (), () if row is None else (row,))
                for part, row in zip(parts, rows, strict=True)
            ]
        return tuple(pieces)

    def _misfit(self, x: Float) -> float:
        r = self.residuals(x)
        if self.loss == "linear":
            return 0.5 * float(np.vdot(r, r).real)
        return 0.5 * float(robust_weights(self.loss, np.abs(r) ** 2)[0].sum())

    def _misfit_derivatives(self, x: Float) -> tuple[float, Float, Float]:
        r, J = self.jacobian(x)
        rows = J.T
        if self.loss == "linear":
            misfit = 0.5 * float(np.vdot(r, r).real)
        else:
            rho, weight = robust_weights(self.loss, np.abs(r) ** 2)
            misfit = 0.5 * float(rho.sum())
            root = np.sqrt(weight)
            r, rows = r * root, rows * root
        stacked = rows.view(float)
        return misfit, stacked @ r.view(float), stacked @ stacked.T

    def gauss_newton(self, x: Float) -> tuple[float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix."""
        cost, gradient, matrix = self._pieces[0]._misfit_derivatives(x)
        for piece in self._pieces[1:]:
            more, slope, curvature = piece._misfit_derivatives(x)
            cost += more
            gradient += slope
            matrix += curvature
        for prior in self.priors:
            value, first, second = prior.terms(float(x[prior.entry]))
            cost += value
            gradient[prior.entry] += first
            matrix[prior.entry, prior.entry] += second
        return cost, gradient, matrix

    def hessian(self, x: Float) -> Float:
        """Second derivatives of the cost, by central differences of the exact gradient.

        Needed only where Gauss-Newton stalls; a relative step of 6e-6 leaves errors near 1e-10 of its size.
        """
        step = np.cbrt(np.finfo(float).eps) * np.maximum(np.abs(x), 1e-8)
        columns = []
        for i in range(x.size):
            d = np.zeros_like(x)
            d[i] = step[i]
            columns.append((self.gauss_newton(x + d)[1] - self.gauss_newton(x - d)[1]) / (2 * step[i]))
        matrix = np.array(columns)
        return np.asarray((matrix + matrix.T) / 2)


def parameter_space(
    model: RotorModel,
    *,
    known: Mapping[str, float | None],
    bounds: Mapping[str, tuple[float, float]],
    groups: Sequence[Mapping[str, str]],
    nuisance: Sequence[str] = (),
) -> ParameterSpace:
    """Lay out the fitted vector.

    Args:
        model: the rotor.
        known: fixed values by parameter name; ``None`` frees a parameter that the model knows by default.
        bounds: lower and upper bounds by name, within the model's physical limits.
        groups: for each group of readings, the suffix of each ``per`` parameter (``{"D": "speed_rpm=1000"}``).
        nuisance: names of nuisance entries, unbounded.

    Raises:
        KeyError: unknown parameter name.
        ValueError: contradictory bounds, a known value outside the limits, or nothing left to fit.
    """
    for name in [*known, *bounds, *groups[0]]:
        model.parameter(name.partition("[")[0])
    fixed = {q.name: q.default for q in model.parameters if q.default is not None} | dict(known)
    fixed = {name: value for name, value in fixed.items() if value is not None}
    _check_known(model, fixed, bounds, groups[0])
    names: list[str] = []
    base: list[str] = []
    template = np.zeros((len(groups), len(model.parameters)))
    index = np.full(template.shape, -1, dtype=np.intp)
    for place, parameter in enumerate(model.parameters):
        for g, suffixes in enumerate(groups):
            suffix = suffixes.get(parameter.name)
            name = parameter.name if suffix is None else f"{parameter.name}[{suffix}]"
            value = fixed.get(name, fixed.get(parameter.name))
            if value is not None:
                template[g, place] = value
                continue
            if name not in names:
                names.append(name)
                base.append(parameter.name)
            index[g, place] = names.index(name)
    if not names:
        raise ValueError("every parameter is known: nothing is left to fit")
    limits = np.array([_limits(model, name, bounds) for name in names])
    free = np.full(len(nuisance), np.inf)
    return ParameterSpace(
        model,
        tuple(names),
        tuple(base),
        template,
        index,
        np.concatenate([limits[:, 0], -free]),
        np.concatenate([limits[:, 1], free]),
        tuple(nuisance),
    )


def _check_known(
    model: RotorModel,
    fixed: Mapping[str, Any],
    bounds: Mapping[str, tuple[float, float]],
    per: Mapping[str, str],
) -> None:
    for name, given in fixed.items():
        parameter = model.parameter(name.partition("[")[0])
        if not (isinstance(given, Real) and np.isfinite(value := float(given))):
            raise ValueError(f"known {name} = {given!r} is not a finite number")
        if not parameter.lower <= value <= parameter.upper:
            raise ValueError(
                f"known {name} = {value:g} {parameter.unit} is outside the physical limits "
                f"[{parameter.lower:g}, {parameter.upper:g}]"
            )
        low, high = _limits(model, name, bounds)
        if not low <= value <= high:
            raise ValueError(
                f"known {name} = {value:g} {parameter.unit} is outside its bounds [{low:g}, {high:g}]; change either"
            )
        if name in per:
            raise ValueError(f"{name} is both known and fitted per attribute: choose one")


def _limits(model: RotorModel, name: str, bounds: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    parameter = model.parameter(name.partition("[")[0])
    pair = bounds.get(name, bounds.get(parameter.name, (parameter.lower, parameter.upper)))
    if np.shape(pair) != (2,) or not all(isinstance(value, Real) for value in pair):
        raise ValueError(f"bounds of {name} must be two numbers, lower and upper (inf is one), got {pair!r}")
    low, high = pair
    low, high = max(float(low), parameter.lower), min(float(high), parameter.upper)
    if not low < high:
        raise ValueError(
            f"bounds of {name} are contradictory: lower {low:g} is not below upper {high:g} "
            f"(physical limits [{parameter.lower:g}, {parameter.upper:g}])"
        )
    return low, high
