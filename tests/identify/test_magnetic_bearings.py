"""Magnetic bearings of a known shaft: gains and delay, the loop's sensitivity function, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses
from supported_shaft import FLUID, at_rest, dynamic_stiffness, held, magnets, matrices, model, motion, rotating

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.identify.uncertainty.stability.rotors import rotors_of
from rotorfit.models import KnownStructure, eigenvalues
from rotorfit.models.motion.stability import eigenvalue_gradient

TRUTH = FLUID | magnets()
MAGNETS = {name: value for name, value in TRUTH.items() if name.startswith("Km")}
ALONE = {"Km": -5e4, "Kp": 2e5, "Kd": 150.0, "tau": 4e-4}
MASS = 2.0


def one_mass():
    return KnownStructure([[MASS]], None, None, [[0.0]], planes={"disk": 0}, magnetic="disk", dofs=("z",))


@pytest.fixture(scope="module")
def fit():
    rng = np.random.default_rng(1)
    tests = [at_rest(rng, lines=60, magnetic=True), rotating(rng, lines=30, magnetic=True)]
    return plain_fit(model(magnetic=True), tests, known=MAGNETS)


def integrated(z, v, force, end, step=2e-5):
    """Position of the mass in time: Runge-Kutta with what was ``tau`` ago from the path's own cubics."""
    Km, Kp, Kd, tau = ALONE.values()
    behind = round(tau / step)
    path = np.zeros((round(end / step) + 1, 3))  # z, v and acceleration
    path[0, :2] = z, v

    def rate(t, state, before):
        return np.array([state[1], (force(t) - Km * state[0] - Kp * before[0] - Kd * before[1]) / MASS])

    def between(a, b):  # half way from one step to the next, to fourth order
        return (a[:2] + b[:2]) / 2 + step / 8 * (a[1:] - b[1:])

    for n in range(len(path) - 1):
        old, new = (path[k] if k >= 0 else np.zeros(3) for k in (n - behind, n - behind + 1))
        half = between(old, new) if n >= behind else np.zeros(2)
        t, y = n * step, path[n, :2]
        first = rate(t, y, old)
        path[n, 2] = first[1]
        second = rate(t + step / 2, y + step / 2 * first, half)
        third = rate(t + step / 2, y + step / 2 * second, half)
        fourth = rate(t + step, y + step * third, new)
        path[n + 1, :2] = y + step / 6 * (first + 2 * second + 2 * third + fourth)
    return np.arange(len(path)) * step, path[:, 0]


def test_response_and_decay_of_the_delayed_force_integrated_in_time():
    """The receptance of a steady motion; the eigenvalue, of Pade's fraction, of one that dies away."""
    known, w = one_mass(), 400.0
    theta = known.vector(ALONE)
    time, path = integrated(0.0, 0.0, lambda t: 10.0 * np.cos(w * t), 0.5)
    late = time > 0.3  # the decay rate is 27 1/s: exp(-8) is left, and stands beside the steady motion
    s = eigenvalues(known, theta, 0.0)
    slow = s[np.nanargmin(np.abs(s) + 1e6 * (s.imag < 0))]
    modes = np.exp(np.outer(time[late], [1j * w, -1j * w, slow, slow.conjugate()]))
    steady = np.linalg.lstsq(modes, path[late].astype(complex))[0]
    H = known.receptance(theta, np.array([w]), 0.0)[0, 0, 0]
    assert 2 * steady[0] / 10.0 == pytest.approx(H, rel=1e-5)
    time, path = integrated(1e-4, 0.0, lambda t: 0.0, 0.1)
    late = time > 0.02  # the roots of the delay itself have died away
    rows = np.column_stack([path[late][k : k - 1000 or None : 500] for k in (0, 500)])[:-1]
    after = path[late][1000::500][: len(rows)]
    step = np.roots([1.0, *-np.linalg.lstsq(rows, after)[0][::-1]])
    found = np.log(step.astype(complex)) / (500 * 2e-5)
    # |s| tau is 0.11: Pade's fraction is right to 3e-8.
    assert found[np.argmax(found.imag)] == pytest.approx(slow, rel=1e-5)


