"""Forces of a model as engineers tabulate them: at a plane, and those of the fluid over eccentricity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.models.compiled import array_function
from rotorfit.models.fluid import PlaneFluid, fluid_parameters
from rotorfit.models.known_structure import KnownStructure
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.journal import journal
from rotorfit.models.parameters import MATRIX_UNITS

COEFFICIENTS = tuple(f"{kind}{row}{column}" for kind in "KCM" for row in "xy" for column in "xy")
"""Kxx, Kxy, ... Myy: Kxy is the force in x for a displacement in y."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneForce:
    """Coefficients of the force at a plane at one speed, ``F = K r + C r' + M r''`` with r = (x, y)."""

    values: Float  # by power of s, row and column, shape ``(3, 2, 2)``: N/m, N s/m, kg
    slopes: Float  # derivatives by the model's parameters, shape ``(3, 2, 2, P)``


def plane_force(model: RotorModel, theta: Float, speed: float, plane: str, eccentricity: float = 0.0) -> PlaneForce:
    """Coefficients of the fluid at a plane, or of all that a model holds where its structure stands apart. In ``z = x +
    jy`` a coefficient ``a + jb`` is ``[[a, -b], [b, a]]`` of x and y: ``Kxx = K0 - Mf lam^2 Om^2``, ``Kxy = -Kyx = D
    lam Om``, ``Cxx = D``, ``Cxy = -Cyx = 2 lam Om Mf``, ``Mxx = Mf``."""
    if plane not in model.planes:
        raise ValueError(unknown_name(f"plane of {model.name}", plane, model.planes))
    if plane in model.magnetic:
        raise ValueError(
            f"{plane} is in a magnetic bearing, whose delay makes stiffness and damping change with frequency: its "
            "force is Km + (Kp + Kd s) exp(-s tau), by the fitted parameters"
        )
    own = force_parameters(model)
    vector = np.where(own, theta, 0.0)
    parts = model.coefficients(vector, speed, eccentricity)[:3]
    found = model.functions.jacobian(vector, speed, eccentricity)
    size, count = parts.shape[-1], theta.size
    slopes = np.zeros((parts.shape[0], size, size, count), dtype=complex)
    kept = (found.inputs < count) & (found.powers < len(parts))
    at = (found.powers[kept], found.rows[kept], found.columns[kept], found.inputs[kept])
    np.add.at(slopes, at, found.values[kept])
    slopes *= own
    both = np.concatenate([parts[..., None], slopes], axis=-1)
    real = np.zeros((3, 2, 2, count + 1))
    if model.frame == "xy":
        rows = [model.coordinate(plane, axis) for axis in ("x", "y")]
        real[: len(both)] = both[:, rows][:, :, rows].real
    else:
        one = both[:, model.coordinate(plane, "z"), model.coordinate(plane, "z")]
        real[: len(both)] = np.stack([np.stack([one.real, -one.imag], 1), np.stack([one.imag, one.real], 1)], 1)
    return PlaneForce(values=real[..., 0], slopes=real[..., 1:])


def force_parameters(model: RotorModel) -> Bool:
    """Parameters that make the force at a plane: those of the fluid, or all where the structure stands apart."""
    whole = model.on_own_supports
    if whole.force_alone:
        return np.ones(len(model.parameters), dtype=bool)
    if whole.fluids:
        names = {q.name for fluid in whole.fluids for q in fluid.parameters}
        return np.array([name in names for name in model.parameter_names])
    if not {"K0", "D"} <= set(model.parameter_names):
        raise ValueError(f"{model.name} has no fluid force whose coefficients could be tabulated")
    names = {q.name for two in (False, True) for q in fluid_parameters(two)}
    return np.array([name in names for name in model.parameter_names])


def loop_stiffness(model: RotorModel, theta: Float, s: ComplexArray, speed: float, plane: str) -> ComplexArray:
    """Dynamic stiffness of the loop at a plane: of a magnetic bearing its controller's, else of all the force there."""
    if isinstance(model, KnownStructure) and plane in model.magnetic:
        return model.control(theta[:, None], s, plane)
    at = model.coordinate(plane, "z")
    own = np.where(force_parameters(model), theta, 0.0)
    coefficients = model.coefficients(own, np.full(len(theta), speed))[..., at, at]
    return np.asarray(coefficients @ s ** np.arange(coefficients.shape[1])[:, None])


