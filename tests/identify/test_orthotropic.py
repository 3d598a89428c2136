"""Rotors on supports that differ in two directions, against finite elements in pairs of forward and backward motion."""

from __future__ import annotations

import numpy as np
import pytest
from fe_rigs import DISK, JOURNAL, RPM, TYPICAL, Rig
from plain import plain_fit
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.identify.fitting.fit_file import fit_from_json, fit_to_json
from rotorfit.models.motion.stability import eigenvalue_gradient, growth_rate

K3X, K3Y = 6000.0, 16000.0


class OrthotropicRig(Rig):
    """The finite-element rig with ``K3X`` and ``K3Y``, in pairs: motion at +w beside the conjugate of that at -w."""

    def __init__(self, **values: float) -> None:
        super().__init__(**values)
        b = 2 * JOURNAL
        self.K[b, b] += (K3X + K3Y) / 2 - 6000.0  # the rig has 6000 N/m in all directions
        self.half = (K3X - K3Y) / 2

    def paired(self, own: np.ndarray, other: np.ndarray) -> np.ndarray:
        nothing = np.zeros_like(own)
        return np.block([[own, nothing], [nothing, other.conj()]])

    def growth(self, speed: float) -> float:
        K, C, M = (self.paired(matrix, matrix) for matrix in self.coefficients(speed))
        b, n = 2 * JOURNAL, len(self.K)
        K[b, n + b] = K[n + b, b] = self.half
        top = np.hstack([np.zeros_like(K), np.eye(2 * n)])
        A = np.vstack([top, np.hstack([-np.linalg.solve(M, K), -np.linalg.solve(M, C)])])
        return float(np.linalg.eigvals(A).real.max())

    def tests(self, speeds: np.ndarray, seed: int, lines: int = 90) -> rf.PerturbationTest:
        random = np.random.default_rng(seed)
        b, n = 2 * JOURNAL, len(self.K)
        w = np.linspace(6.0, 520.0, lines)
        force = 1.5e-4 * w**2
        rows = []
        for speed in speeds:
            K, C, M = self.coefficients(speed)
            pairs = np.array([
                self.paired(K + 1j * v * C - v * v * M, K - 1j * v * C - v * v * M) for v in w
            ])  # fmt: skip
            pairs[:, b, n + b] = pairs[:, n + b, b] = self.half
            for force_plane, driven in (("disk", 2 * DISK), ("journal", b)):
                for sense in (1, -1):
                    drive = np.zeros((lines, 2 * n, 1), dtype=complex)
                    drive[:, driven + (0 if sense > 0 else n), 0] = force
                    motion = np.linalg.solve(pairs, drive)[..., 0]
                    for plane, node in (("disk", 2 * DISK), ("journal", b)):
                        forward, backward = motion[:, node], motion[:, n + node]
                        for direction, value in (("x", forward + backward), ("y", -1j * (forward - backward))):
                            sigma = self.noise * np.sqrt(np.mean(np.abs(value) ** 2) / 2)
                            noise = sigma * (random.normal(size=lines) + 1j * random.normal(size=lines))
                            run = f"{force_plane} {speed / RPM:.0f} {sense:+d}"
                            rows.append(
                                (run, speed, sense * w, force_plane, force, plane, direction, value + noise, sigma)
                            )
        names = ("run", "speed", "frequency", "force_plane", "force", "plane", "direction", "response", "sigma")
        columns = {
            name: np.concatenate([np.broadcast_to(np.asarray(row[k]), (lines,)) for row in rows])
            for k, name in enumerate(names)
        }
        return rf.perturbation_test(**columns, source="orthotropic.csv")


@pytest.fixture(scope="module")
def rig() -> OrthotropicRig:
    return OrthotropicRig(**TYPICAL)


@pytest.fixture(scope="module")
def refined(rig: OrthotropicRig) -> rf.FitResult:
    model = rf.models.Orthotropic(rf.models.WhirlWhip(), at="journal")
    fit = plain_fit(model, rig.tests(RPM * np.array([1000.0, 2000.0]), seed=1), known={"K3": (K3X + K3Y) / 2})
    return rf.refine(fit).best


@pytest.mark.slow
def test_the_probes_of_clean_data_are_not_accused(refined: rf.FitResult) -> None:
    # A trial fit of lumped circular orbits leaves a fifth to two thirds of these responses unexplained.
    assert not [finding for finding in rf.check(refined.experiments[0]) if finding.severity == "error"]


@pytest.mark.slow
def test_a_finite_element_rig_gives_its_support_and_its_fluid(rig: OrthotropicRig, refined: rf.FitResult) -> None:
    assert 0.9 < refined.redchi < 1.1
    for name, truth in (("dKs", K3X - K3Y), ("lam", TYPICAL["lam"]), ("D", TYPICAL["D"]), ("dDs", 0.0)):
        found = refined.params[name]
        assert abs(found.value - truth) < 4 * found.stderr, name
        assert found.stderr < (0.01 * abs(truth) or 1.0), name
    onset = refined.threshold_speed()
    assert abs(onset.value - rig.threshold()) < 4 * onset.stderr
    assert 0 < refined.whirl_ratio() < 1  # eigenvalues of x and y come in pairs of either sign