def test_response_of_a_shaft_from_full_matrices():
    known = model(magnetic=True)
    theta = known.vector(TRUTH)
    for w in (100.0, -300.0, 1500.0):
        x, y = motion(abs(w), 200.0, (1.0, -1j * np.sign(w)), magnetic=True)
        z = (x + 1j * y) / 2 if w > 0 else ((x - 1j * y) / 2).conj()
        H = known.receptance(theta, np.array([w]), 200.0)[0, :, 2]
        np.testing.assert_allclose(H, z[[1, 3, 5, 6, 7, 9, 11, 13]], rtol=1e-7)


def test_derivatives_by_gains_and_delay():
    """Of stiffness and eigenvalues, against differences; a delay of zero is a spring and a damper."""
    known, Om = model(magnetic=True), 200.0
    theta, s = known.vector(TRUTH), 1j * np.array([100.0, -1500.0])
    exact = known.known_stiffness(theta, s, np.full(2, Om))
    root = eigenvalues(known, theta, Om)
    root = root[np.nanargmin(np.abs(root))]
    by_root = eigenvalue_gradient(known, theta, Om, root)[1]
    for place, slope in zip(exact.inputs, exact.slopes, strict=True):
        step = np.zeros_like(theta)
        step[place] = 1e-5 * theta[place]
        above, below = (known.known_stiffness(theta + sign * step, s, np.full(2, Om)).values for sign in (1, -1))
        change = (above - below) / (2 * step[place])
        np.testing.assert_allclose(change, slope, rtol=1e-6, atol=1e-8 * np.abs(slope).max())
        near = [eigenvalues(known, theta + sign * step, Om) for sign in (1, -1)]
        above, below = (r[np.nanargmin(np.abs(r - root))] for r in near)
        assert (above - below) / (2 * step[place]) == pytest.approx(by_root[place], rel=1e-5)
    at_once = {name: 0.0 if name.startswith("tau") else value for name, value in TRUTH.items()}
    M, G, K = matrices()
    planes = dict(zip(known.planes, known.nodes.values(), strict=True))
    plain = KnownStructure(M, None, G, K, planes=planes, fluid="seal", supports=("left", "right"))
    sums = {f"Ks_{n}": at_once[f"Km_{n}"] + at_once[f"Kp_{n}"] for n in ("left", "right")}
    sums |= {f"Ds_{n}": at_once[f"Kd_{n}"] for n in ("left", "right")}
    w = np.array([100.0, -1500.0])
    np.testing.assert_allclose(
        known.receptance(known.vector(at_once), w, Om), plain.receptance(plain.vector(FLUID | sums), w, Om), rtol=1e-9
    )


def test_gains_delay_and_the_fluid_together(fit):
    assert fit.success
    assert 0.9 < fit.redchi < 1.1
    assert not fit.identifiability.unresolved
    for name, value in TRUTH.items():
        if fit.params[name].vary:
            assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name
            assert fit.params[name].stderr < 0.05 * abs(value), name
    # High modes of the shaft, far above what was tested, are driven by the delay: they do not count.
    assert not [warning for warning in fit.warnings if "unstable" in warning]
    assert fit.threshold_speed().value > fit.speeds.max()


def test_magnets_and_gains_are_told_apart_by_the_delay_alone(fit):
    """At frequencies where the delay is short no test gives Km beside Kp, and the fit says so."""
    known = {name: value for name, value in TRUTH.items() if not name.endswith("_left")}
    test = at_rest(np.random.default_rng(2), lines=60, magnetic=True)
    free = plain_fit(fit.model, test, known=known)
    assert {"Km_left", "Kp_left"} <= set(free.identifiability.unresolved)


