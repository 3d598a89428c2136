"""A turning element on orthotropic supports: all lines of one motion integrated in time, and fits of them."""

import numpy as np
import pytest
from plain import plain_fit, summary_words
from scipy.integrate import solve_ivp
from sentences import refuses
from shaft_setups import PERTURBED

import rotorfit as rf
from rotorfit.identify.fitting.anisotropy import lines_cut_off
from rotorfit.lab.simulation.shaft import Acquisition, Perturbation, record_shaft
from rotorfit.models import Chain, KnownStructure, Turning, TurningOnSupports
from rotorfit.models.motion.stability import growth_rate
from rotorfit.models.shafts.turning_on_supports import LINES

SPEED = 130.0
MODEL = TurningOnSupports(Turning(Chain(2), ("mass-1", "mass-2")), at="mass-2", terms=5)
TRUTH = {
    "M1": 0.8, "M2": 0.6, "K1": 2e4, "K2": 3e4, "K3": 2.5e4, "Ds1": 26.0, "Ds2": 29.0, "dK_cos": 1500.0,
    "dK_sin": -2500.0, "dKs": 3600.0, "dDs": 12.0, "angle_s": 0.4,
}  # fmt: skip
FORCE = 2.0


def pieces(v):
    """Mass, damping, stiffness and what turns and stands still, written down by hand."""
    K = np.array([[v["K1"] + v["K2"], -v["K2"]], [-v["K2"], v["K2"] + v["K3"]]])
    turning = complex(v["dK_cos"], v["dK_sin"]) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    way = np.exp(2j * v["angle_s"]) / 2
    still, rate = np.diag([0, v["dKs"] * way]), np.diag([0, v["dDs"] * way])
    return np.array([v["M1"], v["M2"]]), np.array([v["Ds1"], v["Ds2"]]), K, turning, still, rate


def integrated(w, forced, time):
    """Motion from rest of rotors with a force at one mass each, all at once, shape ``(2, rotors, T)``."""
    M, D, K, turning, still, rate = pieces(TRUTH)
    drive = FORCE * np.eye(2)[:, forced]

    def slope(t, state):
        z, v = state.reshape(2, 2, -1)
        pull = (turning * np.exp(2j * SPEED * t) + still) @ z.conj() + rate @ v.conj()
        force = drive * np.exp(1j * w * t)
        return np.concatenate([v, (force - D[:, None] * v - K @ z - pull) / M[:, None]]).ravel()

    start = np.zeros(4 * w.size, complex)
    found = solve_ivp(slope, (0.0, time[-1]), start, "DOP853", time, rtol=1e-9, atol=1e-15)
    return found.y.reshape(4, w.size, -1)[:2]


