"""Chains of masses and springs: equation of motion, and the way from modes to a chain and back (eqs 24 to 26)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh, eigh_tridiagonal
from sentences import refuses

from rotorfit.models import MODELS, Chain, TwoDisk, chain_from_modes, chain_modes, eigenvalues, threshold_speed
from rotorfit.models.shafts.chain_match import bidiagonal

PUBLISHED = {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0}


def full_matrices(M, K):
    """Mass and stiffness matrices written out spring by spring."""
    n = len(M)
    stiffness = np.zeros((n + 2, n + 2))
    for i, k in enumerate(K):
        stiffness[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    return np.diag(M), stiffness[1:-1, 1:-1]


def random_chain(n, rng, spread=0.3):
    return 10 ** rng.uniform(-spread, spread, n), 1e4 * 10 ** rng.uniform(-spread, spread, n + 1)


# ---- the model ---------------------------------------------------------------------------------------------


def test_two_masses_are_the_two_disk_rotor():
    values = PUBLISHED | {"Ds1": 14.2, "Ds2": 14.8}
    chain = Chain(2)
    disks = TwoDisk(chain.planes)
    other = disks.vector(PUBLISHED | {"D11": 14.2, "D12": 0.0, "D21": 0.0, "D22": 14.8})
    w = np.linspace(-600.0, 600.0, 7)
    np.testing.assert_allclose(
        chain.dynamic_stiffness(chain.vector(values), w, 0.0), disks.dynamic_stiffness(other, w, 0.0), rtol=1e-14
    )
    assert MODELS["chain"]().parameter_names == chain.parameter_names


@pytest.mark.parametrize("n", [1, 2, 5, 20])
def test_stiffness_matrix_spring_by_spring(n):
    M, K = random_chain(n, np.random.default_rng(n))
    model = Chain(n)
    values = {f"M{i + 1}": m for i, m in enumerate(M)} | {f"K{i + 1}": k for i, k in enumerate(K)}
    values |= {f"Ds{i + 1}": 1.0 + i for i in range(n)}
    stiffness, damping, mass = model.coefficients(model.vector(values), 0.0)
    expected_mass, expected_stiffness = full_matrices(M, K)
    np.testing.assert_allclose(stiffness, expected_stiffness, rtol=1e-14)
    np.testing.assert_allclose(damping, np.diag(1.0 + np.arange(n)), rtol=1e-14)
    np.testing.assert_allclose(mass, expected_mass, rtol=1e-14)


def test_fluid_at_one_mass_makes_it_unstable():
    """Without other damping the threshold is the lowest frequency, K0 in and Mf out, over lam (physics: two modes)."""
    M, K = np.array([0.9, 0.4, 0.3]), np.array([1.4e4, 1.5e4, 1.2e4, 6e3])
    model = Chain(planes=("disk", "coupling", "journal"), fluid="journal")
    fluid = {"K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35}
    values = {f"M{i + 1}": m for i, m in enumerate(M)} | {f"K{i + 1}": k for i, k in enumerate(K)}
    theta = model.vector(values | {"Ds1": 0.0, "Ds2": 0.0, "Ds3": 0.0} | fluid)
    mass, stiffness = full_matrices(M, K)
    stiffness[2, 2] += fluid["K0"]
    lowest = np.sqrt(eigh(stiffness, mass, eigvals_only=True)[0])
    onset = threshold_speed(model, theta)
    assert onset.speed == pytest.approx(lowest / 0.475, rel=1e-6)
    assert onset.whirl_ratio == pytest.approx(0.475, rel=1e-6)


@pytest.mark.parametrize(
    "arguments",
    [
        {"n": 0},
        {"n": 21},
        {"n": 3, "planes": ("a", "b")},
        {"n": 2, "fluid": "journal"},
        {"n": 2, "two_lam": True},
    ],
)
def test_impossible_chains(arguments):
    with refuses(ValueError):
        Chain(**arguments)


# ---- from modes to the chain and back ---------------------------------------------------------------------


def test_published_two_disk_rotor_from_its_modes():
    w, shapes = chain_modes([0.73, 0.79], [18900.0, 63700.0, 22600.0])
    shapes = shapes / shapes[0]
    np.testing.assert_allclose(w, [165.2, 441.7], atol=0.05)
    np.testing.assert_allclose(shapes[1], [0.984, -0.939], atol=5e-4)
    modal = np.array([0.73, 0.79]) @ shapes**2
    chain = chain_from_modes(w, shapes, modal_masses=modal)
    for name, value in PUBLISHED.items():
        assert chain.values()[name] == pytest.approx(value, rel=1e-12)
    np.testing.assert_allclose(chain.match, 1.0, atol=1e-14)
    np.testing.assert_allclose(chain.modal_mass, modal, rtol=1e-12)
    np.testing.assert_allclose(chain.modal_mass * w**2, [41000, 279000], rtol=0.005)


def test_published_two_disk_rotor_from_its_printed_figures():
    """Frequencies to 4 digits, modal functions to 3: the half of the last digit moves M by 0.5 %, K alike."""
    chain = chain_from_modes([165.2, 441.7], [[1, 1], [0.984, -0.939]], modal_masses=[1.5, 1.43])
    for name, value in PUBLISHED.items():
        assert chain.values()[name] == pytest.approx(value, rel=0.005)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 12, 16, 20])
@pytest.mark.parametrize("ends", ["both", "first only", "last only"])
def test_round_trip(n, ends):
    rng = np.random.default_rng(100 + n)
    for spread in (0.1, 0.5):
        M, K = random_chain(n, rng, spread)
        if ends != "both":
            K[-1 if ends == "first only" else 0] = 0.0
        mass, stiffness = full_matrices(M, K)
        squares, shapes = eigh(stiffness, mass)
        w = np.sqrt(squares)
        scaled = shapes * rng.uniform(-3, 3, n)  # any scale and sign
        chain = chain_from_modes(w, scaled, total_mass=M.sum())
        np.testing.assert_allclose(chain.M, M, rtol=1e-7)
        assert chain.K.sum() == pytest.approx(K.sum(), rel=1e-7)
        if n > 1:  # the two springs of a single mass are in parallel
            np.testing.assert_allclose(chain.K, K, rtol=1e-7, atol=1e-7 * K.max())
        np.testing.assert_allclose(chain.match, 1.0, atol=1e-12)
        # Columns come back in the scale and with the sign in which they were given.
        np.testing.assert_allclose(chain.shapes, scaled, atol=1e-6 * np.abs(scaled).max())


@pytest.mark.parametrize("n", [2, 5, 10, 20])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_frequencies_are_exact_and_psi_obeys_its_conditions(n, noise):
    """A bare beam, whose frequencies grow as the square: no chain is like it, yet its frequencies are met."""
    stations = np.arange(1, n + 1) / (n + 1)
    modes = np.arange(1, n + 1)
    w = 100.0 * modes**2.0
    shapes = np.sin(np.pi * np.outer(stations, modes)) * (1 + noise * np.random.default_rng(n).normal(size=(n, n)))
    chain = chain_from_modes(w, shapes, total_mass=2.0)
    np.testing.assert_allclose(chain.frequencies, w, rtol=1e-10)
    assert chain.M.sum() == pytest.approx(2.0, rel=1e-12)
    assert (chain.M > 0).all()
    assert (chain.K >= 0).all()
    # eqs (25), (26)
    psi = chain.psi
    np.testing.assert_allclose(psi.T @ psi, np.eye(n), atol=1e-12)
    T = psi.T @ np.diag(w**2) @ psi
    off = np.diag(T, 1)
    tolerance = 1e-13 * n * w[-1] ** 2
    np.testing.assert_allclose(T - np.diag(np.diag(T)) - np.diag(off, 1) - np.diag(off, -1), 0.0, atol=tolerance)
    assert (off < tolerance).all()
    # T, masses and springs belong together.
    mass, stiffness = full_matrices(chain.M, chain.K)
    root = 1 / np.sqrt(np.diag(mass))
    np.testing.assert_allclose(root[:, None] * stiffness * root, T, atol=tolerance)
    # The reported match is that of the lines.
    own = root[:, None] * psi.T
    cosine = np.sum(own * shapes, axis=0) / np.linalg.norm(own, axis=0) / np.linalg.norm(shapes, axis=0)
    np.testing.assert_allclose(chain.match, cosine**2, atol=1e-9)
    np.testing.assert_allclose(chain.deviation, np.sqrt(np.maximum(1 - cosine**2, 0.0)), atol=1e-6)


def test_start_direction_fixes_the_tridiagonal_matrix():
    """B^T B has the given spectrum, and its eigenvectors the given first entries, down to weights of 1e-40."""
    rng = np.random.default_rng(3)
    for n in (2, 6, 20):
        w = np.sort(rng.uniform(10.0, 500.0, n))
        weights = 10.0 ** rng.uniform(-4, 0, n)
        B = bidiagonal(w, weights)
        np.testing.assert_allclose(np.linalg.svd(B, compute_uv=False)[::-1], w, rtol=1e-12)
        _, vectors = np.linalg.eigh(B.T @ B)
        np.testing.assert_allclose(vectors[0] ** 2, weights / weights.sum(), rtol=1e-6)
    # Two modes, by hand: T11 is the weighted mean of w^2.
    B = bidiagonal(np.array([1.0, 2.0]), np.array([1.0, 1e-40]))
    assert B[0, 0] ** 2 == pytest.approx(1.0, rel=1e-15)
    assert (B[0, 0] * B[0, 1]) ** 2 == pytest.approx(9e-40, rel=1e-14)


def test_measured_shapes_are_matched_better_than_by_their_first_row():
    """5 % errors in the shapes of a chain of six: least squares comes nearer than the first row alone."""
    rng = np.random.default_rng(8)
    M, K = random_chain(6, rng, 0.2)
    w, shapes = chain_modes(M, K)
    measured = shapes * (1 + 0.05 * rng.normal(size=shapes.shape))
    chain = chain_from_modes(w, measured, modal_masses=1.0)
    weights = measured[0] ** 2
    B = bidiagonal(w, weights / weights.sum())
    T = B.T @ B
    _, vectors = eigh_tridiagonal(np.diag(T), np.diag(T, 1))
    load = np.eye(6)[:, 0] * K[0] / np.sqrt(M[0]) + np.eye(6)[:, -1] * K[-1] / np.sqrt(M[-1])
    d = np.linalg.solve(T, load)
    lines = vectors / d[:, None]
    cosine = np.sum(lines * measured, axis=0) / np.linalg.norm(lines, axis=0) / np.linalg.norm(measured, axis=0)
    assert np.sum(1 - chain.match) < np.sum(1 - cosine**2)
    assert chain.match.min() > 0.995  # 5 % noise alone leaves 1 - 0.05^2 in the mean
    np.testing.assert_allclose(chain.M, M, rtol=0.1)
    assert "match" in str(chain)


@pytest.mark.slow
def test_shaft_with_three_disks():
    """A massless beam with three heavy disks is no chain; the chain found is the nearest.

    All chains with these frequencies are within reach of a search at random over directions and shares of the end
    springs: none of 20 000 comes nearer.
    """
    length, EI, disks = 0.9, 100.0, np.array([1.0, 1.4, 0.8])
    a = np.array([0.2, 0.45, 0.7])
    low, high = np.minimum.outer(a, a), np.maximum.outer(a, a)
    flexibility = low * (length - high) * (length**2 - low**2 - (length - high) ** 2) / (6 * length * EI)
    squares, shapes = eigh(np.linalg.inv(flexibility), np.diag(disks))
    w = np.sqrt(squares)
    chain = chain_from_modes(w, shapes, modal_masses=1.0)
    np.testing.assert_allclose(chain.frequencies, w, rtol=1e-10)
    model = chain.model(("a", "b", "c"))
    theta = model.vector(chain.values() | {"Ds1": 0.0, "Ds2": 0.0, "Ds3": 0.0})
    np.testing.assert_allclose(np.sort(np.abs(eigenvalues(model, theta, 0.0).imag))[::2], w, rtol=1e-8)

    rng = np.random.default_rng(0)
    unit = shapes / np.linalg.norm(shapes, axis=0)
    best = np.inf
    for _ in range(20_000):
        start = np.abs(rng.normal(size=3))
        Q = np.linalg.qr(np.column_stack([start * squares**k for k in range(3)]))[0]  # Krylov space
        T = Q.T @ (squares[:, None] * Q)
        off = -np.abs(np.diag(T, 1))
        Q = Q * np.concatenate([[1.0], np.cumprod(np.sign(off / np.diag(T, 1)))])
        share = rng.uniform()
        T = np.diag(np.diag(T)) + np.diag(off, 1) + np.diag(off, -1)
        own = Q.T / np.linalg.solve(T, [1 - share, 0.0, share])[:, None]
        cosine = np.sum(own / np.linalg.norm(own, axis=0) * unit, axis=0)
        best = min(best, float(np.sum(1 - cosine**2)))
    assert np.sum(1 - chain.match) <= best
    assert np.sum(1 - chain.match) > 0.9 * best  # and the search did come near


@pytest.mark.parametrize(
    ("frequencies", "shapes", "options"),
    [
        ([1.0, 2.0], np.eye(3), {"total_mass": 1.0}),
        ([1.0, 1.0], [[1, 1], [1, -1]], {"total_mass": 1.0}),
        ([0.0, 1.0], [[1, 1], [1, -1]], {"total_mass": 1.0}),
        ([1.0, 2.0], [[1, 0], [1, 0]], {"total_mass": 1.0}),
        ([1.0, 2.0], [[1, 1], [1, -1]], {}),
        ([1.0, 2.0], [[1, 1], [1, -1]], {"total_mass": 1.0, "modal_masses": 1.0}),
        ([1.0, 2.0], [[1, 1], [1, -1]], {"modal_masses": [1.0, -1.0]}),
        ([1.0, 2.0], [[1, 1], [1, -1]], {"total_mass": -1.0}),
    ],
)
def test_impossible_modes(frequencies, shapes, options):
    with refuses(ValueError):
        chain_from_modes(frequencies, shapes, **options)


def test_impossible_masses():
    with refuses(ValueError):
        chain_modes([1.0, 2.0], [1.0, 2.0])
    with refuses(ValueError):
        chain_modes([1.0, -2.0], [1.0, 2.0, 3.0])


def test_names_in_place_of_the_number_of_masses_are_refused_in_words():
    with refuses(TypeError):
        Chain(("disk", "journal"))