def test_sensitivity_function_of_the_controller(fit):
    """The loop is opened at the controller, by hand 1/(1 + G C); the magnets' own stiffness stays with the rotor."""
    w = np.array([100.0, 400.0, 1100.0, 2000.0])
    found = rotors_of(fit, fit.thetas[:1], 0).sensitivity(np.concatenate([w, -w]), 250.0, "left")[0]
    for one, *pair in zip(w, found[:4], found[4:], strict=True):
        C = held("left", one, True)[0] - MAGNETS["Km_left"]
        opened = dynamic_stiffness(one, 250.0, magnetic=True)
        x, y = 2, 2 + len(opened) // 2
        opened[x, x] -= C
        opened[y, y] -= C
        G = np.linalg.inv(opened)
        by_hand = [abs(1 / (1 + (G[x, x] + sign * G[x, y]) * C)) for sign in (-1j, 1j)]
        np.testing.assert_allclose(pair, by_hand, rtol=0.02)


def test_from_files_to_the_verdict_on_the_loop(tmp_path, capsys):
    """One mass, whose sensitivity function is a formula: its interval holds the truth; a study says the same.

    Sensors of a magnetic bearing read what stands still too: there is no high-pass.
    """
    known, w = one_mass(), np.linspace(20.0, 900.0, 150)
    H = known.receptance(known.vector(ALONE), w, 0.0)[:, 0, 0]
    rng, sigma = np.random.default_rng(3), 2e-8
    z = H + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
    test = rf.perturbation_test(
        run="rest", frequency=w, speed=0.0, force_plane="disk", force=1.0, force_direction="x",
        plane="disk", direction="x", response=z, sigma=sigma,
    )  # fmt: skip
    rf.write(test, tmp_path / "rest.csv")
    np.savez(tmp_path / "mass.npz", M=[[MASS]], K=[[0.0]])
    (tmp_path / "study.toml").write_text(
        'files = ["rest.csv"]\nstructure = "mass.npz"\ndofs = ["z"]\nmagnetic = ["disk"]\n'
        f"[planes]\ndisk = 0\n[known]\nKm = {ALONE['Km']}\n[causes]\nhigh-pass = 0.0\n"
    )
    shaft = ["--structure", str(tmp_path / "mass.npz"), "--dofs", "z", "--planes", "disk=0", "--magnetic", "disk"]
    words = [
        "fit",
        str(tmp_path / "rest.csv"),
        *shaft,
        "--known",
        f"Km={ALONE['Km']}",
        "--cause",
        "high-pass=0",
        "--out",
        str(tmp_path / "out"),
    ]
    found = []
    for command in (words, ["run", str(tmp_path / "study.toml")]):
        assert cli.main([*command, "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["parameters"])
    assert found[0] == found[1]
    judged = ["judge", str(tmp_path / "out" / "fit.json"), "--sensitivity", "disk", "--max-speed", "600", "--json"]
    assert cli.main(judged) == 0
    answer = json.loads(capsys.readouterr().out)
    peak = next(c for c in answer["criteria"] if c["source"] == "sensitivity function")
    s = 1j * np.linspace(1.0, 900.0, 20_001)
    loop = (ALONE["Kp"] + ALONE["Kd"] * s) * np.exp(-s * ALONE["tau"]) / (MASS * s**2 + ALONE["Km"])
    low, high = peak["low"], peak["high"]
    assert low < np.abs(1 / (1 + loop)).max() < high < 1.3 * low  # 3 % of gain, 2 % of the probe's, and more


def test_what_a_magnetic_bearing_has_not(fit):
    assert fit.coefficients(200.0).plane == "seal"
    with refuses(ValueError):
        fit.coefficients(200.0, plane="left")
    assert list(fit.to_ross([0, 50, 100, 150, 200], version="3.1")) == ["seal"]
    with refuses(ValueError):
        fit.model.variant(magnetic="midspan")