@pytest.fixture(scope="module")
def known(rig: OrthotropicRig) -> rf.models.Orthotropic:
    """The rig with its shaft known: round part with the mean stiffness of the support."""
    shaft = rf.models.KnownStructure(
        rig.M, None, rig.G, rig.K, planes={"disk": DISK, "journal": JOURNAL}, fluid="journal", damping="disk"
    )
    return rf.models.Orthotropic(shaft, at="journal")


KNOWN_TRUTH = {name: TYPICAL[name] for name in ("Ds", "K0", "D", "lam", "Mf")} | {"dKs": K3X - K3Y, "dDs": 0.0}


def test_a_known_shaft_on_such_a_support_is_the_finite_elements_themselves(rig, known) -> None:
    """Growth of free motion, its and its slopes."""
    theta = known.vector(KNOWN_TRUTH)
    for speed in (150.0, 330.0):
        # 232 eigenvalues up to 1e6 rad/s of two formulations: round-off 1e-16 of the greatest.
        assert growth_rate(known, theta, speed) == pytest.approx(rig.growth(speed), abs=1e-6)
    s = rf.models.eigenvalues(known, theta, 330.0)
    least = s[np.argmax(s.real)]
    by_speed, by_theta = eigenvalue_gradient(known, theta, 330.0, least)
    for k, name in enumerate((*known.parameter_names, "speed")):
        step = 1e-3 * max(abs(np.append(theta, 330.0)[k]), 1.0)
        ends = []
        for sign in (1, -1):
            moved = np.append(theta, 330.0)
            moved[k] += sign * step
            found = rf.models.eigenvalues(known, moved[:-1], float(moved[-1]))
            ends.append(found[np.argmin(np.abs(found - least))])
        slope = (ends[0] - ends[1]) / (2 * step)
        # Round-off of an eigenvalue: 1e-16 of the greatest, 1e6 rad/s, times ten for its condition.
        assert np.append(by_theta, by_speed)[k] == pytest.approx(slope, rel=1e-3, abs=1e-9 / step), name


@pytest.mark.slow
def test_a_known_shaft_is_fitted_forward_and_backward_with_its_support(rig, known, tmp_path) -> None:
    fit = plain_fit(known, rig.tests(RPM * np.array([1000.0, 2000.0]), seed=1, lines=30))
    assert 0.9 < fit.redchi < 1.1
    for name, truth in KNOWN_TRUTH.items():
        assert abs(fit.params[name].value - truth) < 4 * fit.params[name].stderr, name
    onset = fit.threshold_speed()
    assert abs(onset.value - rig.threshold()) < 4 * onset.stderr
    fit.save(tmp_path / "fit.json")
    loaded = rf.load_fit(tmp_path / "fit.json")
    assert loaded.x.tolist() == fit.x.tolist()
    assert loaded.model.known_stiffness(fit.theta(), np.array([50j]), np.array([100.0])).values.shape == (1, 4, 4)
    found = fit.params["dKs"]
    low, high = fit.sample(seed=1, walkers=16, max_steps=60).interval("dKs", 0.68)  # rough: so few steps leave 20 %
    assert abs((low + high) / 2 - found.value) < found.stderr
    assert (high - low) / 2 == pytest.approx(found.stderr, rel=0.5)


def test_a_round_support_reduces_to_the_rotor_itself() -> None:
    base = rf.models.WhirlWhip()
    values = {
        "Md": 1.0, "Ds": 3.0, "K1": 1.4e4, "K2": 1.4e4, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 1e4, "D": 450.0,
        "lam": 0.475, "Mf": 0.35,
    }  # fmt: skip
    model = rf.models.Orthotropic(base, at="journal")
    theta = model.vector(values | {"dKs": 0.0, "dDs": 0.0})
    for sense in (1, -1):
        w, speed = sense * np.array([30.0, 120.0, 300.0]), 150.0
        z = base.receptance(base.vector(values), w, speed)[:, :, 1]
        force = model.force_vector("journal", w, 1.0)
        xy = np.einsum("lij,lj->li", model.receptance(theta, w, speed), force)
        x = z if sense > 0 else z.conj()
        # phasors of x and y of a circle, and round-off of two inverses
        np.testing.assert_allclose(xy, np.hstack([x, -1j * sense * x]), rtol=1e-10)
    assert rf.models.threshold_speed(model, theta).speed == pytest.approx(
        rf.models.threshold_speed(base, base.vector(values)).speed, rel=1e-9
    )


