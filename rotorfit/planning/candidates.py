"""All lines of a design as a test that was not read yet, and the time that each takes."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.models import AnisotropicShaft, RotorModel, Turning
from rotorfit.models.array_types import Float, Index
from rotorfit.models.digits import significant
from rotorfit.models.motion.journal import journal
from rotorfit.models.motion.stability import decay_rate
from rotorfit.models.parameters import unknown_name
from rotorfit.planning.design import SENSE, Design
from rotorfit.planning.expectation import refuse_speed
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S

_TRANSIENT = 0.01
"""Share of a transient that is left when a line is read, and of the lag behind a sweep."""


def candidate_test(design: Design, model: RotorModel, theta: Float, band: float) -> PerturbationTest:
    """All lines with forces as large as the limits allow, to be read; runs are named by plane, speed and direction.
    Eigenvalues up to a band count."""
    planes = model.planes if design.force_planes is None else design.words("force_planes")
    if model.turns or isinstance(model, AnisotropicShaft | Turning):
        raise ValueError(
            f"{model.name} shows itself in images and twist, and a design has responses at the force's frequency "
            "only; give LineTests as patterns"
        )
    for plane in planes:
        if plane not in model.planes:
            raise ValueError(unknown_name(f"force plane of {model.name}", plane, model.planes))
    for speed in design.speeds.tolist():
        if decay_rate(model, theta, speed, band) < 0:
            refuse_speed(model, theta, speed, band)
    channels = _channels(design, model)
    columns: dict[str, list[Any]] = {}
    for plane, speed, way, level in product(planes, design.speeds.tolist(), design.words("directions"), design.levels):
        w = SENSE[way] * design.frequencies
        name = f"{plane} {speed * RPM_PER_RAD_S:.5g} rpm {way}" + (f" {level:.0%}" if len(design.levels) > 1 else "")
        force = level * _force(design, model, theta, plane, speed, w)
        for where, direction in channels:
            for key, cell in (
                ("run", name), ("speed", speed), ("frequency", w), ("force_plane", plane), ("force", force),
                ("plane", where), ("direction", direction),
            ):  # fmt: skip
                columns.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), w.shape))
    whole: dict[str, Any] = {key: np.concatenate(parts) for key, parts in columns.items()}
    unread = np.full(whole["speed"].size, np.nan)
    return PerturbationTest(**whole, response=unread + 0j, sigma=unread, source="design")


def _channels(design: Design, model: RotorModel) -> list[tuple[str, str]]:
    own = [
        (c.plane, direction)
        for c in model.coordinates
        if c.plane in model.read_planes
        for direction in ({"z": ("x", "y"), "r": ("rx", "ry")}.get(c.axis, (c.axis,)))
    ]
    if design.probes is None:
        return own
    found: list[tuple[str, str]] = []
    for name in design.words("probes"):
        plane, _, direction = name.rpartition(" ")
        named = [one for one in own if one == (plane, direction) or (one[0] == name and one[1] in "xy")]
        if not named:
            raise ValueError(unknown_name(f"probe of {model.name}", name, [*model.planes, *map(" ".join, own)]))
        found += named
    return list(dict.fromkeys(found))


def _force(design: Design, model: RotorModel, theta: Float, plane: str, speed: float, w: Float) -> Float:
    """Largest force at each line, N."""
    force = np.full(w.shape, math.inf if design.force_N is None else design.force_N)
    if design.mr_g_mm is not None:
        force = np.minimum(force, design.mr_g_mm * 1e-6 * w**2)
    if design.clearance_share is None:
        return force
    clearance = model.clearance if design.clearance_um is None else design.clearance_um * 1e-6
    if clearance is None:
        raise ValueError("clearance_share needs clearance_um: the model knows no clearance")
    place = model.coordinates[journal(model).at].plane if model.eccentricity_dependent else model.planes[-1]
    at = [i for i, c in enumerate(model.coordinates) if c.plane == place and c.axis != "r"]
    unit = model.force_vector(plane, w, np.ones(w.shape))
    # Of a fluid that changes with eccentricity, the force that keeps the journal at that eccentricity.
    receptance = model.receptance(theta, w, np.full(w.shape, speed), design.clearance_share)
    moved = np.abs(np.einsum("lij,lj->li", receptance, unit))[:, at].max(axis=1)
    return np.asarray(np.minimum(force, design.clearance_share * clearance / moved))


def line_times(
    design: Design, model: RotorModel, theta: Float, test: PerturbationTest, first: Index, band: float
) -> tuple[Float, Float]:
    """Times to settle and to average at lines of the test, given by their first rows, s."""
    speed, w = test.speed[first], test.frequency[first]
    if design.sweep_rpm_per_s is not None:
        steps = np.gradient(design.frequencies) if design.frequencies.size > 1 else np.zeros(1)
        order = np.searchsorted(design.frequencies, np.abs(w))
        return np.zeros(w.size), steps[order] / (design.sweep_rpm_per_s * RAD_S_PER_RPM)
    distinct, number = np.unique(speed, return_inverse=True)
    decay = np.array([float(decay_rate(model, theta, one, band)) for one in distinct.tolist()])
    return math.log(1 / _TRANSIENT) / decay[number], np.full(w.size, design.average_s)


def too_fast(design: Design, model: RotorModel, theta: Float, band: float) -> str:
    """A sentence where the sweep is too fast for the vibration to follow; else empty. A response swept at the rate r
    lags behind by about ``r / decay^2`` of itself at a resonance."""
    if design.sweep_rpm_per_s is None:
        return ""
    decay = min(float(decay_rate(model, theta, one, band)) for one in design.speeds.tolist())
    limit = _TRANSIENT * decay**2 * RPM_PER_RAD_S
    if design.sweep_rpm_per_s <= limit:
        return ""
    return (
        f"Sweep more slowly: at {significant(design.sweep_rpm_per_s, 3)} rpm/s the vibration lags by more "
        f"than {_TRANSIENT:.0%}; up to {significant(limit, 2)} rpm/s it follows."
    )
