"""A bearing and a seal in one rotor: each fluid has its own values, law, causes and errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.headline import headline
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.models import Chain, KnownStructure, LinearInSpeed, Muszynska, Parameter, RotorModel, fluids_of

PLANES = ("bearing", "disk", "seal")
W = np.r_[-350:-20:15.0, 20:351:15.0]
TRUTH = {
    "M1": 1.0, "M2": 4.0, "M3": 1.5, "K2": 2e5, "K3": 1.5e5, "Ds2": 30.0,
    "K0_bearing": 4e4, "D_bearing": 500.0, "lam_bearing": 0.47, "Mf_bearing": 0.4,
    "K0_seal": 1e4, "D_seal": 250.0, "lam_seal": 0.38, "Mf_seal": 0.9,
}  # fmt: skip
KNOWN = {"K1": 0.0, "K4": 0.0, "Ds1": 0.0, "Ds3": 0.0}
HELD = {"K1": 0.0, "K3": 0.0, "Ds1": 0.0, "Ds2": 0.0}
MUSZYNSKA = Muszynska()


def stiffness(w: float, speed: float, sigma: float = 1.0, growth: float = 0.0) -> np.ndarray:
    """Dynamic stiffness, written a second time; damping of the seal grows with the speed."""

    def fluid(K0: float, D: float, lam: float, Mf: float) -> complex:
        slip = w - lam * speed
        return K0 + 1j * D * slip - Mf * slip**2

    grown = 250.0 * (1 + growth * (speed / 100.0 - 1))
    kappa = np.diag(
        [
            2e5 - 1.0 * w**2 + fluid(4e4, 500.0, 0.47, 0.4),
            2e5 * sigma + 1.5e5 + 30j * w - 4.0 * w**2,
            1.5e5 - 1.5 * w**2 + fluid(1e4, grown, 0.38, 0.9),
        ]
    )
    kappa[0, 1], kappa[1, 0] = -2e5 * sigma, -2e5
    kappa[1, 2] = kappa[2, 1] = -1.5e5
    return kappa


def sweeps(seed: int, **change: float):
    """Sweeps with the force at the bearing, then at the seal, at two speeds."""
    rng, sigma, found = np.random.default_rng(seed), 2e-7, []
    for speed in (80.0, 160.0):
        for plane in ("bearing", "seal"):
            load = 20.0 * np.array([plane == p for p in PLANES])
            motion = np.array([np.linalg.solve(stiffness(w, speed, **change), load) for w in W])
            noise = sigma * (rng.normal(size=motion.shape) + 1j * rng.normal(size=motion.shape))
            found.append(
                rf.perturbation_test(
                    run=f"{speed:g} {plane}", speed=speed, frequency=np.tile(W, 3), force_plane=plane, force=20.0,
                    plane=np.repeat(PLANES, W.size), direction="z", response=(motion + noise).T.ravel(), sigma=sigma,
                )
            )  # fmt: skip
    return found


def chain(**options) -> Chain:
    return Chain(3, PLANES, fluid=("bearing", "seal"), **options)


def test_intervals_of_both_fluids_hold() -> None:
    draws, inside = 60, []
    for seed in range(draws):
        fit = rf.fit(chain(), sweeps(seed), known=KNOWN, causes=None)
        assert fit.start == "closed form"
        inside.append([low < TRUTH[name] < high for name in TRUTH for low, high in [fit.interval(name)]])
    share = np.mean(inside)
    assert 0.93 < share < 0.99  # of 60 draws of 14 values: 0.95 +- 0.01, more where values go together
    assert np.mean(inside, axis=0).min() > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / draws)


@pytest.mark.parametrize("known_shaft", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_intervals_hold_where_the_disk_has_no_probe(known_shaft: bool) -> None:
    """Readings at two planes alone, of the chain and of the shaft whose matrices are known."""
    model, names = chain(), [*TRUTH]
    if known_shaft:
        names = [name for name in TRUTH if "_" in name]
        K = np.array([[2e5, -2e5, 0.0], [-2e5, 3.5e5, -1.5e5], [0.0, -1.5e5, 1.5e5]])
        planes = dict(zip(PLANES, range(3), strict=True))
        M, C = np.diag([1.0, 4.0, 1.5]), np.diag([0.0, 30.0, 0.0])
        model = KnownStructure(M, C, None, K, planes=planes, fluid=("bearing", "seal"), dofs=("z",))
    draws, inside = 60 if not known_shaft else 30, []
    for seed in range(draws):
        read = [test.select(test.plane != "disk") for test in sweeps(seed)]
        fit = rf.fit(model, read, known={} if known_shaft else KNOWN, causes=None)
        assert 0.8 < fit.redchi < 1.2
        inside.append([low < TRUTH[name] < high for name in names for low, high in [fit.interval(name)]])
    assert 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / draws / 2) < np.mean(inside) < 0.99  # of values that go together


def test_each_fluid_has_its_causes() -> None:
    fit = rf.fit(chain(), sweeps(1), known=KNOWN)
    names = {row.name for row in fit.causes}
    assert {"speed[lam_bearing]", "speed[lam_seal]", "drift[seal]", "lag[bearing]", "lag[seal]"} <= names
    for name, value in TRUTH.items():
        assert abs(fit.params[name].value - value) < 3 * fit.params[name].stderr, name
    assert "K0_seal" in fit.summary()


def test_one_has_a_law_and_a_spring_has_sigma() -> None:
    law = LinearInSpeed(values=("D",), speed_rpm=100.0 * 30 / np.pi)
    fit = rf.fit(
        chain(law={"seal": law}, sigma=True), sweeps(2, sigma=1.1, growth=0.2),
        known=KNOWN | {"sigma3": 1.0}, causes=None,
    )  # fmt: skip
    assert fit.params["D_speed_seal"].value == pytest.approx(0.2, abs=4 * fit.params["D_speed_seal"].stderr)
    assert "D_speed_bearing" not in fit.params
    one = {**TRUTH, **KNOWN, "sigma2": 1.1, "sigma3": 1.0, "D_speed_seal": 0.2}
    model = chain(law={"seal": law}, sigma=True)
    # row of the first mass: -sigma K2; that of the second: sigma K2 on the diagonal, as in eq. (18)
    np.testing.assert_allclose(
        model.dynamic_stiffness(model.vector(one), 90.0, 130.0), stiffness(90.0, 130.0, 1.1, 0.2), rtol=1e-12
    )


def test_a_known_shaft_and_a_model_of_ones_own_have_the_same_fluids() -> None:
    class Own(RotorModel):
        name = "own"
        planes = PLANES
        fluids = fluids_of(("bearing", "seal"), {"seal": Muszynska()})
        clearance = 2e-4
        parameters = (Parameter("k", "N/m", "stiffness"), *(q for fluid in fluids for q in fluid.parameters))

        def equation(self, p, speed, eccentricity):
            bearing, seal = (fluid.force(p, speed, eccentricity) for fluid in self.fluids)
            springs = [[p.k + bearing.K, -p.k, 0], [-p.k, 2 * p.k, -p.k], [0, -p.k, p.k + seal.K]]
            return (
                springs,
                [[bearing.C, 0, 0], [0, 0, 0], [0, 0, seal.C]],
                [[bearing.M, 0, 0], [0, 0, 0], [0, 0, seal.M]],
            )

    law = {"n_K_seal": 1.0, "n_D_seal": 1.5, "b_seal": 0.4}
    fluid = {name: value for name, value in TRUTH.items() if "_" in name} | law
    K = 1e5 * np.array([[1, -1, 0], [-1, 2, -1], [0, -1, 1]])
    shaft = KnownStructure(
        np.zeros((3, 3)) + 1e-9 * np.eye(3), None, None, K, planes=dict(zip(PLANES, range(3), strict=True)),
        fluid=("bearing", "seal"), dofs=("z",), law={"seal": Muszynska()}, clearance_um=200.0,
    )  # fmt: skip
    own, at = Own(), (90.0, 130.0, 0.4)
    found = own.dynamic_stiffness(own.vector({"k": 1e5, **fluid}), *at)
    np.testing.assert_allclose(shaft.dynamic_stiffness(shaft.vector(fluid), *at), found, rtol=1e-9, atol=1e-3)
    assert own.orbit_start({**TRUTH}) == {"n_K_seal": 1.0, "n_D_seal": 1.0, "b_seal": 0.5}


LAWS = {"n_K_bearing": 1.5, "n_D_bearing": 1.0, "b_bearing": 0.4, "n_K_seal": 2.0, "n_D_seal": 0.8, "b_seal": 0.3}
GAPS = {"bearing": 100.0, "seal": 130.0}
BOTH = {"M1": 2.0, "M2": 3.0, "K2": 8e4, **{name: v for name, v in TRUTH.items() if "_" in name}, **LAWS}


def two_journals(law=MUSZYNSKA, gaps=GAPS) -> Chain:
    return Chain(2, ("bearing", "seal"), fluid=("bearing", "seal"), law=law, clearance_um=gaps)


@pytest.fixture(scope="module")
def of_two_laws() -> rf.PerturbationTest:
    """Sweeps with the force at the bearing, then at the seal, integrated in time, without noise: orbits up to half."""
    rpm = [-2400, -1600, -800, 500, 900, 1200, 1500, 1800, 2400]
    forces = {"speed_rpm": [800, 1500], "frequency_rpm": rpm, "force": [0.5, 2.0, 3.5], "planes": ["bearing", "seal"]}
    return rf.simulate(two_journals(), {**BOTH, **HELD}, **forces, noise=0.0)


def noisy(test: rf.PerturbationTest, seed: int) -> rf.PerturbationTest:
    noise = np.random.default_rng(seed).normal(scale=6e-8, size=(2, len(test)))
    return replace(test, response=test.response + noise.T @ [1, 1j], sigma=np.full(len(test), 6e-8))


def test_orbits_of_two_journals_are_those_of_the_motion_in_time(of_two_laws) -> None:
    told = replace(of_two_laws, sigma=np.full(len(of_two_laws), 1e-9))
    problem = build_problem(two_journals(), told, FitSettings(known=HELD, causes=None))
    (block,), x = problem.blocks, np.array([BOTH[name] for name in problem.space.names])
    assert np.ptp(block.eccentricity, axis=1).min() > 0.5
    largest = np.abs(of_two_laws.response).max()
    for mode in ("nearest", "followed"):  # 1e-6 is the tolerance of the integration
        found = replace(block, mode=mode).predict(problem.space.theta(x))
        assert np.abs(found - block.base.measured).max() < 3e-6 * largest
    step = 1e-5 * np.abs(x)
    for number, column in enumerate(problem.jacobian(x)[1].T):
        ahead, back = (problem.residuals(x + sign * step * (np.arange(x.size) == number)) for sign in (1, -1))
        np.testing.assert_allclose((ahead - back) / (2 * step[number]), column, atol=1e-7 * np.abs(column).max())
    many = problem.residuals(np.tile(x, (3, 1)))
    np.testing.assert_allclose(many[1], problem.residuals(x), atol=1e-6)


@pytest.mark.parametrize("draws", [12, pytest.param(60, marks=pytest.mark.slow)])
def test_intervals_of_both_laws_hold(draws: int, of_two_laws) -> None:
    inside = []
    for seed in range(draws):
        fit = rf.fit(two_journals(), noisy(of_two_laws, seed), known=HELD, causes=None)
        inside.append([low < BOTH[name] < high for name in BOTH for low, high in [fit.interval(name)]])
    share = np.mean(inside)
    assert abs(share - 0.95) < 3.5 * np.sqrt(0.95 * 0.05 / draws / 4)  # of 17 values that go together


def test_outputs_name_the_laws_of_both_journals(of_two_laws, tmp_path: Path) -> None:
    fit = rf.fit(two_journals(dict.fromkeys(GAPS, MUSZYNSKA)), noisy(of_two_laws, 1), known=HELD)
    assert {"D_bearing", "D_seal"} <= {number.name for number in headline(fit).numbers}
    assert len(fit.plot.law().axes) == 6
    for name, value in BOTH.items():
        assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name
    fit.save(tmp_path / "fit.json")
    assert rf.load_fit(tmp_path / "fit.json").model == fit.model
    with refuses(ValueError):
        fit.plot.nonlinear_stiffness()


def test_clearances_and_laws_stand_where_fluids_act() -> None:
    with refuses(ValueError):
        two_journals(gaps=None)
    with refuses(ValueError):
        two_journals(gaps={"bearing": 100.0})
    with refuses(ValueError):
        two_journals(gaps={**GAPS, "disk": 90.0})
    with refuses(ValueError):
        chain(law={"disk": MUSZYNSKA}, clearance_um=100.0)
