"""Angles of forces that turn forward and backward, from a rig integrated in time as real x and y."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from plain import plain_fit
from scipy.integrate import solve_ivp
from sentences import refuses

import rotorfit as rf

TRUTH = {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4}
KNOWN = {name: TRUTH[name] for name in ("M", "K", "Ds")}
ANGLE, FORCE, SPEED = 25.0, 5.0, 150.0
Orbits = dict[float, tuple[complex, complex]]
FREQUENCIES = (-180.0, -130.0, -80.0, -40.0, 40.0, 80.0, 130.0, 180.0)


def orbit(w: float) -> tuple[complex, complex]:
    """Phasors of x and y relative to exp(+j|w|t) under a force that stands at 25 degrees when the mark gives its pulse.

    The force is ``F (cos(w t + a), sin(w t + a))``, w signed, which is what a protractor sees.
    """
    p = TRUTH
    turn = p["lam"] * SPEED
    k, cross = p["K"] + p["K0"] - p["Mf"] * turn**2, p["D"] * turn
    c, c_cross, m = p["Ds"] + p["D"], 2 * p["Mf"] * turn, p["M"] + p["Mf"]

    def motion(t: float, s: np.ndarray) -> list[float]:
        x, y, u, v = s
        at = w * t + np.radians(ANGLE)
        return [
            u,
            v,
            (FORCE * np.cos(at) - k * x - cross * y - c * u - c_cross * v) / m,
            (FORCE * np.sin(at) - k * y + cross * x - c * v + c_cross * u) / m,
        ]

    period = 2 * np.pi / abs(w)
    begin = np.ceil(0.6 / period) * period  # transients decay with about 40/s: e^-24
    t = begin + np.arange(64) / 64 * period
    found = solve_ivp(motion, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-9, atol=1e-13, method="DOP853").y
    x, y = (2 * np.mean(part * np.exp(-1j * abs(w) * t)) for part in found[:2])
    return complex(x), complex(y)


@pytest.fixture(scope="module")
def orbits() -> Orbits:
    return {w: orbit(w) for w in FREQUENCIES}


def table(path: Path, orbits: Orbits, column: str, forward: float, backward: float) -> Path:
    force = f"run,speed_rad_s,frequency_rad_s,force_plane,force_N,{column}"
    rows = [f"{force},plane,direction,amplitude_um,phase_lag_deg,sigma_um"]
    for w, readings in orbits.items():
        for direction, reading in zip("xy", readings, strict=True):
            force = f"{'forward' if w > 0 else 'backward'},{SPEED},{w},journal,{FORCE},{forward if w > 0 else backward}"
            lag = -np.degrees(np.angle(reading))
            rows.append(f"{force},journal,{direction},{abs(reading) * 1e6:.9g},{lag:.9g},0.01")
    path.write_text("\n".join([*rows, ""]))
    return path


def assert_true(fit: rf.FitResult) -> None:
    for name, value in TRUTH.items():
        # integrated to 1e-9 and written to nine digits
        assert fit.params[name].value == pytest.approx(value, rel=1e-5), name


@pytest.mark.parametrize(
    ("column", "forward", "backward"),
    [("force_angle_deg", 25, 25), ("force_phase_deg", 25, -25), ("force_phase_lag_deg", -25, 25)],
)
def test_a_weight_at_25_degrees_is_written_so(
    tmp_path: Path, orbits: Orbits, column: str, forward: float, backward: float
) -> None:
    test = rf.read(table(tmp_path / "rig.csv", orbits, column, forward, backward))
    assert_true(plain_fit(rf.models.OneMode(), test, known=KNOWN))
    rf.write(test, tmp_path / "again.csv")
    assert_true(plain_fit(rf.models.OneMode(), rf.read(tmp_path / "again.csv"), known=KNOWN))


def test_angles_of_backward_forces_given_as_phases_are_named(tmp_path: Path, orbits: Orbits) -> None:
    fit = plain_fit(
        rf.models.OneMode(), rf.read(table(tmp_path / "rig.csv", orbits, "force_phase_deg", 25, 25)), known=KNOWN
    )
    assert [finding.code for finding in fit.findings if finding.severity == "error"] == ["backward-angles"]
    assert "force_angle_deg in place of force_phase_deg" in fit.findings[0].message


def test_readings_z_at_signed_frequency_go_with_force_angle(orbits: Orbits) -> None:
    """``x + jy`` is ``z exp(jwt)``: from the phasors at exp(+j|w|t), without the formula of the code."""
    z = []
    for w, (x, y) in orbits.items():
        t = np.arange(16) / 16 * 2 * np.pi / abs(w)
        motion = (x * np.exp(1j * abs(w) * t)).real + 1j * (y * np.exp(1j * abs(w) * t)).real
        z.append(np.mean(motion * np.exp(-1j * w * t)))
    given = {"run": "r", "speed": SPEED, "frequency": list(orbits), "force_plane": "journal", "plane": "journal"}
    given |= {"direction": "z", "response": z, "sigma": 1e-8}
    test = rf.perturbation_test(**given, force=FORCE, force_angle=np.radians(ANGLE))
    assert_true(plain_fit(rf.models.OneMode(), test, known=KNOWN))
    with refuses(ValueError):
        rf.perturbation_test(**given, force=FORCE + 0j, force_angle=0.3)
    with refuses(ValueError):
        rf.perturbation_test(**given, force=FORCE, force_angle=0.3, force_direction="x")


def offsets(axis: Axes) -> list[tuple[float, float]]:
    """Places of the points that are drawn."""
    points = [some for some in axis.collections if isinstance(some, PathCollection)]
    return [(x, y) for some in points for x, y in some.get_offsets().tolist()]


def test_figures_show_the_phase_of_the_probe(tmp_path: Path, orbits: Orbits) -> None:
    """Of the motions integrated in time: the lead of the x probe on the force along x, forward and backward; figures
    count the angle in the direction of rotation, in which a probe that leads a backward force lags."""
    fit = plain_fit(rf.models.OneMode(), rf.read(table(tmp_path / "rig.csv", orbits, "force_angle_deg", 25, 25)))
    ratios = {
        w: x / (FORCE * np.exp(1j * np.sign(w) * np.radians(ANGLE))) * 1e6  # the force along x lags a backward angle
        for w, (x, _) in orbits.items()
    }
    _, phase = fit.plot.bode().axes
    points = dict(offsets(phase))
    marks = [complex(*at) for axis in fit.plot.polar().axes for at in offsets(axis)]
    predicted = fit.predict(list(orbits), SPEED, force_plane="journal", plane="journal").seen * 1e6
    assert len(points) == len(marks) == len(ratios)
    for (w, ratio), mean in zip(ratios.items(), predicted, strict=True):
        lead = min(points.items(), key=lambda at: abs(at[0] - w * 30 / np.pi))[1]
        off = np.radians(lead) - np.sign(w) * np.angle(ratio)  # whole turns are the same
        assert abs(np.degrees(np.angle(np.exp(1j * off)))) < 1e-3  # integrated to 1e-9
        counted = ratio if w > 0 else ratio.conjugate()
        assert min(abs(counted - mark) for mark in marks) < 1e-5 * abs(ratio)
        assert abs(mean - ratio) < 1e-4 * abs(ratio)


HEAD = "run,speed_rpm,frequency_rpm,force_plane,force_N,{columns},plane,direction,amplitude_um,phase_deg"
AWKWARD = {
    "both": (
        "force_angle_deg,force_phase_deg",
        "25,25",
        "both force_phase_deg and force_angle_deg are given",
    ),
    "neither": ("oil_C", "25", "missing columns: force_phase_deg"),
    "lag of an angle": ("force_angle_lag_deg", "25", "from x towards y does not lag"),
    "along an axis": (
        "force_angle_deg,force_direction",
        "25,x",
        "is the angle of a force along an axis",
    ),
    "blank": ("force_angle_deg", "", "a blank cell where a finite number is needed"),
}


@pytest.mark.parametrize(("columns", "cells", "sentence"), AWKWARD.values(), ids=list(AWKWARD))
def test_awkward_angles_are_one_sentence(tmp_path: Path, columns: str, cells: str, sentence: str) -> None:
    rows = [f"r,1500,{w},journal,2,{cells},journal,{d},40,-20" for w in (600, 700) for d in "xy"]
    (tmp_path / "t.csv").write_text("\n".join([HEAD.format(columns=columns), *rows, ""]))
    with pytest.raises(ValueError, match=sentence):
        rf.read(tmp_path / "t.csv")
