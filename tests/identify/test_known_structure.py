"""Identification with a known shaft: condensation, conversion of real matrices, and the rig's own numbers."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from beams import shaft
from known_shaft import FITTED, PLANES, RIG, TRUTH, known_rig, rig_matrices
from plain import moves_of, plain_fit, summary_words
from scipy.linalg import block_diag
from sentences import refuses
from synthetic import circular_test

import rotorfit as rf
from rotorfit.identify.fitting.notices import structure_error
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.models import KnownStructure, WhirlWhip, eigenvalues, threshold_speed
from rotorfit.models.motion.stability import eigenvalue_gradient, growth_rate
from rotorfit.models.shafts.reduction import BASIS_TOLERANCE
from rotorfit.models.shafts.shaft import complex_matrices

RPM = np.pi / 30


def real_matrices(M, G, K):
    """The same structure in x, y, alpha, beta at each node: beta = dx/ds, alpha = -dy/ds."""
    nodes = len(M) // 2
    first = np.arange(nodes)[:, None] * 4
    u, v = (first + np.array([0, 3])).ravel(), (first + np.array([1, 2])).ravel()
    sign = np.tile([1.0, -1.0], nodes)
    real = {kind: np.zeros((4 * nodes, 4 * nodes)) for kind in "MGK"}
    for kind, matrix in (("M", M), ("K", K)):
        real[kind][np.ix_(u, u)] = matrix
        real[kind][np.ix_(v, v)] = sign[:, None] * matrix * sign
    real["G"][np.ix_(u, v)] = G * sign
    real["G"][np.ix_(v, u)] = -sign[:, None] * G
    return real["M"], real["G"], real["K"]


def full_kappa(theta, w, Om):
    """Dynamic stiffness of all coordinates, written out independently of the model."""
    M, G, K = rig_matrices()
    kappa = K - w**2 * M + w * Om * G + 0j
    p = dict(zip(("Ds", "K0", "D", "lam", "Mf"), theta, strict=True))
    disk, journal = 2 * PLANES["disk"], 2 * PLANES["journal"]
    kappa[disk, disk] += 1j * w * p["Ds"]
    kappa[journal, journal] += p["K0"] + 1j * p["D"] * (w - p["lam"] * Om) - p["Mf"] * (w - p["lam"] * Om) ** 2
    return kappa


# ---- the rig ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig():
    return rf.datasets.rig_open()


@pytest.mark.parametrize("method", ["fit", "closed form"])
def test_rig_open_with_its_own_shaft(rig, method):
    """The bounds that the lumped model misses: redchi 10 and K0 3200 N/m instead of 10000."""
    model = known_rig()
    result = plain_fit(model, rig) if method == "fit" else rf.closed_form(model, rig)
    assert result.success
    assert 0.9 < result.redchi < 1.1
    assert result.params["K0"].value == pytest.approx(10000, rel=0.02)
    assert result.params["K0"].stderr < 10
    for name, value in FITTED.items():
        assert abs(result.params[name].value - value) < 3.5 * result.params[name].stderr, name
    assert result.threshold_speed().value / RPM == pytest.approx(RIG["threshold_rpm"], abs=1.0)
    assert not result.warnings
    assert not result.identifiability.unresolved


def test_what_rests_on_the_matrices(rig):
    """Young's modulus taken as known: what its cause moves foretells fits with others; the onset is the rig's."""
    model = known_rig(scales={"E_scale": {"K": rig_matrices(support=False)[2]}})
    fit = rf.fit(model, rig)
    moved = moves_of(fit, "E_scale", "K0")
    step = 4e-5  # twice what the data leave of it: further off the misfit bends the fit
    up, down = (plain_fit(model, rig, known={"E_scale": 1 + sign * step}).params["K0"].value for sign in (1, -1))
    # What Gauss-Newton leaves out, curvature times residual, is a few per cent here.
    assert moved == pytest.approx((up - down) / (2 * step), rel=0.1)
    assert fit.causes["E_scale"].size == 0.01
    onset = fit.threshold_speed()
    assert abs(onset.value / RPM - RIG["threshold_rpm"]) < 3 * onset.stderr / RPM < 0.01 * RIG["threshold_rpm"]


def test_threshold_of_the_true_rig():
    """The simulation behind the data had the same matrices: its threshold comes back to seven digits."""
    model = known_rig()
    theta = model.vector(FITTED)
    onset = threshold_speed(model, theta)
    assert onset.speed / RPM == pytest.approx(RIG["threshold_rpm"], rel=5e-7)
    for rpm, growth in RIG["max_real_eig"].items():
        # A high mode that hardly moves the planes; the round-off of the highest, 4.5e5 rad/s, is 1e-10.
        assert growth_rate(model, theta, float(rpm) * RPM) == pytest.approx(growth, abs=2e-9)


@pytest.mark.slow
def test_free_young_modulus(rig):
    """A shaft taken 3 % too stiff: the data say so, and give the fluid nonetheless."""
    M, G, K = rig_matrices(young=1.03 * 2.11e11)
    _, _, shaft_alone = rig_matrices(young=1.03 * 2.11e11, support=False)
    model = KnownStructure(
        M, None, G, K, planes=PLANES, fluid="journal", damping="disk", scales={"E_scale": {"K": shaft_alone}}
    )
    stiff = plain_fit(model, rig)
    assert stiff.redchi > 2
    assert not stiff.params["E_scale"].vary
    free = plain_fit(model, rig, known={"E_scale": None})
    assert 0.9 < free.redchi < 1.1
    for name, value in (FITTED | {"E_scale": 1 / 1.03}).items():
        assert abs(free.params[name].value - value) < 3.5 * free.params[name].stderr, name
    assert free.params["E_scale"].stderr < 1e-3
    assert free.threshold_speed().value / RPM == pytest.approx(RIG["threshold_rpm"], abs=1.0)


# ---- the model against the full matrices ------------------------------------------------------------------------


def test_condensed_stiffness_gives_the_full_receptance():
    model = known_rig(tilts=("journal",))
    theta = model.vector(FITTED)
    at = [2 * PLANES["disk"], 2 * PLANES["journal"], 2 * PLANES["journal"] + 1]
    for w, Om in ((90.0, 100.0), (-312.0, 210.0), (0.0, 300.0), (650.0, 0.0)):
        H = np.linalg.inv(full_kappa(list(FITTED.values()), w, Om))[np.ix_(at, at)]
        np.testing.assert_allclose(model.receptance(theta, w, Om), H, rtol=1e-8)
    # Arrays of conditions, and of parameter vectors.
    w, Om = np.array([[50.0], [-70.0]]), np.array([100.0, 200.0, 250.0])
    grid = model.receptance(theta, w, Om)
    assert grid.shape == (2, 3, 3, 3)
    np.testing.assert_allclose(grid[1, 2], model.receptance(theta, -70.0, 250.0), rtol=1e-12)
    np.testing.assert_allclose(model.receptance(np.stack([theta, theta]), 50.0, 100.0)[1], grid[0, 0], rtol=1e-12)


def test_eigenvalues_are_those_of_the_whole_shaft():
    model = known_rig()
    theta = model.vector(FITTED)
    s = eigenvalues(model, theta, 200.0)
    assert s.size == 2 * 2 * (TRUTH["nel"] + 1)
    for root in s[np.argsort(np.abs(s))][:6]:
        kappa = full_kappa(list(FITTED.values()), root / 1j, 200.0)
        assert np.linalg.svd(kappa / np.abs(kappa).max(), compute_uv=False)[-1] < 1e-12
    assert eigenvalues(model, np.stack([theta, theta]), [100.0, 200.0]).shape == (2, s.size)


def test_a_lumped_chain_given_as_matrices_is_the_lumped_model():
    Md, K1, K2, Mb, K3 = 0.95, 1.4e4, 1.5e4, 0.3, 6e3
    model = KnownStructure(
        np.diag([Md, Mb]), None, None, [[K1 + K2, -K2], [-K2, K2 + K3]], planes={"disk": 0, "journal": 1},
        fluid="journal", damping="disk", dofs=("z",), two_lam=True,
    )  # fmt: skip
    lumped = WhirlWhip(two_lam=True)
    fluid = {"Ds": 3.0, "K0": 1e4, "D": 450.0, "lam_D": 0.475, "lam_M": 0.4, "Mf": 0.35}
    theta = model.vector(fluid)
    other = lumped.vector(fluid | {"Md": Md, "K1": K1, "K2": K2, "sigma": 1.0, "Mb": Mb, "K3": K3})
    w = np.array([-300.0, -20.0, 40.0, 250.0])
    np.testing.assert_allclose(
        model.dynamic_stiffness(theta, w, 150.0), lumped.dynamic_stiffness(other, w, 150.0), rtol=1e-13
    )
    np.testing.assert_allclose(eigenvalues(model, theta, 150.0), eigenvalues(lumped, other, 150.0), rtol=1e-9)
    assert threshold_speed(model, theta).speed == pytest.approx(threshold_speed(lumped, other).speed, rel=1e-9)


def scaled_rig():
    M, G, K = rig_matrices()
    _, _, alone = rig_matrices(support=False)
    scales = {"E_scale": {"K": alone}, "disk_scale": {"M": np.zeros_like(M), "G": np.zeros_like(G)}}
    at = 2 * PLANES["disk"]
    scales["disk_scale"]["M"][at, at], scales["disk_scale"]["M"][at + 1, at + 1] = TRUTH["m_disk"], 4e-4
    scales["disk_scale"]["G"][at + 1, at + 1] = 7.5e-4
    return KnownStructure(M, None, G, K, planes=PLANES, fluid="journal", damping="disk", scales=scales)


def test_scale_factors_and_their_sensitivities(rig):
    model = scaled_rig()
    theta = model.vector(FITTED | {"E_scale": 0.98, "disk_scale": 1.05})
    M, G, K = rig_matrices()
    K = K - 0.02 * rig_matrices(support=False)[2]
    at = 2 * PLANES["disk"]
    M[at, at] += 0.05 * TRUTH["m_disk"]
    M[at + 1, at + 1] += 0.05 * 4e-4
    G[at + 1, at + 1] += 0.05 * 7.5e-4
    direct = KnownStructure(M, None, G, K, planes=PLANES, fluid="journal", damping="disk")
    w = np.array([-200.0, 60.0, 400.0])
    np.testing.assert_allclose(
        model.receptance(theta, w, 180.0), direct.receptance(direct.vector(FITTED), w, 180.0), rtol=1e-9
    )

    settings = FitSettings(known={"E_scale": None, "disk_scale": None})
    problem = build_problem(model, rig.select(np.arange(len(rig)) % 40 < 2), settings)
    x = np.array([theta[model.parameter_names.index(name)] for name in problem.space.names])
    _, jacobian = problem.jacobian(x)
    for i, value in enumerate(x):
        step = np.zeros_like(x)
        step[i] = 1e-5 * value
        difference = (problem.residuals(x + step) - problem.residuals(x - step)) / (2 * step[i])
        # Central differences: truncation 1e-10 times the third derivative, round-off 1e-16 / 1e-5.
        np.testing.assert_allclose(jacobian[:, i], difference, atol=1e-5 * np.abs(difference).max())


@pytest.mark.slow
def test_sensitivities_of_eigenvalues_and_threshold():
    model = scaled_rig()
    theta = model.vector(FITTED | {"E_scale": 0.98, "disk_scale": 1.05})
    s = eigenvalues(model, theta, 250.0)
    root = s[np.argmin(np.abs(s - 1j * 120.0))]
    by_speed, by_theta = eigenvalue_gradient(model, theta, 250.0, root)

    def nearest(vector, speed):
        roots = eigenvalues(model, vector, speed)
        return roots[np.argmin(np.abs(roots - root))]

    assert by_speed == pytest.approx((nearest(theta, 250.01) - nearest(theta, 249.99)) / 0.02, rel=1e-5)
    for i, value in enumerate(theta):
        step = np.zeros_like(theta)
        step[i] = 1e-4 * value
        difference = (nearest(theta + step, 250.0) - nearest(theta - step, 250.0)) / (2 * step[i])
        assert by_theta[i] == pytest.approx(difference, rel=1e-4, abs=1e-6 * abs(root) / value)
    onset = threshold_speed(model, theta)
    step = np.zeros_like(theta)
    place = model.parameter_names.index("E_scale")
    step[place] = 1e-3
    above, below = (threshold_speed(model, theta + sign * step).speed for sign in (1, -1))
    assert onset.gradient[place] == pytest.approx((above - below) / 2e-3, rel=1e-4)


def test_two_fluids_and_two_dampers():
    M, G, K = rig_matrices()
    planes = {"disk": 7, "seal": 10, "journal": 14}
    model = KnownStructure(M, None, G, K, planes=planes, fluid=("seal", "journal"), damping=("disk", "seal"))
    truth = {
        "Ds_disk": 3.0, "Ds_seal": 1.0, "K0_seal": 3e3, "D_seal": 60.0, "lam_seal": 0.3, "Mf_seal": 0.05,
        "K0_journal": 1e4, "D_journal": 450.0, "lam_journal": 0.475, "Mf_journal": 0.35,
    }  # fmt: skip
    assert set(model.parameter_names) == set(truth)
    theta = model.vector(truth)
    half = np.linspace(5.0, 500.0, 60)
    test = circular_test(
        model, theta, speeds=(60.0, 120.0), frequency=np.concatenate([-half[::-1], half]), noise=0.01, seed=1
    )
    # The seal's damping is that of the fluid and of the damper together: one speed more would not part them.
    fit = plain_fit(model, test, known={"Ds_seal": 1.0})
    assert fit.success
    for name, value in truth.items():
        if name != "Ds_seal":
            assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name


def test_plane_without_probe(rig):
    """The fluid sits where nothing is measured: no closed form, but the search finds the same numbers."""
    disk_only = rig.select(rig.plane == "disk")
    fit = plain_fit(known_rig(), disk_only, start={"K0": 8000.0, "D": 400.0, "lam": 0.45, "Mf": 0.3, "Ds": 2.0})
    assert fit.success
    assert 0.9 < fit.redchi < 1.1
    for name, value in FITTED.items():
        assert abs(fit.params[name].value - value) < 3.5 * fit.params[name].stderr, name


def test_pickle_keeps_the_model():
    model = scaled_rig()
    theta = model.vector(FITTED)
    before = model.receptance(theta, 100.0, 200.0)
    copy = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(copy.receptance(theta, 100.0, 200.0), before)
    again = model.variant(two_lam=True)
    assert "lam_D" in again.parameter_names


# ---- real matrices --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dofs", [rf.models.ROSS_4, rf.models.ROSS_6])
def test_real_matrices_become_complex_ones(dofs):
    M, G, K = rig_matrices()
    matrices = dict(zip("MGK", real_matrices(M, G, K), strict=True))
    if len(dofs) == 6:
        keep = (np.arange(len(M) // 2)[:, None] * 6 + [0, 1, 3, 4]).ravel()
        rest = np.setdiff1d(np.arange(3 * len(M)), keep)
        grown = {kind: np.zeros((3 * len(M), 3 * len(M))) for kind in "MGK"}
        for kind, matrix in matrices.items():
            grown[kind][np.ix_(keep, keep)] = matrix
            grown[kind][rest, rest] = 7.0
        matrices = grown
    parts, place = complex_matrices(matrices, dofs)
    np.testing.assert_allclose(parts.M, M, atol=1e-15)
    np.testing.assert_allclose(parts.K, K, rtol=1e-15)
    np.testing.assert_allclose(parts.G, -1j * G, atol=1e-20)
    np.testing.assert_array_equal(place, np.arange(len(M)).reshape(-1, 2))
    # The same motion: eigenvalues of the complex equation and their conjugates are those of the real one.
    stiffness, damping, mass = parts.coefficients(150.0)
    assert not parts.C.any()
    np.testing.assert_allclose(damping, 150.0 * -1j * G, atol=1e-18)
    assert stiffness.shape == mass.shape


def test_signs_of_real_matrices():
    """A real simulation of one spinning disk: the complex model predicts the same orbit, forward and backward."""
    Id, Ip, m, k, kr, Om, w = 4e-3, 7e-3, 1.2, 2e4, 300.0, 200.0, 90.0
    coupling = 500.0  # force for slope
    M, G, K = np.diag([m, Id]), np.diag([0.0, Ip]), np.array([[k, coupling], [coupling, kr]])
    real = real_matrices(M, G, K)
    model = KnownStructure(
        real[0], None, real[1], real[2], planes={"disk": 0}, damping="disk", tilts=("disk",), dofs=rf.models.ROSS_4
    )
    Cr = np.diag([2.0, 2.0, 0.0, 0.0])
    kappa = real[2] + 1j * w * (Cr + Om * real[1]) - w**2 * real[0]
    for sign in (1, -1):
        force = np.array([1.0, -1j * sign, 0.0, 0.0])  # Fx = cos wt, Fy = sign sin wt
        x, y, alpha, beta = np.linalg.solve(kappa, force)
        z = (x + 1j * y) / 2 if sign > 0 else np.conj(x - 1j * y) / 2
        r = (beta - 1j * alpha) / 2 if sign > 0 else np.conj(beta + 1j * alpha) / 2
        H = model.receptance(model.vector({"Ds": 2.0}), sign * w, Om)
        np.testing.assert_allclose([z, r], H[:, 0], rtol=1e-12)
    # Gyroscopic stiffening: the forward tilting mode lies above the backward one.
    s = eigenvalues(model, model.vector({"Ds": 0.0}), 2000.0)
    assert s.imag.max() > -s.imag.min()


def anisotropic(kind):
    real = dict(zip("MGK", real_matrices(*rig_matrices()), strict=True))
    if kind == "bearing":
        real["K"][0, 0] += 1e5
    elif kind == "cross":
        real["K"][0, 1] += 1e5
    return real


@pytest.mark.parametrize(
    "change",
    [
        lambda m: anisotropic("bearing"),
        lambda m: anisotropic("cross"),
        lambda m: m | {"K": m["K"][:-4, :-4]},
        lambda m: {k: v[:-1, :-1] for k, v in m.items()},
        lambda m: m | {"M": m["M"][:, :-1]},
        lambda m: m | {"K": m["K"] * np.nan},
        lambda m: m | {"K": m["K"] * 1e150},
        lambda m: m | {"K": m["K"] + 0j},
    ],
)
def test_unsuitable_real_matrices(change):
    matrices = change(dict(zip("MGK", real_matrices(*rig_matrices()), strict=True)))
    with refuses(ValueError):
        KnownStructure(matrices["M"], None, matrices["G"], matrices["K"], planes=PLANES, dofs=rf.models.ROSS_4)


def test_matrices_of_a_file_are_refused_with_its_name(tmp_path):
    for name, entry, nodes, said in (
        ("a.npz", np.inf, [0.0, 1.0], "a.npz: M has an entry of inf"),
        ("b.npz", 1.0, ["x", "y"], "b.npz: the positions"),
    ):
        np.savez(tmp_path / name, M=np.full((8, 8), entry), K=np.eye(8), nodes=nodes)
        with pytest.raises(ValueError, match=said):
            KnownStructure.from_ross(tmp_path / name, planes={"journal": 1}, fluid="journal")


def test_lateral_axial_coupling_is_refused():
    K = block_diag(*[np.zeros((6, 6))] * 15)
    K[0, 2] = K[2, 0] = 1.0
    with refuses(ValueError):
        KnownStructure(np.eye(len(K)), None, None, K, planes=PLANES, dofs=rf.models.ROSS_6)


@pytest.mark.parametrize(
    "options",
    [
        {"planes": {}},
        {"planes": {"disk": 15}},
        {"planes": {"a": 3, "b": 3}},
        {"fluid": "seal"},
        {"damping": ("disk", "disk")},
        {"dofs": ("z", "w")},
        {"dofs": ("x", "z")},
        {"dofs": ("z",), "tilts": ("disk",), "planes": {"disk": 3}},
        {"scales": {"E": {"K": np.eye(4)}}},
        {"scales": {"E": {}}},
        {"scales": {"E": {"Q": np.eye(30)}}},
        {"fluid": "journal", "scales": {"K0": {"K": np.eye(30)}}},
    ],
)
def test_impossible_structures(options):
    M, G, K = rig_matrices()
    with refuses(ValueError):
        KnownStructure(M, None, G, K, **({"planes": PLANES} | options))


def test_lumped_models_have_no_structure():
    with refuses(TypeError):
        WhirlWhip().known_stiffness(np.zeros(11), np.zeros(1, dtype=complex), np.zeros(1))


# ---- reduced, with factors to fit ---------------------------------------------------------------------------


def fine_rig(elements=60, damping=0.0):
    """The rig with more elements, and a factor on the shaft's stiffness and on its damping."""
    K, M, G = shaft(TRUTH["L"], elements, TRUTH["d"], 2.11e11, 8.12e10, 7810.0)
    alone = {"K": K.copy(), "C": damping * K}
    planes = {plane: node * elements // TRUTH["nel"] for plane, node in PLANES.items()}
    for plane, mass in (("disk", TRUTH["m_disk"]), ("journal", TRUTH["m_jrn"])):
        M[2 * planes[plane], 2 * planes[plane]] += mass
    G[2 * planes["disk"] + 1, 2 * planes["disk"] + 1] += 7.5e-4
    K[0, 0] += 5e7
    K[2 * planes["journal"], 2 * planes["journal"]] += TRUTH["K3"]
    return KnownStructure(
        M, damping * alone["K"], G, K, planes=planes, fluid="journal", damping="disk", scales={"E_scale": alone}
    )


@pytest.mark.parametrize("damping", [0.0, 2e-5])
def test_a_reduced_structure_is_the_whole_one_over_the_range_of_its_factor(damping):
    """Against solutions of all 122 coordinates: one line at a time is condensed exactly."""
    model = fine_rig(damping=damping)
    w = np.concatenate([np.linspace(-700, -20, 60), np.linspace(20, 700, 60)])
    speeds = np.where(np.arange(w.size) % 2, 100.0, 200.0)
    for factor in (0.905, 0.97, 1.0, 1.1, 1.3):
        theta = model.vector(FITTED | {"E_scale": factor})
        reduced = model.known_stiffness(theta, 1j * w, speeds)
        for i in range(0, w.size, 17):
            exact = model.known_stiffness(theta, 1j * w[i : i + 1], speeds[i : i + 1])
            size = np.abs(exact.values).max()
            # The estimate asks for 1e-7 over a range of 0.2 of the factor: its derivative errs by ten times that.
            np.testing.assert_allclose(reduced.values[i], exact.values[0], rtol=0, atol=BASIS_TOLERANCE * size)
            slope = np.abs(exact.slopes).max()
            np.testing.assert_allclose(
                reduced.slopes[0, i], exact.slopes[0, 0], rtol=0, atol=10 * BASIS_TOLERANCE * slope
            )
    assert {r.size for r in model.shaft.reductions} <= set(range(6, 30))
    assert max(r.error for r in model.shaft.reductions) <= BASIS_TOLERANCE


def test_estimated_error_bounds_that_of_a_poor_basis(monkeypatch):
    """Few solutions, and those left out that are nearly combinations of others: the estimate says what is missing."""
    from rotorfit.models.shafts import reduction

    model = fine_rig(damping=2e-5)
    w = np.linspace(20, 700, 60)
    speeds = np.full(w.size, 150.0)
    scales = np.full((w.size, 1), 1.1)
    exact = model.shaft.terms.condense(1j * w, speeds, scales)[0]
    size = np.abs(exact).max(axis=(1, 2))
    for dropped in (0.3, 0.1, 0.03):
        monkeypatch.setattr(reduction, "_SMALLEST_DIRECTION", dropped)
        poor = reduction.Reduction(model.shaft.terms, 1j * w, speeds, np.array([[0.9], [1.1]]))
        found = poor.small.condense(1j * w, speeds, scales)[0]
        error = (np.abs(found - exact).max(axis=(1, 2)) / size).max()
        assert BASIS_TOLERANCE < error <= poor.error
        assert poor.error <= 1e4 * error  # the sizes of two vectors stand for their product


@pytest.mark.slow
def test_a_fit_with_a_factor_states_its_reduction():
    """The factor is found, and the fit says what the reduction did to its predictions."""
    model = fine_rig(elements=28)
    truth = model.vector(FITTED | {"E_scale": 0.97})
    w = np.concatenate([np.linspace(-500, -20, 20), np.linspace(20, 500, 20)])
    rng = np.random.default_rng(3)
    readings = {name: [] for name in ("force_plane", "plane", "response", "sigma", "frequency")}
    for column, force_plane in enumerate(model.planes):
        for row, plane in enumerate(model.planes):
            z = 10.0 * model.receptance(truth, w, 200.0)[:, row, column]
            sigma = 0.01 * np.sqrt(np.mean(np.abs(z) ** 2))
            noise = sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
            values = {"force_plane": force_plane, "plane": plane, "response": z + noise, "sigma": sigma, "frequency": w}
            for name, value in values.items():
                readings[name].append(np.broadcast_to(value, w.shape))
    data = {name: np.concatenate(parts) for name, parts in readings.items()}
    test = rf.perturbation_test(**data, run=data["force_plane"], speed=200.0, force=10.0, direction="z")
    free = plain_fit(model, test, known={"E_scale": None})
    assert abs(free.params["E_scale"].value - 0.97) < 3.5 * free.params["E_scale"].stderr
    assert "the structure's 58 coordinates were reduced to" in summary_words(free)
    stated = structure_error(free)
    assert stated.over_noise < 1e-3  # 1e-7 of the stiffness, times resonances of Q 100, over noise of 1e-2
    assert stated.estimate < BASIS_TOLERANCE


@pytest.mark.parametrize("lines", [1, 3])
def test_a_structure_with_nothing_unknown_still_answers(lines):
    model = rf.models.KnownStructure(
        np.diag([1.0, 2.0]), None, None, np.eye(2) * 1e4, planes={"a": 0, "b": 1}, dofs=("z",)
    )
    w = np.linspace(10.0, 30.0, lines)
    found = model.receptance(model.vector({}), w, 0.0)
    assert found.shape == (lines, 2, 2)
    assert np.allclose(found[:, 0, 0], 1 / (1e4 - w**2))
    assert np.allclose(found[:, 1, 1], 1 / (1e4 - 2 * w**2))


def test_a_structure_without_weight_has_a_threshold_or_none() -> None:
    """A unit too many in its masses: natural frequencies of 1e150 rad/s are no speeds."""
    model = KnownStructure(
        np.eye(2) * 1e-300, None, None, np.eye(2) * 1e4, planes={"a": 0, "b": 1}, dofs=("z",), fluid="b"
    )
    w = np.linspace(-300.0, 300.0, 30)
    for speeds in ([100.0], [100.0, 200.0]):
        data: dict[str, list[np.ndarray]] = {"frequency": [], "speed": [], "response": []}
        for speed in speeds:
            data["frequency"].append(w)
            data["speed"].append(np.full(w.size, speed))
            data["response"].append(10.0 / (1e4 + 2e4 + 450.0j * (w - 0.47 * speed)))
        columns = {name: np.concatenate(parts) for name, parts in data.items()}
        test = rf.perturbation_test(
            **columns, run="b", force=10.0, plane="b", force_plane="b", direction="z", sigma=1e-9
        )
        fit = plain_fit(model, test)
        assert not np.isfinite(fit.threshold_speed().stderr) or fit.threshold_speed().value < 1e16
        assert "threshold" in summary_words(fit)
