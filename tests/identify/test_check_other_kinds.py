"""The data check of what is no perturbation test: imposed orbits, static loads, free vibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from checked import codes, found
from plain import plain_fit
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.identify.diagnosis.check import check
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import RingDownTest
from rotorfit.lab.kinds.static_test import StaticTest

# ---- imposed orbits ------------------------------------------------------------


def test_imposed_orbits() -> None:
    test = imposed()
    w = test.frequency
    assert check(test) == []
    assert codes(test.select(w > 0)) == {"one-direction"}
    assert codes(replace(test, displacement=test.displacement * 1e4)) == {"large-amplitude"}
    force = test.force_x.copy()
    force[4] = np.nan
    assert found(replace(test, force_x=force), "not-finite").rows == (4,)


def imposed() -> DisplacementTest:
    """The force of one mode in a fluid, ``K - M w^2 + j D (w - lam Omega)``, at a circular orbit, either way round."""
    w = np.r_[-100.0:-10:5, 10:100:5]
    along = (9e3 - 1.2 * w**2 + 60j * (w - 0.46 * 92.0)) * 5e-5
    phasor = np.where(w < 0, along.conj(), along)
    return DisplacementTest(
        run=np.full(w.size, "orbit"), plane=np.full(w.size, "seal"), speed=np.full(w.size, 92.0), frequency=w,
        displacement=np.full(w.size, 5e-5 + 0j), force_x=phasor, force_y=phasor * np.where(w < 0, 1j, -1j),
        sigma=np.full(w.size, np.nan),
    )  # fmt: skip


IMPOSED: dict[str, tuple[Callable[[DisplacementTest], DisplacementTest], str]] = {
    "x inverted": (lambda t: replace(t, force_x=-t.force_x), "wrong-direction"),
    "x and y exchanged": (lambda t: replace(t, force_x=t.force_y, force_y=t.force_x), "wrong-direction"),
    "lag as lead": (lambda t: replace(t, force_x=t.force_x.conj(), force_y=t.force_y.conj()), "wrong-direction"),
    "the bearing's forces": (lambda t: replace(t, force_x=-t.force_x, force_y=-t.force_y), "negative-damping"),
    "unsigned frequencies": (lambda t: replace(t, frequency=np.abs(t.frequency)), "turned-lines"),
}


@pytest.mark.parametrize("slip", IMPOSED)
def test_slips_of_imposed_orbits_are_errors(slip: str) -> None:
    change, code = IMPOSED[slip]
    assert check(imposed()) == []
    assert found(change(imposed()), code).severity == "error"


def test_an_orbit_of_no_size_is_an_error_and_no_fit(recwarn: pytest.WarningsRecorder) -> None:
    test = imposed()
    test = replace(test, displacement=np.where(np.arange(len(test)) == 3, 0, test.displacement))
    assert found(test, "no-orbit").rows == (3,)
    with refuses(ValueError):
        plain_fit(rf.models.OneMode(planes=("seal",)), test, known={"K": 0.0, "Ds": 0.0})
    assert not recwarn.list


# ---- loads and free vibration ------------------------------------------------------------------------------------


def under_load() -> StaticTest:
    """Positions ``P / (K - j D lam Omega)`` under loads downwards, at two speeds."""
    load = np.tile([0.5, 1.0, 2.0, 4.0], 2) * -1j
    speed = np.repeat([30.0, 60.0], 4)
    return StaticTest(
        run=np.repeat(["slow", "fast"], 4), speed=speed, load_plane=np.full(8, "journal"), load=load,
        plane=np.full(8, "journal"), displacement=load / (11e3 - 1j * 60 * 0.46 * speed), sigma=np.full(8, 1e-6),
    )  # fmt: skip


def swapped(z: Any) -> Any:
    return z.imag + 1j * z.real


LOADED: dict[str, tuple[Callable[[StaticTest], StaticTest], str, str]] = {
    "load told upwards": (lambda t: replace(t, load=-t.load), "against-load", "error"),
    "positions of the other sign": (lambda t: replace(t, displacement=-t.displacement), "against-load", "error"),
    "x and y exchanged": (lambda t: replace(t, displacement=swapped(t.displacement)), "against-load", "error"),
    "x mirrored": (lambda t: replace(t, displacement=-t.displacement.conj()), "against-rotation", "warning"),
}


@pytest.mark.parametrize("slip", LOADED)
def test_positions_against_load_or_rotation(slip: str) -> None:
    change, code, severity = LOADED[slip]
    assert check(under_load()) == []
    assert found(change(under_load()), code).severity == severity


def test_a_position_without_load_is_refused_in_words(recwarn: pytest.WarningsRecorder) -> None:
    test = under_load()
    test = replace(test, load=np.where(np.arange(len(test)) == 0, 0, test.load))
    assert found(test, "no-load").rows == (0,)
    with refuses(ValueError):
        plain_fit(rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=900.0), test)
    assert not recwarn.list


def test_times_in_milliseconds_and_records_that_do_not_move() -> None:
    t = np.arange(120) * 1e-3
    z = 4e-5 * np.exp((-30 + 75j) * t)
    record = RingDownTest(
        run=np.full(t.size, "r1"), speed=np.full(t.size, 157.0), time=t, x=z.real, y=z.imag,
        eccentricity=np.full(t.size, np.nan),
    )  # fmt: skip
    assert check(record) == []
    finding = found(replace(record, time=1e3 * t), "frequency-unit")
    assert finding.severity == "warning"
    hear(finding.message)
    assert found(replace(record, x=0 * t, y=0 * t), "ring-down").severity == "error"
