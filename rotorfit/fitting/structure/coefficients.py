"""Coefficients of a fitted bearing or seal, with their errors by the fit's covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.fitting.quantities import Quantity
from rotorfit.fitting.structure.coefficient_rows import UNITS, CoefficientRows, Coefficients
from rotorfit.models import Anisotropic
from rotorfit.models.array_types import Float
from rotorfit.models.digits import significant
from rotorfit.models.shafts.angular_rates import angular_rate
from rotorfit.models.shafts.plane_forces import COEFFICIENTS, force_planes, plane_force
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult


def coefficients_of(
    fit: FitResult, speed: float, plane: str | None, at: Mapping[str, Any] | None, eccentricity: float
) -> Coefficients:
    """See :meth:`FitResult.coefficients`."""
    speed = angular_rate(speed)
    planes = force_planes(fit.model)
    if plane is None and len(planes) > 1:
        raise ValueError(f"{fit.model.name} has forces at {', '.join(planes)}: say at which, plane={planes[0]!r}")
    where = plane or planes[0]
    group = fit.group(_at_speed(fit, speed) if at is None else at)
    force = plane_force(fit.model, fit.thetas[group], speed, where, eccentricity)
    values, slopes = force.values.reshape(-1), force.slopes.reshape(len(COEFFICIENTS), -1)

    def propagated(value: float, by_values: Float, unit: str) -> Quantity:
        return fit.propagate_in(group, value, by_values @ slopes, unit)

    by_name = {
        name: propagated(value, unit, UNITS[name[0]])
        for name, value, unit in zip(COEFFICIENTS, values.tolist(), np.eye(values.size), strict=True)
    }
    pulled = np.array([fit.problem.space.pull_back(row, group) for row in slopes])
    covariance = pulled @ fit.covar @ pulled.T
    for place, name in enumerate(COEFFICIENTS):
        if not math.isfinite(by_name[name].stderr):
            covariance[place, place] = by_name[name].stderr
    return Coefficients(
        speed=speed,
        condition=_condition(fit, group, speed),
        group=group,
        plane=where,
        values=values,
        covariance=covariance,
        by_name=by_name,
        propagated=propagated,
    )


def _at_speed(fit: FitResult, speed: float) -> Mapping[str, Any] | None:
    """The group of a speed where parameters were fitted speed by speed."""
    if set(fit.settings.per.values()) != {"speed_rpm"}:
        return None
    rpm = speed * RPM_PER_RAD_S
    tested = fit.speeds * RPM_PER_RAD_S
    nearest = float(tested[np.argmin(np.abs(tested - rpm))])
    if abs(nearest - rpm) > 1e-3 * max(abs(nearest), 1.0):
        there = ", ".join(significant(value, 5) for value in tested.tolist())
        raise ValueError(
            f"parameters were fitted speed by speed, at {there} rpm; {significant(rpm, 5)} rpm is none of them"
        )
    return {"speed_rpm": float(np.round(nearest, 6))}


def _condition(fit: FitResult, group: int, speed: float) -> str:
    """Name of a condition: the speed, after what else parameters were fitted per."""
    others = filter(None, map(_without_speed, fit.problem.space.labels[group]))
    return ", ".join([*dict.fromkeys(others), f"{significant(speed * RPM_PER_RAD_S, 5)} rpm"])


def _without_speed(label: str) -> str:
    """A label of a group, such as ``speed_rpm+pressure_bar=3000+2``, without its speed."""
    names, _, values = label.partition("=")
    pairs = list(zip(names.split("+"), values.split("+"), strict=False))
    if len(pairs) < values.count("+") + 1:
        return label
    return ", ".join(f"{name}={value}" for name, value in pairs if name != "speed_rpm")


def of_a_rig(fit: FitResult) -> bool:
    """True if a fit is of a seal or bearing alone, its rig taken out or left to the coefficients."""
    rig = fit.settings.baseline is not None or fit.settings.stator_mass_kg is not None
    if not (fit.success and fit.speeds.size and (rig or isinstance(fit.model, Anisotropic))):
        return False
    return len(force_planes(fit.model)) == 1


def coefficient_rows(fit: FitResult, speeds: Sequence[float] | None, plane: str | None) -> CoefficientRows:
    """See :meth:`FitResult.coefficient_table`."""
    by_speed = len(fit.thetas) == 1 or set(fit.settings.per.values()) == {"speed_rpm"}
    if by_speed:
        chosen = fit.speeds.tolist() if speeds is None else list(speeds)
        return CoefficientRows(tuple(coefficients_of(fit, speed, plane, None, 0.0) for speed in chosen))
    tested = [block for block in map(responses_of, fit.problem.blocks) if block is not None]
    pairs = {(g, round(v, 9)) for b in tested for g, v in zip(b.group.tolist(), b.set_speed.tolist(), strict=True)}
    wanted = sorted(pairs if speeds is None else {(group, speed) for group, _ in pairs for speed in speeds})
    labels = fit.problem.space.labels
    at = [dict(label.split("=", 1) for label in labels[group]) for group, _ in wanted]
    return CoefficientRows(
        tuple(coefficients_of(fit, speed, plane, own, 0.0) for (_, speed), own in zip(wanted, at, strict=True))
    )
