"""A machine with three probes, two weights and no force at a probe: what its modes tell, and what they do not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.models.motion.stability import whirl_sense

RPM = np.pi / 30
MASS, WN, ZETA, PHI = 40.0, 300.0, 0.05, 0.6  # of the mode, and the participation of the weights at B
GAINS = {("de", "x"): 1.0, ("de", "y"): 0.9 * np.exp(-1.4j), ("nde", "x"): -0.7 + 0.1j}


@cache
def weighed(noise: float = 2e-8) -> rf.PerturbationTest:
    """Responses to weights at A and B over speed, a sum over one mode with nothing of the package in it."""
    rng, w = np.random.default_rng(4), np.linspace(60.0, 480.0, 70)
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("force_plane", "force", "plane", "direction", "z")}
    for weight, share in (("A", 1.0), ("B", PHI)):
        for (plane, axis), gain in GAINS.items():
            force = 2e-4 * w**2
            motion = gain * share * force / (MASS * (WN**2 - w**2 + 2j * ZETA * WN * w))
            own = (np.full(w.size, weight), force + 0j, np.full(w.size, plane), np.full(w.size, axis))
            error = noise * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
            for values, column in zip((*own, motion + error), columns.values(), strict=True):
                column.append(values)
    found = {name: np.concatenate(parts) for name, parts in columns.items()}
    speed = np.tile(w, 2 * len(GAINS))
    return rf.PerturbationTest(
        run=found["force_plane"],
        speed=speed,
        frequency=speed,
        force_plane=found["force_plane"],
        force=found["force"],
        plane=found["plane"],
        direction=found["direction"],
        response=found["z"],
        sigma=np.full(speed.size, noise),
        source="three probes",
    )


@cache
def fitted() -> rf.FitResult:
    return plain_fit(rf.models.Modal(("de", "nde", "A", "B"), force_planes=("A", "B"), residuals=False), weighed())


def test_a_probe_that_is_not_there_has_no_gain() -> None:
    fit = fitted()
    assert fit.model.options()["probe_planes"] == ("de", "nde.x")
    assert set(fit.params) - {"phi_B_im"} == {
        "M",
        "wn",
        "zeta",
        "phi_B",
        "g_nde_x",
        "g_nde_x_im",
        "g_de_y",
        "g_de_y_im",
    }
    own = {"M": MASS, "wn": WN, "zeta": ZETA, "phi_B": PHI}
    # A force that turns forward is -j times that along x where it acts along y.
    for name, gain in (("g_nde_x", GAINS["nde", "x"]), ("g_de_y", GAINS["de", "y"] / -1j)):
        own |= {name: complex(gain).real, f"{name}_im": complex(gain).imag}
    for name, true in own.items():
        q = fit.params[name]
        assert abs(q.value - true) < 4 * q.stderr, name
    assert "one probe, along x, at nde: motion across is not known" in fit.summary().replace("\n  ", " ")
    assert [list(axis.get_xticks()) for axis in fit.plot.mode_shapes().axes] == [[0, 1], [0]]


def test_motion_where_no_probe_was_is_predicted_by_nobody() -> None:
    fit = fitted()
    at = {"frequency": None, "speed_rpm": 2000.0, "mr": 1e-4}
    seen = fit.predict(force_plane="B", plane="nde", **at)
    w = 2000.0 * RPM
    true = GAINS["nde", "x"] * PHI * 1e-4 * w**2 / (MASS * (WN**2 - w**2 + 2j * ZETA * WN * w))
    assert abs(seen.response[0] - true) < 4 * abs(seen.stderr[0])
    for options in (
        {"force_plane": "A"},
        {"force_plane": "A", "plane": "nde", "direction": "y"},
        {"force_plane": "de"},
        {"force_plane": "A", "plane": "nnde"},
    ):
        with refuses(ValueError):
            fit.predict(**at, **options)
    for options in ({}, {"plane": "B"}, {"unbalance_g_mm": {"nde": 100.0}}):
        with refuses(ValueError):
            fit.stability_report(**{"max_speed_rpm": 4500.0, "unbalance_g_mm": {"A": 100.0}, **options})
    judged = fit.stability_report(max_speed_rpm=4500.0, unbalance_g_mm={"A": 100.0}, plane="nde")
    curve = judged.unbalance[0]
    peak = abs(GAINS["nde", "x"]) * 1e-4 / (2 * ZETA * np.sqrt(1 - ZETA**2) * MASS)
    assert curve.y[curve.x < 400].max() == pytest.approx(peak, rel=0.01)


def test_modes_that_no_speed_tells_apart_have_no_sense() -> None:
    """Two coordinates with one natural frequency are one mode, and nobody knows its sense."""
    fit = fitted()
    (mode,) = fit.stability_report(max_speed_rpm=4500.0).modes
    assert mode.direction == "sense unknown"
    assert mode.frequency == pytest.approx(WN * np.sqrt(1 - ZETA**2), rel=1e-3)
    table = fit.summary().split("MODES")[1].splitlines()
    assert [line.split()[0] for line in table[1:3] if line] == ["1"]
    labels = [text.get_text() for text in fit.plot.stability().axes[0].texts]
    assert "1 2861" in labels


def test_the_sense_of_a_mode_is_that_of_its_orbit_and_not_the_sign_of_a_zero() -> None:
    """A light journal in fluid: overdamped at rest, forward with the fluid; so in z as in x and y."""
    M, D, K, lam, w = 0.5, 400.0, 9e3, 0.45, 150.0
    z = rf.models.OneMode()
    values = dict.fromkeys(z.parameter_names, 0.0) | {"M": M, "K": K, "D": D, "lam": lam}
    xy = rf.models.Anisotropic()
    plain = dict.fromkeys(xy.parameter_names, 0.0) | {"Kxx": K, "Kyy": K, "Dxx": D, "Dyy": D, "Mxx": M, "Myy": M}
    for speed, expected in ((0.0, {0}), (w, {1, -1})):
        cross = {"Kxy": lam * speed * D, "Kyx": -lam * speed * D}
        for model, own in ((z, values), (xy, plain | cross)):
            theta = model.vector(own)
            s = rf.models.eigenvalues(model, theta, speed)
            sense = whirl_sense(model, theta, speed, s)
            assert set(sense.tolist()) == expected, (model.name, speed)
    roots = np.roots([M, D, K - 1j * D * lam * w])
    slow = roots[np.argmin(np.abs(roots))]
    s = rf.models.eigenvalues(z, z.vector(values), w)
    at = s[[np.argmin(np.abs(s - slow))]]
    assert whirl_sense(z, z.vector(values), w, at).tolist() == [1]


def test_why_weights_alone_give_no_threshold() -> None:
    """At w = Om a fluid pushes with j D (w - lam Om) = j D (1 - lam) w, one number."""
    rng, w, noise = np.random.default_rng(2), np.linspace(20.0, 300.0, 60), 2e-7
    force = 1e-4 * w**2
    motion = force / (25e3 - 1.6 * w**2 + 1j * (5.0 + 300.0 * (1 - 0.45)) * w)
    read = np.concatenate([motion, -1j * motion]) + noise * (rng.normal(size=120) + 1j * rng.normal(size=120))
    both, axis = np.tile(w, 2), np.repeat(["x", "y"], w.size)
    at = np.full(axis.size, "journal")
    test = rf.PerturbationTest(
        run=at, speed=both, frequency=both, force_plane=at, force=np.tile(force, 2) + 0j, plane=at, direction=axis,
        response=read, sigma=np.full(axis.size, noise), source="weights",
    )  # fmt: skip
    with refuses(ValueError):
        rf.fit(rf.models.OneMode(), test)
    fit = plain_fit(rf.models.OneMode(), test, known={"Mf": 0.1, "Ds": 5.0, "K0": 5e3})
    assert set(fit.identifiability.unresolved) == {"M", "D", "lam"}
    text = " ".join(fit.summary().split())
    assert "threshold speed: not determined by these data: all forces turn with the shaft (1x)" in text
    assert "identifiability: 3 of 4 parameter combinations determined, condition number inf M, D, lam only" in text
    known = plain_fit(rf.models.OneMode(), test, known={"Mf": 0.1, "Ds": 5.0, "K0": 5e3, "lam": 0.45})
    assert abs(known.params["D"].value - 300.0) < 4 * known.params["D"].stderr
    assert "all forces turn with the shaft" not in known.summary()
