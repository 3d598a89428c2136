"""The physics, each statement against another formulation of it."""

from __future__ import annotations

import csv
import pickle

import casadi as ca
import numpy as np
import pytest
from beams import frequencies, shaft, solid_disk
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from own_model import Disk
from scipy.integrate import solve_ivp
from sentences import refuses
from synthetic import MODELS, SPEEDS, TYPICAL

import rotorfit as rf
from rotorfit.models import (
    Anisotropic,
    OneMode,
    Overhung,
    Parameter,
    TwoDisk,
    WhirlWhip,
    eigenvalues,
    threshold_speed,
)
from rotorfit.models.complexes import Complex
from rotorfit.models.motion.stability import eigenvalue_gradient, growth_rate, least_stable

EPS = np.finfo(float).eps
RPM = np.pi / 30


def one_mode(**changes):
    model = OneMode()
    return model, model.vector(TYPICAL["one-mode"] | changes), TYPICAL["one-mode"] | changes


# ---- fluid force ----------------------------------------------------------------------------


def test_fluid_force_is_a_spring_damper_mass_in_turning_coordinates():
    """Eq. (12) in coordinates that turn with lam Om: w becomes w - lam Om, and nothing else changes."""
    model, theta, p = one_mode(M=0.0, K=0.0, Ds=0.0)
    speed, w = 120.0, np.linspace(-300, 300, 41)
    turned = w - p["lam"] * speed
    expected = p["K0"] + 1j * turned * p["D"] - turned**2 * p["Mf"]
    np.testing.assert_allclose(model.dynamic_stiffness(theta, w, speed)[:, 0, 0], expected, rtol=50 * EPS)


def test_real_two_by_two_coefficients_and_their_signs():
    """Real form k_xx, k_xy, c_xx, ... with x and y apart, through the anisotropic model, gives the same orbit."""
    model, theta, p = one_mode()
    speed = 140.0
    whirl = p["lam"] * speed
    real = {
        "Kxx": p["K"] + p["K0"] - p["Mf"] * whirl**2,
        "Kxy": p["D"] * whirl,
        "Dxx": p["Ds"] + p["D"],
        "Dxy": 2 * p["Mf"] * whirl,
        "Mxx": p["M"] + p["Mf"],
        "Mxy": 0.0,
        "Myx": 0.0,
    }
    real |= {"Kyy": real["Kxx"], "Kyx": -real["Kxy"], "Dyy": real["Dxx"], "Dyx": -real["Dxy"], "Myy": real["Mxx"]}
    other = Anisotropic()
    for w in (-170.0, 65.0):
        F = 3.0 * np.exp(0.7j)
        XY = other.receptance(other.vector(real), w, speed) @ other.force_vector("journal", w, F)
        z = (model.receptance(theta, w, speed) @ model.force_vector("journal", w, F))[0]
        right, wrong = (XY[0] + 1j * XY[1]) / 2, (XY[0] - 1j * XY[1]) / 2
        if w < 0:
            right, wrong = np.conj(wrong), np.conj(right)
        assert right == pytest.approx(z, rel=1e-12)
        assert abs(wrong) < 1e-12 * abs(z)


@pytest.mark.parametrize("w", [-90.0, 40.0])
def test_response_against_time_integration(w):
    """Steady orbit of the equation of motion integrated in real coordinates under the force of eq. (2)."""
    model, theta, p = one_mode()
    speed, F, delta = 130.0, 5.0, 0.6
    whirl = p["lam"] * speed
    sense = np.sign(w)
    M, C, K = p["M"] + p["Mf"], p["Ds"] + p["D"], p["K"] + p["K0"] - p["Mf"] * whirl**2

    def motion(t, y):
        x, u, v, s = y[0], y[1], y[2], y[3]
        fx, fy = F * np.cos(abs(w) * t + delta), sense * F * np.sin(abs(w) * t + delta)
        cross = 2 * p["Mf"] * whirl
        ax = (fx - C * v - cross * s - K * x - p["D"] * whirl * u) / M
        ay = (fy - C * s + cross * v - K * u + p["D"] * whirl * x) / M
        return [v, s, ax, ay]

    period = 2 * np.pi / abs(w)
    settle = np.ceil(40 * np.log(10) * 2 * M / C / period) * period
    sample = settle + np.arange(64) / 64 * period
    solution = solve_ivp(motion, (0, sample[-1]), np.zeros(4), t_eval=sample, rtol=1e-11, atol=1e-16, method="DOP853")
    z = solution.y[0] + 1j * solution.y[1]
    amplitude = np.mean(z * np.exp(-1j * w * sample))
    predicted = (model.receptance(theta, w, speed) @ model.force_vector("journal", w, F * np.exp(1j * delta)))[0]
    assert amplitude == pytest.approx(predicted, rel=1e-8)


