"""Uncertainty of calibration as nuisance parameters: what every reading of a probe, or of a test, has in common.

A probe that reads 1 % high, a trial weight that is 0.5 % heavier than its label, or a Keyphasor notch 1 deg off its
mark spoils all readings alike: more readings do not help, and the residuals hardly show it. Each such error is an entry
of the fitted vector with a normal prior about zero, so that it reaches every parameter with its correlations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.observations import Block, Responses, acts_alone
from rotorfit.lab.data.experiments import Experiment, PerturbationTest

Uncertainty = float | Mapping[str, float]

NUISANCE_KINDS = {
    "gain": ("1", "relative error of the probe's gain"),
    "probe_phase": ("rad", "phase error of the probe"),
    "mr": ("1", "relative error of the force's amplitude"),
    "keyphasor": ("rad", "error of the phase reference against the force"),
}
"""Unit and meaning of each kind of nuisance entry, the name being the kind or ``kind[where]``."""

_USELESS = {"probe_gain": 0.5, "probe_phase_deg": 90.0, "mr": 0.5, "keyphasor_deg": 90.0}
"""Uncertainties from which on nothing is calibrated: rather per cent where a fraction is wanted."""


@dataclass(frozen=True)
class Calibration:
    """Standard uncertainties of a calibration (GUM type B); zero where nothing is said.

    Attributes:
        probe_gain: relative uncertainty of each probe's gain, probes being independent; a number for all of them or a
            mapping by plane (``{"disk": 0.01}``) or by plane and direction (``{"disk.x": 0.01}``).
        probe_phase_deg: uncertainty of each probe's phase, degrees, likewise.
        mr: relative uncertainty of the force's amplitude (mass-radius product), the same error in all runs; a mapping
            by force plane gives each plane a weight, and an error, of its own.
        keyphasor_deg: uncertainty of the angle between phase reference and force, degrees, the same error in all runs.

    Example:
        >>> gains = rf.Calibration(probe_gain=0.01)
        >>> wider = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0}, calibration=gains)
        >>> wider.params["D"].stderr > fit.params["D"].stderr
        True
    """

    probe_gain: Uncertainty = 0.0
    probe_phase_deg: Uncertainty = 0.0
    mr: Uncertainty = 0.0
    keyphasor_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, most in _USELESS.items():
            given = getattr(self, name)
            for where, value in given.items() if isinstance(given, Mapping) else [("", given)]:
                said = f"{name} of {where} is {value!r}" if where else f"{name} is {value!r}"
                if not (isinstance(value, (int, float)) and math.isfinite(value) and value >= 0):
                    raise ValueError(f"{said}; a standard uncertainty is zero or a positive number")
                if value >= most:
                    unit = "degrees" if name.endswith("_deg") else "as a fraction, 0.02 for 2 %"
                    raise ValueError(f"{said}; it is below {most:g} ({unit})")
        if not any(np.any(list(v.values()) if isinstance(v, Mapping) else v) for v in vars(self).values()):
            raise ValueError("every uncertainty of the calibration is zero: give at least one")


def calibration_of(values: Mapping[str, Any]) -> Calibration | None:
    """A calibration from names and values, none from none."""
    if not values:
        return None
    names = [f.name for f in fields(Calibration)]
    for name in values:
        if name not in names:
            raise ValueError(unknown_name("uncertainty of calibration", name, names))
    return Calibration(**values)


_Column = tuple[str, float, list[ComplexArray]]
"""A nuisance entry: its name, the standard deviation of its normal prior, 1 or rad, and for each block by how much it
changes the logarithm of predictions, shape ``(R,)``."""


def nuisance_entries(
    calibration: Calibration, experiments: Sequence[Experiment], blocks: Sequence[Block]
) -> list[_Column]:
    """Lay a calibration out as nuisance entries ``gain[disk]``, ``probe_phase[disk]``, ``mr``, ``keyphasor``. An
    isotropic model sees the mean of the x and the y probe of a plane: the errors of both are then one entry, with the
    uncertainty of their mean."""
    pairs = []
    for test, block in zip(experiments, blocks, strict=True):
        only = f"{getattr(test, 'source', '') or type(test).__name__}: a calibration can be given for"
        if not isinstance(test, PerturbationTest) or not isinstance(block, Responses) or block.imposed:
            raise ValueError(f"{only} responses to rotating forces of linear models only")
        if block.model.eccentricity_dependent:
            raise ValueError(f"{only} linear models only, without a law of eccentricity")
        pairs.append((test, block))
    probes = [_probes(test, block) for test, block in pairs]
    columns = [
        *_probe_columns("gain", "probe_gain", calibration.probe_gain, 1.0, pairs, probes),
        *_probe_columns("probe_phase", "probe_phase_deg", calibration.probe_phase_deg, math.pi / 180, pairs, probes),
        *_force_columns(calibration.mr, pairs),
    ]
    if calibration.keyphasor_deg:
        columns.append(("keyphasor", math.radians(calibration.keyphasor_deg), [block.by_phase for _, block in pairs]))
    return columns


def _probe_columns(
    kind: str,
    option: str,
    given: Uncertainty,
    unit: float,
    pairs: Sequence[tuple[PerturbationTest, Responses]],
    where: Sequence[list[tuple[_Probe, ...]]],
) -> list[_Column]:
    if not given:
        return []
    every = list(dict.fromkeys(group for groups in where for group in groups if group))
    probes = list(dict.fromkeys(probe for group in every for probe in group))
    by_place = given if isinstance(given, Mapping) else dict.fromkeys((plane for plane, _ in probes), float(given))
    _refuse_unknown(option, by_place, [*(plane for plane, _ in probes), *(f"{p}.{d}" for p, d in probes)])
    error = {(p, d): unit * by_place.get(f"{p}.{d}", by_place.get(p, 0.0)) for p, d in probes}
    # Probes that are always read together, the others one by one.
    together = [g for g in every if all(g == other or not set(g) & set(other) for other in every)]
    merged = [*together, *((probe,) for probe in probes if not any(probe in g for g in together))]
    planes = [members[0][0] for members in merged]
    columns: list[_Column] = []
    for members, plane in zip(merged, planes, strict=True):
        sd = math.sqrt(sum(error[p] ** 2 for p in members)) / len(members)
        if sd == 0:
            continue
        parts = []
        for (_, block), groups in zip(pairs, where, strict=True):
            share = np.array([len(set(members) & set(group)) / len(group) if group else 0.0 for group in groups])
            one = np.ones(block.measured.size, dtype=complex) if kind == "gain" else block.by_phase
            parts.append(one * share[block.coordinate])
        place = plane if planes.count(plane) == 1 else f"{plane}.{'+'.join(direction for _, direction in members)}"
        columns.append((f"{kind}[{place}]", sd, parts))
    return columns


_Probe = tuple[str, str]


def _probes(test: PerturbationTest, block: Responses) -> list[tuple[_Probe, ...]]:
    """Probes (plane, direction) that the readings of each coordinate of the model come from."""
    seen = sorted(set(zip(test.plane.tolist(), test.direction.tolist(), strict=True)))
    return [
        tuple(
            (plane, way)
            for plane, way in seen
            if plane == coordinate.plane
            and way.startswith("r") == (coordinate.axis == "r")
            and (block.model.frame == "z" or way == coordinate.axis)
        )
        for coordinate in block.model.coordinates
    ]


def _force_columns(given: Uncertainty, pairs: Sequence[tuple[PerturbationTest, Responses]]) -> list[_Column]:
    """The force is what it was taken for, times 1 + error: a larger error means a larger response than expected."""
    if not given:
        return []
    if not isinstance(given, Mapping):
        return [("mr", float(given), [np.ones(block.measured.size, dtype=complex) for _, block in pairs])]
    planes = list(dict.fromkeys(plane for test, _ in pairs for plane in test.force_planes))
    _refuse_unknown("mr", given, planes)
    columns: list[_Column] = []
    for plane in planes:
        if given.get(plane):
            parts = []
            for _, block in pairs:
                at = [c.plane == plane for c in block.model.coordinates]
                forced = np.asarray(block.force[:, at].any(axis=1))
                if (forced & ~acts_alone(block)).any():
                    raise ValueError(
                        f"mr names {plane}, where forces act at once with others: how far one of them moves a reading "
                        "is not in the reading; give one number for all forces"
                    )
                parts.append(np.asarray(forced[block.line], dtype=complex))
            columns.append((f"mr[{plane}]", float(given[plane]), parts))
    return columns


def _refuse_unknown(option: str, given: Mapping[str, Any], names: Sequence[str]) -> None:
    unknown = [name for name in given if name not in names]
    if unknown:
        raise ValueError(f"{option} names {', '.join(unknown)}; the data have {', '.join(dict.fromkeys(names))}")