def force_planes(model: RotorModel) -> tuple[str, ...]:
    """Planes at which a model has such a force; magnetic bearings have none that does not change with frequency."""
    typical = np.array([q.scale for q in model.parameters])
    apart = [plane for plane in model.planes if plane not in model.magnetic]
    return tuple(plane for plane in apart if plane_force(model, typical, 1.0, plane).values.any())


class LawCurve(NamedTuple):
    """A coefficient of the fluid against eccentricity: values ``(E,)``, derivatives by parameters ``(E, P)``."""

    name: str  # ``K0``, ``D``, ``lam``, or ``lam_D`` and ``lam_M``; ``Kxx``, ``Kxy``, ... of a model without fluids
    unit: str  # SI unit
    value: Float  # at each eccentricity, shape ``(E,)``
    slope: Float  # its derivatives by the model's parameters, shape ``(E, P)``


def changing_fluids(model: RotorModel) -> tuple[PlaneFluid, ...]:
    """The fluids whose values change; none of a model of one's own that is not made of fluids.

    Raises:
        ValueError: nothing changes.
    """
    found = tuple(fluid for fluid in model.fluids if fluid.law.parameters)
    if not found and not model.eccentricity_dependent:
        raise ValueError(f"{model.name} as used here does not change with eccentricity; give it a law")
    return found


def law_changes_with_speed(model: RotorModel) -> bool:
    """True if the law of a model gives other values at another speed."""
    return _curves(model, at_speed=True).by_speed


def law_curves(
    model: RotorModel, theta: ArrayLike, eccentricity: ArrayLike, speed: float | None = None
) -> tuple[LawCurve, ...]:
    """K0, D and lam (or lam_D and lam_M) at eccentricities ``(E,)``, at a speed or the law's reference speed; the
    coefficients of the journal's own force that change, of a model of one's own that is not made of fluids."""
    vector, eps = np.asarray(theta, dtype=float), np.asarray(eccentricity, dtype=float)
    curves = _curves(model, at_speed=speed is not None)
    at = np.full(eps.size, speed if speed is not None else 0.0)
    inputs = [*(np.full(eps.size, value) for value in vector), eps, at]
    flat = curves.kernel(inputs).reshape(vector.size + 1, len(curves.names), eps.size)
    return tuple(
        LawCurve(name, unit, flat[0, i], flat[1:, i].T)
        for i, (name, unit) in enumerate(zip(curves.names, curves.units, strict=True))
    )


class _Curves(NamedTuple):
    names: tuple[str, ...]
    units: tuple[str, ...]
    kernel: Callable[[Sequence[Float]], Float]
    by_speed: bool  # another speed gives other curves


@lru_cache(maxsize=64)
def _curves(model: RotorModel, *, at_speed: bool) -> _Curves:
    fluids = changing_fluids(model)
    found: dict[str, Any] = {}
    theta, speed, eccentricity, matrices, _ = model.symbolic
    p = SimpleNamespace(**dict(zip(model.parameter_names, ca.vertsplit(theta), strict=True)))
    for fluid in fluids:
        own = fluid.own(p)
        value = fluid.law.at_speed(own, eccentricity, speed) if at_speed else fluid.law.at(own, eccentricity)
        ratios = {name: getattr(own, name) * value.ratio for name in ("lam", "lam_D", "lam_M") if hasattr(own, name)}
        found |= {name + fluid.ending: curve for name, curve in {"K0": value.K0, "D": value.D, **ratios}.items()}
    units = [model.parameter(name).unit for name in found]
    if not fluids:
        at = journal(model).at
        for kind, matrix in zip("KCM", matrices, strict=False):
            pair = {f"{kind}xx": matrix.re[at, at], f"{kind}xy": -matrix.im[at, at]}
            found |= {name: curve for name, curve in pair.items() if ca.depends_on(curve, eccentricity)}
        units = [MATRIX_UNITS[name[0].replace("C", "D")] for name in found]
    curves = ca.vertcat(*found.values())
    graph = ca.densify(ca.horzcat(curves, ca.jacobian(curves, theta)))
    return _Curves(
        names=tuple(found),
        units=tuple(units),
        kernel=array_function(ca.Function("law_curves", [ca.vertcat(theta, eccentricity, speed)], [ca.vec(graph)])),
        by_speed=bool(ca.depends_on(curves, speed)),
    )