# ---- stability ----------------------------------------------------------------------------


@pytest.mark.parametrize("Ds", [0.0, 8.0, 150.0])
def test_threshold_of_one_mode_against_its_closed_form(Ds):
    model, theta, p = one_mode(Ds=Ds)
    r = Ds / p["D"]
    expected = (1 + r) / p["lam"] * np.sqrt((p["K"] + p["K0"]) / (p["M"] + p["Mf"] * r**2))
    onset = threshold_speed(model, theta)
    assert onset.speed == pytest.approx(expected, rel=1e-9)
    assert onset.whirl_frequency == pytest.approx(p["lam"] * expected / (1 + r), rel=1e-6)


def test_threshold_of_two_modes_without_external_damping():
    """Om_ST = w1 / lam, w1 the lowest undamped frequency with K0 in and Mf out."""
    p = TYPICAL["whirl-whip"] | {"Ds": 0.0}
    model = WhirlWhip()
    K = [[p["K1"] + p["K2"], -p["K2"] * p["sigma"]], [-p["K2"], p["K0"] + p["K3"] + p["K2"] * p["sigma"]]]
    w1 = np.sqrt(np.linalg.eigvals(np.linalg.solve(np.diag([p["Md"], p["Mb"]]), K)).real.min())
    onset = threshold_speed(model, model.vector(p))
    assert onset.speed == pytest.approx(w1 / p["lam"], rel=1e-9)
    assert onset.whirl_frequency == pytest.approx(w1, rel=1e-6)


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip"])
def test_the_least_stable_eigenvalues_of_many_rotors_are_undamped_at_their_thresholds(name):
    rng, model = np.random.default_rng(9), MODELS[name]()
    theta = model.vector(TYPICAL[name]) * (1 + 0.05 * rng.normal(size=(5, len(model.parameters))))
    onsets = [threshold_speed(model, one) for one in theta]
    s, by_speed, by_theta = least_stable(model, theta, np.array([onset.speed for onset in onsets]))
    assert (np.abs(s.real) < 1e-9 * np.abs(s)).all()
    np.testing.assert_allclose(s.imag, [onset.whirl_frequency for onset in onsets], rtol=1e-9)
    gradients = -by_theta.real / by_speed.real[:, None]
    np.testing.assert_allclose(gradients, [onset.gradient for onset in onsets], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_eigenvalues_make_the_dynamic_stiffness_singular(name):
    model = MODELS[name]()
    theta, speed = model.vector(TYPICAL[name]), SPEEDS[name][-1]
    coefficients = model.coefficients(theta, speed)
    values = eigenvalues(model, theta, speed)
    assert np.isfinite(values).sum() == 2 * len(model.coordinates)
    for s in values:
        kappa = np.einsum("k,kij->ij", s ** np.arange(3), coefficients)
        singular = np.linalg.svd(kappa, compute_uv=False)
        # Round-off of an eigenvalue, magnified by the spread of the matrix entries.
        assert singular[-1] < 1e-9 * np.abs(coefficients[0]).max()


def test_massless_coordinates_have_fewer_eigenvalues():
    model, theta, p = one_mode(M=0.0, Mf=0.0)
    values = eigenvalues(model, theta, 100.0)
    assert np.isfinite(values).sum() == 1
    exact = -(p["K"] + p["K0"] - 1j * p["D"] * p["lam"] * 100.0) / (p["Ds"] + p["D"])
    assert values[0] == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip"])
def test_below_the_threshold_motion_decays_and_above_it_grows(name):
    """Newton's method on the equation of motion against eigenvalues, of rotors unlike each other."""
    rng, model = np.random.default_rng(8), MODELS[name]()
    for _ in range(10):
        theta = model.vector(TYPICAL[name]) * np.exp(0.2 * rng.standard_normal(len(model.parameters)))
        speed = threshold_speed(model, theta).speed
        below, above = growth_rate(model, theta, speed * np.array([1 - 1e-9, 1 + 1e-9]))
        assert below < 0 < above
        assert (growth_rate(model, theta, speed * np.linspace(0.05, 0.99, 50)) < 0).all()


def test_gradients_of_threshold_and_eigenvalue_against_differences():
    model = WhirlWhip(blocks=("coupling_mass", "gyroscopic"))
    values = TYPICAL["whirl-whip"] | {"m12": 0.02, "g11": 1e-3, "g12": -7e-4, "g22": 1e-3}
    theta = model.vector(values)
    onset = threshold_speed(model, theta)
    s = eigenvalues(model, theta, 150.0)[-1]
    by_speed, by_theta = eigenvalue_gradient(model, theta, 150.0, s)
    for i in range(theta.size):
        d = np.zeros(theta.size)
        d[i] = 1e-5 * max(abs(theta[i]), 1e-3)
        threshold = (threshold_speed(model, theta + d).speed - threshold_speed(model, theta - d).speed) / (2 * d[i])
        eigenvalue = (eigenvalues(model, theta + d, 150.0)[-1] - eigenvalues(model, theta - d, 150.0)[-1]) / (2 * d[i])
        # Central differences of step h: h^2 truncation, eps/h round-off of roots known to about 1e-12.
        assert threshold == pytest.approx(onset.gradient[i], rel=1e-4, abs=1e-6 * np.abs(onset.gradient * theta).max())
        assert eigenvalue == pytest.approx(by_theta[i], rel=1e-4, abs=1e-6 * np.abs(by_theta).max())
    step = (eigenvalues(model, theta, 150.01)[-1] - eigenvalues(model, theta, 149.99)[-1]) / 0.02
    assert step == pytest.approx(by_speed, rel=1e-6)


# ---- anisotropic rotor and the printed equations
# ----------------------------------------------------------------------------


def test_equations_8_and_corrected_9():
    """Dynamic stiffness from eqs (5) to (9), the off-diagonal blocks with the sign that the algebra gives."""
    rng = np.random.default_rng(3)
    model = Anisotropic(("a", "b"))
    p = {q.name: float(rng.normal()) for q in model.parameters}
    p |= {name: value + 5 for name, value in p.items() if name in ("Kxx_11", "Kyy_11", "Kxx_22", "Kyy_22")}
    theta, w, n = model.vector(p), 1.3, 2
    H = model.receptance(theta, w, 0.0)
    A, F = {}, {}
    for s, sign in ((1, 1.0), (2, -1.0)):
        F[s] = np.diag(rng.normal(size=n) + 1j * rng.normal(size=n))
        columns = []
        for r, plane in enumerate(model.planes):
            columns.append(H @ model.force_vector(plane, sign * w, F[s][r, r]))
        XY = np.array(columns).T
        A[1, s], A[2, s] = XY[:n], 1j * XY[n:]  # in eq. (3) y is a sine: A2 = j Y
    K, D, M = model.coefficients(theta, 0.0).real
    for q in (1, 2):
        other = 3 - q
        H1 = F[1] @ np.linalg.solve(A[other, 1], A[other, 2])
        H2 = np.linalg.inv(A[q, 2] - A[q, 1] @ np.linalg.solve(A[other, 1], A[other, 2]))
        own, cross = slice((q - 1) * n, q * n), slice((other - 1) * n, other * n)
        direct = -((-1) ** q * F[2] + H1) @ H2
        np.testing.assert_allclose(direct.real, (K - w**2 * M)[own, own], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(direct.imag, (w * D)[own, own], rtol=1e-9, atol=1e-9)
        B = ((-1) ** q * F[2] - H1) @ H2
        np.testing.assert_allclose((-1) ** q * B.real, (w * D)[cross, own], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose((-1) ** (q + 1) * B.imag, (K - w**2 * M)[cross, own], rtol=1e-9, atol=1e-9)


# ---- gyroscopic rotor ----------------------------------------------------------------------------


def test_overhung_rotor_against_the_textbook():
    """Friswell, Penny, Garvey and Lees, example 5.9.9: shaft of 1.5 m, bearings at 0 and 1 m, disk at the end."""
    with rf.datasets.path("friswell_natural_frequencies.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    row = next(r for r in rows if r["example"] == "5.9.9" and r["rpm"] == "4000")
    published = [float(row[f"w{k}"]) for k in range(1, 7)]
    K, M, G = shaft(1.5, 30, 0.050, 211e9, 81.2e9, 7810.0)
    for node in (0, 20):
        K[2 * node, 2 * node] += 1e7
    mass, It, Ip = solid_disk(0.350, 0.070, 0.050, 7810.0)
    M[-2, -2] += mass
    M[-1, -1] += It
    G[-1, -1] += Ip
    full = frequencies(K, M, G, 4000 * RPM)
    np.testing.assert_allclose(np.sort(np.abs(full[:6])), np.sort(published), rtol=2e-3)
    # Condensed statically to the disk: displacement and tilt.
    rest, disk = np.arange(len(K) - 2), np.arange(len(K) - 2, len(K))
    T = np.vstack([-np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, disk)]), np.eye(2)])
    k, m, g = (T.T @ A @ T for A in (K, M, G))
    model = Overhung(coupling_mass=True)
    theta = model.vector(
        {
            "M": m[0, 0],
            "m12": m[0, 1],
            "It": m[1, 1],
            "Ip": g[1, 1],
            "k11": k[0, 0],
            "k12": k[0, 1],
            "k22": k[1, 1],
            "d1": 0.0,
            "d2": 0.0,
        }
    )
    w = eigenvalues(model, theta, 4000 * RPM).imag
    backward, forward = -w[w < 0], w[w > 0]
    assert backward.min() == pytest.approx(published[0], rel=1e-3)
    assert forward.min() == pytest.approx(published[1], rel=1e-3)
    # The tilt pair of the condensed rotor lies among shaft modes that it does not have.
    assert backward.max() == pytest.approx(published[2], rel=0.03)
    assert forward.max() == pytest.approx(published[5], rel=0.06)


def test_gyroscopic_frequencies_split_with_speed():
    model = Overhung()
    theta = model.vector(TYPICAL["overhung"])
    speeds = np.linspace(0, 500, 11)
    w = eigenvalues(model, theta, speeds).imag
    assert np.all(np.diff(w[:, -1]) > 0)  # highest forward frequency rises
    assert np.all(np.diff(np.abs(w[:, 0])) < 0)  # highest backward frequency falls


# ---- two disks ----------------------------------------------------------------------------


def test_two_disk_published_modes():
    model = TwoDisk()
    p = TYPICAL["two-disk"] | {"D11": 0.0, "D12": 0.0, "D21": 0.0, "D22": 0.0}
    w = eigenvalues(model, model.vector(p), 0.0).imag
    np.testing.assert_allclose(w[w > 0], [165.2, 441.7], atol=0.05)


# ---- machinery ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODELS)
def test_array_translation_equals_the_casadi_machine(name):
    model = MODELS[name]()
    compiled = model.functions
    rng = np.random.default_rng(0)
    theta = model.vector(TYPICAL[name]) * rng.uniform(0.5, 2, (3, len(model.parameters)))
    speed = np.array([10.0, 20.0, 30.0])
    arrays = model.coefficients(theta, speed)
    slopes = compiled.jacobian(theta, speed)
    for k in range(3):
        inputs = np.concatenate([theta[k], [speed[k], 0.0]])
        flat = np.asarray(compiled.graph(inputs)).reshape(model.order + 1, 2, *arrays.shape[-2:])
        np.testing.assert_array_equal(arrays[k], flat[:, 0] + 1j * flat[:, 1])
        dense = np.asarray(ca.DM(compiled.jacobian_graph(inputs))).reshape(model.order + 1, 2, -1, inputs.size)
        dense = (dense[:, 0] + 1j * dense[:, 1]).reshape(*arrays.shape[1:], inputs.size)
        sparse = np.zeros_like(dense)
        sparse[slopes.powers, slopes.rows, slopes.columns, slopes.inputs] = slopes.values[k]
        np.testing.assert_allclose(sparse, dense, rtol=4 * EPS)


numbers = st.complex_numbers(min_magnitude=1e-3, max_magnitude=1e3, allow_nan=False, allow_infinity=False)


def value(z):
    return complex(float(z.re), float(z.im))


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # of a machine that is busy
@given(numbers, numbers)
def test_complex_type_computes_as_python_does(a, b):
    x, y = Complex.of(a), Complex.of(b)
    for ours, theirs in (
        (x + y, a + b),
        (x - y, a - b),
        (x * y, a * b),
        (x / y, a / b),
        (1 / x, 1 / a),
        (2 - x, 2 - a),
    ):
        assert value(ours) == pytest.approx(theirs, rel=1e-12, abs=1e-12)
    assert value(x.conj()) == a.conjugate()


def test_complex_matrices():
    rng = np.random.default_rng(0)
    a, b = (rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2)) for _ in range(2))
    product = Complex.matrix(a.tolist()) @ Complex.matrix(b.tolist()).T
    np.testing.assert_allclose(np.array(ca.DM(product.re)) + 1j * np.array(ca.DM(product.im)), a @ b.T, rtol=1e-14)