@pytest.fixture(scope="module")
def simulated():
    """Lines of both masses by least squares on the third second, in which transients are below 1e-11."""
    time = 2.0 + np.arange(700) / 700.0
    w = np.repeat(np.concatenate([-np.linspace(60.0, 330.0, 13), np.linspace(45.0, 310.0, 12)]), 2)
    forced = np.tile([0, 1], w.size // 2)
    motion = integrated(w, forced, time)
    orders = [(sign, k) for sign in (1, -1) for k in range(-5, 7)]
    amplitudes = {}
    for i in range(w.size):
        waves = np.exp(1j * time[:, None] * np.array([sign * w[i] + 2 * k * SPEED for sign, k in orders]))
        found = np.linalg.lstsq(waves, motion[:, i].T, rcond=None)[0]
        for name, (k, image) in LINES.items():
            amplitudes[float(w[i]), int(forced[i]), name] = found[orders.index((-1 if image else 1, k))]
    return amplitudes


def line_test(amplitudes, names, noise, seed):
    rng, rows = np.random.default_rng(seed), []
    planes = ("mass-1", "mass-2")
    for (w, forced, name), values in amplitudes.items():
        if name in names:
            for plane, value in zip(planes, values, strict=True):
                noisy = value + noise * complex(*rng.normal(size=2))
                rows.append((w, planes[forced], plane, name, noisy))
    w, force_plane, plane, line, response = (np.array(column) for column in zip(*rows, strict=True))
    count = w.size
    return rf.LineTest(
        run=np.full(count, "a"), speed=np.full(count, SPEED), frequency=w, force_plane=force_plane,
        force=np.full(count, FORCE + 0j), plane=plane, direction=np.full(count, "z"), line=line, response=response,
        sigma=np.full(count, noise),
    )  # fmt: skip


@pytest.mark.slow
def test_every_line_is_that_of_the_motion_in_time(simulated):
    theta, frame = MODEL.vector(TRUTH), MODEL.turning
    top = max(np.abs(values).max() for values in simulated.values())
    for (w, forced, name), values in simulated.items():
        place, image = MODEL.line_places[name], LINES[name][1]
        found = frame.receptance(theta, w - SPEED, SPEED)[2 * place : 2 * place + 2, forced] * FORCE
        # Lines cut off five beyond the pair change these by some 1e-6 of the largest; the integrator by 1e-8.
        assert np.abs((found.conj() if image else found) - values).max() < 1e-5 * top, (w, name)


@pytest.mark.slow
def test_both_anisotropies_and_their_angles_are_fitted(simulated):
    pulls = []
    for seed in range(4):
        test = line_test(simulated, ("w", "2Om-w", "-w", "w-2Om"), 4e-7, seed)
        fit = plain_fit(MODEL, test, known={"angle_s": None})
        assert fit.success
        assert 0.8 < fit.redchi < 1.2  # 800 real data: 1 to 5 %
        pulls.append([(fit.params[n].value - TRUTH[n]) / fit.params[n].stderr for n in MODEL.parameter_names])
    assert np.abs(pulls).max() < 4.0
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.35  # 48 pulls
    shape = fit.turning_anisotropy()
    g = 0.5 * np.arctan2(-2500.0, 1500.0)
    assert shape.dK.value == pytest.approx(np.hypot(1500.0, 2500.0), abs=4 * shape.dK.stderr)
    assert shape.angle.value == pytest.approx(g, abs=4 * shape.angle.stderr)
    size, share = lines_cut_off(fit)
    assert 0 < size < 1e-6
    assert share < 1e-3
    assert "lines left out change those fitted by" in summary_words(fit)


def test_what_is_cut_off_is_said_with_figures_and_files(simulated, tmp_path):
    few = plain_fit(MODEL.variant(terms=2), line_test(simulated, ("w", "2Om-w", "-w", "w-2Om"), 4e-7, 0))
    size, share = lines_cut_off(few)
    exact, cut = (
        m.turning.receptance(m.vector(TRUTH), 90.0 - SPEED, SPEED)[:2, 0] for m in (MODEL, MODEL.variant(terms=2))
    )
    assert np.abs(cut - exact).max() < 1.5 * size * np.abs(few.problem.blocks[0].measured).max() / FORCE
    assert few.thetas[0][-1] == 0.0  # angle_s, known unless freed
    assert share > 1e-3
    few.save(tmp_path / "fit.json")
    assert rf.load_fit(tmp_path / "fit.json").model.terms == 2
    assert len(few.plot.lines().axes) == 2 * 16  # four lines at two planes under two forces
    assert len(few.plot.stability().axes) == 2
    found = [frequency.value for frequency, *_ in few.natural_frequencies(SPEED)]
    assert len(found) == 4  # of two masses, none of them told again at 2 Om more or less


def test_a_support_taken_for_round_does_not_explain_the_lines(simulated):
    test = line_test(simulated, ("w", "2Om-w"), 4e-7, 1)
    both = plain_fit(MODEL, test, known={"angle_s": TRUTH["angle_s"]})
    assert both.redchi < 1.2  # 400 data: 7 %
    assert plain_fit(MODEL.rotor, test).redchi > 1.5
    assert abs(both.params["dKs"].value - TRUTH["dKs"]) < 4 * both.params["dKs"].stderr


def test_free_motion_grows_as_its_monodromy_says():
    """Floquet multipliers of one turn's half, over which all coefficients repeat."""
    unstable = TRUTH | {"Ds1": 4.0, "Ds2": 4.0, "dDs": 1.0}
    M, D, K, turning, still, rate = pieces(unstable)
    for speed in (130.0, 178.0):

        def slope(t, state, speed=speed):
            x, v = state[:4].reshape(2, 2), state[4:].reshape(2, 2)
            z, dz = x[0] + 1j * x[1], v[0] + 1j * v[1]
            pull = (turning * np.exp(2j * speed * t) + still) @ z.conj() + rate @ dz.conj()
            a = (-D * dz - K @ z - pull) / M
            return np.concatenate([v.ravel(), a.real, a.imag])

        period = np.pi / speed
        columns = [solve_ivp(slope, (0, period), unit, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1] for unit in np.eye(8)]
        growth = np.log(np.abs(np.linalg.eigvals(np.array(columns).T)).max()) / period
        model = TurningOnSupports(MODEL.rotor, at="mass-2", terms=9)
        assert growth_rate(model, model.vector(unstable), speed) == pytest.approx(growth, abs=1e-5 * 178.0)


def test_what_makes_no_such_rotor_is_refused_in_words(simulated):
    with refuses(ValueError):
        TurningOnSupports(Chain(2))
    M, D, K, *_ = pieces(TRUTH)
    nodes = {"mass-1": 0, "mass-2": 1}
    structure = KnownStructure(np.diag(M), np.diag(D), None, K, planes=nodes, fluid="mass-2", dofs=("z",))
    with refuses(ValueError):
        TurningOnSupports(Turning(structure))
    with refuses(ValueError):
        TurningOnSupports(MODEL.rotor, terms=0)
    with refuses(ValueError):
        TurningOnSupports(MODEL.rotor, at="seal")
    with refuses(ValueError):
        rf.models.Orthotropic(MODEL.rotor)
    test = line_test(simulated, ("w", "-w"), 1e-7, 0)
    with refuses(ValueError):
        plain_fit(MODEL.rotor, test)


@pytest.mark.slow
def test_both_anisotropies_come_from_volts(tmp_path):
    shaft = rf.models.AnisotropicShaft(torsion=None)
    truth = {
        "M": 1.0,
        "D": 25.0,
        "K": 4e4,
        **shaft.components(1500.0, 0.6),
        "ec": 4e-6,
        "es": 0.0,
        "Px": 0.0,
        "Py": 0.0,
    }
    support = 1200.0 * np.exp(2j * 0.3)
    sweep = Perturbation(mr=2e-5, first=60.0, last=320.0, forward=False, heavy_spot=0.4)
    path = record_shaft(
        tmp_path / "sweep.h5", shaft, truth, SPEED, 8.0, perturbation=sweep, support=support,
        acquisition=Acquisition(sample_rate=1600.0),
    )  # fmt: skip
    (tmp_path / "rig.toml").write_text(PERTURBED)
    test = rf.shaft_lines(rf.read_recording(path, tmp_path / "rig.toml"), supports=True)
    rotor = TurningOnSupports(Turning(Chain(1, planes=("disk",))))
    free = [name for name in ("M1", "K1", "Ds1") if name in rotor.parameter_names]
    assert len(free) == 3
    fit = plain_fit(rotor, test, known={"angle_s": None, "dDs": 0.0, "K2": 0.0})
    expected = {"M1": 1.0, "K1": 4e4, "Ds1": 25.0, "dK_cos": truth["dK_cos"], "dK_sin": truth["dK_sin"]}
    for name, value in expected.items():
        assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name
    found, angle = fit.params["dKs"], fit.params["angle_s"]
    turned = 0.0 if found.value > 0 else np.pi / 2  # the greater stiffness along one direction, or the lesser across
    assert abs(abs(found.value) - 2400.0) < 4 * found.stderr
    assert abs(np.angle(np.exp(2j * (angle.value + turned - 0.3))) / 2) < 4 * angle.stderr