def test_the_angle_turns_the_support() -> None:
    """With the axes turned by h, motion along h meets K + d/2 and across it K - d/2: two plain oscillators."""
    model = rf.models.Orthotropic(rf.models.OneMode())
    h, d, c = 0.7, 4000.0, 6.0
    values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 0.0, "D": 0.0, "lam": 0.0, "Mf": 0.0}
    theta = model.vector(values | {"dKs": d, "dDs": c, "angle_s": h})
    w = np.array([40.0, 90.0])
    H = model.receptance(theta, w, 0.0)
    axes = np.array([[np.cos(h), -np.sin(h)], [np.sin(h), np.cos(h)]])
    for sign, axis in ((1, axes[:, 0]), (-1, axes[:, 1])):
        plain = 1 / (8e3 + sign * d / 2 + 1j * w * (8.0 + sign * c / 2) - 1.2 * w**2)
        np.testing.assert_allclose(np.einsum("i,lij,j->l", axis, H, axis), plain, rtol=1e-12)


@pytest.mark.parametrize(
    "base",
    [rf.models.OneMode(), rf.models.TwoDisk(), rf.models.Chain(3, fluid="mass-3")],
    ids=lambda model: model.name,
)
def test_other_rotors_take_such_supports_too(base: rf.models.RotorModel) -> None:
    """Fitted to their own responses without noise, with both supports of a two-disk rotor of different kinds."""
    at = base.planes if base.name == "two-disk" else base.planes[-1:]
    model = rf.models.Orthotropic(base, at=at)
    truth = {q.name: q.scale if q.default is None else q.default for q in model.parameters}
    truth |= {"lam": 0.45} if "lam" in truth else {}
    theta = model.vector(truth)
    w = np.linspace(20.0, 300.0, 40)
    rows = []
    for speed in (80.0, 140.0):
        for plane in model.planes:
            for sense in (1, -1):
                A = np.einsum(
                    "lij,lj->li", model.receptance(theta, sense * w, speed), model.force_vector(plane, sense * w, 1.0)
                )
                for column, coordinate in enumerate(model.coordinates):
                    rows.append((f"{plane} {speed} {sense}", speed, sense * w, plane, coordinate, A[:, column]))
    test = rf.perturbation_test(
        run=np.repeat([r[0] for r in rows], w.size), speed=np.repeat([r[1] for r in rows], w.size),
        frequency=np.concatenate([r[2] for r in rows]), force_plane=np.repeat([r[3] for r in rows], w.size), force=1.0,
        plane=np.repeat([r[4].plane for r in rows], w.size), direction=np.repeat([r[4].axis for r in rows], w.size),
        response=np.concatenate([r[5] for r in rows]), sigma=1e-9,
    )  # fmt: skip
    known = {name: truth[name] for name in ("K", "Ds", "K4", "Ds3") if name in truth}
    fit = plain_fit(model, test, known=known)
    for name, parameter in fit.params.items():
        if parameter.vary and parameter.resolved:
            assert parameter.value == pytest.approx(truth[name], rel=1e-4, abs=1e-4 * model.parameter(name).scale), name
    assert fit.params["dKs" if len(at) == 1 else "dKs_1"].resolved


def test_saved_and_loaded_it_is_the_same(refined: rf.FitResult) -> None:
    loaded = fit_from_json(fit_to_json(refined))
    assert loaded.x.tolist() == refined.x.tolist()
    assert loaded.model.options()["at"] == ("journal",)


@pytest.mark.parametrize(
    "make",
    [
        lambda: rf.models.Orthotropic(rf.models.WhirlWhip(), at="jornal"),
        lambda: rf.models.Orthotropic(rf.models.Anisotropic(("a",))),
        lambda: rf.models.Orthotropic(rf.models.Overhung()),
        lambda: rf.models.Orthotropic(rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=100.0)),
        lambda: rf.models.Orthotropic(rf.models.WhirlWhip(), at=("journal", "journal")),
        lambda: rf.models.Orthotropic(rf.models.WhirlWhip()).variant(colour="red"),
    ],
)
def test_what_cannot_be_is_refused(make) -> None:
    with refuses(ValueError):
        make()


@pytest.mark.usefixtures("sketched")
def test_from_the_command_line(rig: OrthotropicRig, tmp_path, capsys) -> None:
    rf.write(rig.tests(RPM * np.array([1000.0, 2000.0]), seed=2, lines=40), tmp_path / "rig.csv")
    words = ["fit", str(tmp_path / "rig.csv"), "--model", "whirl-whip", "--known", f"K3={(K3X + K3Y) / 2:g}"]
    assert main([*words, "--orthotropic", "journal", "--out", str(tmp_path / "out")]) == 0
    assert "dKs" in capsys.readouterr().out
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "--orthotropic journal" in report
    assert "rf.models.Orthotropic(base=rf.models.WhirlWhip()" in report
    assert main([*words, "--orthotropic", "bearing"]) == 2
    hear(capsys.readouterr().err)