def test_models_that_are_the_same_share_what_was_compiled():
    made = [
        lambda: WhirlWhip(blocks=("coupling_mass",), law=rf.models.Muszynska(), clearance_um=150.0),
        lambda: rf.models.Orthotropic(rf.models.Chain(2, fluid="mass-2"), at=("mass-1",)),
    ]
    for make in made:
        assert make() == make()
        assert len({make(), make()}) == 1
        assert make().functions is make().functions
        assert pickle.loads(pickle.dumps(make())) == make()
    others = [
        WhirlWhip(), WhirlWhip(("a", "b")), WhirlWhip(blocks=("coupling_mass",)), WhirlWhip(two_lam=True), OneMode(),
        *(WhirlWhip(law=rf.models.Muszynska(), clearance_um=size) for size in (150.0, 160.0)),
        WhirlWhip(law=rf.models.EvenPolynomial(1), clearance_um=150.0), made[0](), made[1](),
    ]  # fmt: skip
    assert len({id(model.functions) for model in others}) == len(set(others)) == len(others)


def test_what_is_not_all_in_the_attributes_of_a_model_is_its_own():
    """An equation written elsewhere may draw on anything."""
    for one, other in ((Disk(), Disk()), [rf.models.Orthotropic(Disk(), at=("disk",)) for _ in range(2)]):
        assert {one, other} != {one}
        assert one.functions is not other.functions


def test_errors_name_what_is_wrong_and_what_is_allowed():
    with refuses(KeyError):
        OneMode().vector({"lamb": 0.4})
    with refuses(KeyError):
        OneMode().vector({"D": 1.0})
    with refuses(ValueError):
        WhirlWhip(planes=("disk", "disk"))
    with refuses(ValueError):
        WhirlWhip(blocks=("coupling_mas",))
    with refuses(KeyError):
        WhirlWhip().coordinate("rotor", "z")
    with refuses(ValueError):
        Parameter("a", "1", "", lower=1.0, upper=0.0)

    class Wrong(Disk):
        planes = ("a", "b")

    with refuses(ValueError):
        Wrong().coefficients([1, 1, 1, 1], 0.0)
