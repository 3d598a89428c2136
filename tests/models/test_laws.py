"""Laws of eccentricity: published coefficients, B-splines of SciPy, derivatives, limits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from nonlinear_rigs import CLEARANCE_UM, rig
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from sentences import refuses

import rotorfit as rf
from rotorfit.models.laws import LAWS, Law, i_spline
from rotorfit.models.motion.journal import journal

GRID = np.linspace(0.0, 0.99, 397)
NODES = (0.0, 0.35, 0.65, 1.0)


def fluid(law: Law, eps: NDArray[np.float64], **values: float) -> tuple[NDArray[np.float64], ...]:
    """K0, D and the factor on lam of a law, each shape of eps."""
    model = rf.models.OneMode(law=law, clearance_um=CLEARANCE_UM)
    base = {"M": 0.0, "K": 0.0, "Ds": 0.0, "K0": 9000.0, "D": 450.0, "lam": 0.4, "Mf": 0.0}
    theta = model.vector(base | law.start(9000.0, 450.0) | values)
    C = model.coefficients(np.tile(theta, (eps.size, 1)), 100.0, eps)[:, :, 0, 0]
    D = C[:, 1].real
    return C[:, 0].real, D, -C[:, 0].imag / (100.0 * 0.4 * D)


def test_published_seal_coefficients_follow_the_power_law_to_their_digits() -> None:
    lines = rf.datasets.path("seal_muszynska_tum_computed.csv").read_text().splitlines()
    data = np.genfromtxt([line for line in lines if not line.startswith("#")], delimiter=",", names=True)
    model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
    centred = {(row["seal"], row["rpm"]): row for row in data if row["ecc"] == 0}
    half_digit = 5e-6  # six digits
    for row in data:
        Om, base = row["rpm"] * np.pi / 30, centred[row["seal"], row["rpm"]]
        inertia = base["mxx"] * (0.4 * Om) ** 2
        values = {"K0": base["kxx"] + inertia, "D": base["cxx"], "Mf": base["mxx"], "lam": 0.4}
        theta = model.vector({"M": 0.0, "K": 0.0, "Ds": 0.0, "n_K": 2.0, "n_D": 2.0, "b": 0.5} | values)
        C = model.coefficients(theta, Om, row["ecc"])[:, 0, 0]
        rise = (1 - row["ecc"] ** 2) ** -2
        assert C[0].real == pytest.approx(row["kxx"], abs=half_digit * (abs(row["kxx"]) + 3 * rise * inertia))
        # kxy = D lam Om, cxy = 2 Mf lam Om; the data's signs are those of the force on the rotor
        assert -C[0].imag == pytest.approx(row["kxy"], rel=2 * half_digit)
        assert C[1].real == pytest.approx(row["cxx"], rel=2 * half_digit)
        assert -C[1].imag == pytest.approx(row["cxy"], rel=2 * half_digit)
        assert C[2].real == pytest.approx(row["mxx"], rel=2 * half_digit)


@pytest.mark.parametrize("number", range(len(NODES)))
def test_a_rise_of_the_spline_is_the_integral_of_scipys_hat_function(number: int) -> None:
    knots = np.r_[NODES[0], NODES, NODES[-1]]
    rise = BSpline(knots, np.eye(len(NODES))[number], 1).antiderivative()
    total = float(rise(NODES[-1]))
    x = np.linspace(NODES[0], NODES[-1], 101)
    ours = np.array([float(i_spline(NODES, number, value)) for value in x])
    np.testing.assert_allclose(ours, rise(x) / total, atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_the_monotone_spline_is_monotone_and_level_at_the_centre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    law = rf.models.MonotoneSpline(knots=(0.3, 0.5, 0.8), reach=0.9)
    values = {
        q.name: float(rng.exponential(q.scale * (0.25 if q.name.startswith("lam") else 1.0))) for q in law.parameters
    }
    K0, D, ratio = fluid(law, GRID, **values)
    for rising in (K0, D, -ratio):
        assert (np.diff(rising) >= -1e-12 * np.abs(rising).max()).all()
    beyond = GRID >= 0.9
    assert np.ptp(K0[beyond]) <= 1e-12 * K0.max()
    # I_1 ~ eps^2 near the centre: the slope there is that of no constant term
    assert K0[1] - K0[0] == pytest.approx((K0[2] - K0[0]) / 4, rel=1e-9)
    assert D[1] - D[0] == pytest.approx((D[2] - D[0]) / 4, rel=1e-9)


@pytest.mark.parametrize("name", sorted(LAWS))
def test_laws_begin_at_the_centred_values_and_their_start_is_within_the_limits(name: str) -> None:
    law = LAWS[name]()
    K0, D, ratio = fluid(law, np.zeros(1))
    assert (K0[0], D[0], ratio[0]) == (9000.0, 450.0, pytest.approx(1.0, abs=1e-15))
    start = law.start(9000.0, 450.0)
    assert start.keys() == {q.name for q in law.parameters}
    assert all(q.lower <= start[q.name] <= q.upper for q in law.parameters)


@pytest.mark.parametrize("name", ["muszynska", "even", "spline"])
def test_the_slope_in_eccentricity_is_exact_and_continuous(name: str) -> None:
    model, theta = rig(name)
    eps = np.array([0.0, 0.1, 0.3, 0.5, 0.6, 0.8])
    h = 1e-6

    def drive(at: NDArray[np.float64]) -> NDArray[np.complex128]:
        return model.coefficients(theta, 120.0, at)[:, :, 0, 0]

    def slope(at: NDArray[np.float64]) -> NDArray[np.complex128]:
        jacobian = model.functions.jacobian(np.tile(theta, (at.size, 1)), 120.0, at)
        total = np.zeros((at.size, 3), dtype=complex)
        chosen = jacobian.inputs == theta.size + 1
        total[:, jacobian.powers[chosen]] = jacobian.values[:, chosen]
        return total

    inner = eps[1:]
    scale = np.abs(drive(eps)).max(axis=0)
    # central differences: truncation h^2 (1e-12) and round-off 1e-16 / h (1e-10)
    np.testing.assert_allclose(slope(inner) / scale, (drive(inner + h) - drive(inner - h)) / (2 * h) / scale, atol=2e-8)
    # across a knot the slope changes by no more than its own slope times the step
    knots = np.array([0.35, 0.65])
    np.testing.assert_allclose(slope(knots + 1e-9) / scale, slope(knots - 1e-9) / scale, atol=1e-6)


@pytest.mark.parametrize("name", ["muszynska", "even", "spline", "two planes"])
def test_what_changes_of_one_rotor_and_of_many_is_what_its_coefficients_change_by(name: str) -> None:
    model, theta = rig(name)
    seat, eps = journal(model), np.array([0.0, 0.3, 0.9])
    expected = (model.coefficients(theta, 120.0, eps) - model.coefficients(theta, 120.0))[:, :, seat.at, seat.at].T
    size = np.abs(model.coefficients(theta, 120.0, eps)).max()
    for vectors, speed in ((theta, 120.0), (np.tile(theta, (3, 1)), np.full(3, 120.0))):
        np.testing.assert_allclose(seat.change_of(vectors, speed)(eps), expected, rtol=1e-12, atol=1e-14 * size)


def test_zero_exponents_and_factors_are_the_linear_fluid() -> None:
    for name in LAWS.keys() - {"collapse"}:  # which divides by its edge
        law = LAWS[name]()
        K0, D, ratio = fluid(law, GRID, **{q.name: 0.0 for q in law.parameters})
        np.testing.assert_array_equal([K0, D, ratio], np.broadcast_to([[9000.0], [450.0], [1.0]], (3, GRID.size)))


def test_splines_take_symbols_and_numbers_alike() -> None:
    x = ca.SX.sym("x")
    graph = ca.Function("f", [x], [i_spline(NODES, 1, x)])
    for value in (0.0, 0.2, 0.35, 0.6, 1.0):
        assert float(graph(value)) == pytest.approx(float(i_spline(NODES, 1, value)), abs=1e-15)


@pytest.mark.parametrize(
    "make",
    [
        lambda: rf.models.EvenPolynomial(0),
        lambda: rf.models.EvenPolynomial(5),
        lambda: rf.models.MonotoneSpline(knots=(0.6, 0.3)),
        lambda: rf.models.MonotoneSpline(knots=(0.3,), reach=0.2),
        lambda: rf.models.MonotoneSpline(reach=1.5),
        lambda: rf.models.OneMode(law=rf.models.Muszynska()),
        lambda: rf.models.WhirlWhip(law=rf.models.EvenPolynomial(), clearance_um=-1.0),
    ],
)
def test_impossible_laws_are_refused_with_what_is_allowed(make: object) -> None:
    with refuses(ValueError):
        make()  # type: ignore[operator]
