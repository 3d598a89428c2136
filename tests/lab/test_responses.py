"""From recordings that were integrated in time to responses and parameters, against the truth they were made with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_words import FROM_VOLTS, toml_file
from plain import plain_fit
from scipy.integrate import solve_ivp
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.simulation.rig import linear_path

RIG = rf.models.WhirlWhip()
VALUES = {"Md": 0.97, "Ds": 3.0, "K1": 14e3, "K2": 14e3, "sigma": 1.0, "Mb": 0.33, "K3": 6e3, "K0": 9e3, "D": 450.0,
          "lam": 0.475, "Mf": 0.35}  # fmt: skip
ROTOR = rf.models.TwoDisk()
PAPER = {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0, "D11": 14.2, "D12": 7.0, "D21": 7.0,
         "D22": 14.8, "beta1": 1.0, "beta2": 1.0}  # fmt: skip
SLOW = rf.Instruments(sample_rate=4096.0)


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four sweeps of 10 s at one speed: 3 times as fast as a test would be run."""
    return rf.simulate_recordings(
        RIG, VALUES, tmp_path_factory.mktemp("sweeps"), speed_rpm=1500.0, duration=10.0, instruments=SLOW, seed=1
    )


@pytest.fixture(scope="module")
def swept(sweeps: list[Path]) -> rf.PerturbationTest:
    return rf.responses([rf.read_recording(path) for path in sweeps])


def over_sigma(
    model: rf.models.RotorModel, values: dict[str, float], test: rf.PerturbationTest
) -> dict[str, np.ndarray]:
    """Error over sigma of the component in the direction of the force, by channel, real and imaginary parts."""
    theta, found = model.vector(values), {}
    for run in test.runs:
        for plane in test.planes:
            x, y = ((test.run == run) & (test.plane == plane) & (test.direction == d) for d in "xy")
            forward = test.frequency[x] > 0
            right = np.where(
                forward, test.response[x] + 1j * test.response[y], test.response[x] - 1j * test.response[y]
            )
            H = model.receptance(theta, test.frequency[x], test.speed[x])
            H = H[:, model.coordinate(plane, "z"), model.coordinate(test.force_plane[x][0], "z")]
            exact = np.where(forward, H, H.conj()) * test.force[x]
            error = (right / 2 - exact) / (np.hypot(test.sigma[x], test.sigma[y]) / 2)
            found[f"{run} {plane}"] = np.concatenate([error.real, error.imag])
    return found


def test_errors_of_sweeps_are_those_stated(swept: rf.PerturbationTest) -> None:
    """90 to 300 numbers a channel: their rms is known to 4 to 8 %, and the angle of the marks adds a little."""
    for name, ratio in over_sigma(RIG, VALUES, swept).items():
        assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.3, name


def test_fit_of_sweeps_of_ten_seconds_finds_the_rig(swept: rf.PerturbationTest) -> None:
    fit = plain_fit(RIG, swept, known={"K3": 6e3})
    assert 0.85 < fit.redchi < 1.25
    for name in ("Md", "Ds", "K1", "K2", "D", "lam"):
        found = fit.params[name]
        assert abs(found.value - VALUES[name]) < 4 * found.stderr, name
    assert fit.params["D"].value == pytest.approx(450.0, rel=1e-3)
    assert fit.params["lam"].value == pytest.approx(0.475, rel=1e-3)


def test_lines_are_few_and_none_is_at_an_order(swept: rf.PerturbationTest) -> None:
    lines = len(swept) / 4 / len(swept.runs)
    assert 40 < lines < 250
    order = np.abs(swept.frequency) / swept.speed
    resolution = 2 * np.pi / 10.0 / swept.speed
    assert (np.abs(order - np.rint(order))[order > 0.5] > resolution[order > 0.5]).all()


def test_start_ups_find_the_rotor_and_the_zero_of_the_holes(tmp_path: Path) -> None:
    paths = rf.simulate_recordings(
        ROTOR, PAPER, tmp_path, "synchronous", duration=20.0, instruments=SLOW, hole_zero_deg=25.0, seed=2
    )
    test = rf.responses([rf.read_recording(path) for path in paths])
    found = test.findings
    assert [finding.code for finding in found] == ["phase-datum"]
    assert test.synchronous
    assert len(test.runs) == 2

    fit = plain_fit(ROTOR, test, phase_offsets="common")
    assert np.degrees(fit.params["datum"].value) == pytest.approx(25.0, abs=0.05)
    assert 0.8 < fit.redchi < 1.3
    for name in ("M1", "M2", "K1", "K2", "K3"):
        assert fit.params[name].value == pytest.approx(PAPER[name], rel=1e-3), name
        assert abs(fit.params[name].value - PAPER[name]) < 4 * fit.params[name].stderr, name


def test_one_start_up_alone_says_that_residual_unbalance_is_in_it(tmp_path: Path) -> None:
    paths = rf.simulate_recordings(
        ROTOR, PAPER, tmp_path, "synchronous", duration=10.0, planes="inboard", instruments=SLOW
    )
    test = rf.responses(rf.read_recording(paths[0]))
    found = test.findings
    assert [finding.code for finding in found] == ["phase-datum", "not-differenced"]
    assert (test.attributes["differenced"] == 0).all()


def test_a_plane_with_one_probe_gives_that_probe(
    sweeps: list[Path], swept: rf.PerturbationTest, tmp_path: Path
) -> None:
    setup = tmp_path / "rig.toml"
    setup.write_text(
        '[[probe]]\nplane = "disk"\nchannel = "disk_X"\nangle_deg = 0\n'
        '[[probe]]\nplane = "journal"\nchannel = "journal_Y"\nangle_deg = 90\n'
    )
    test = rf.responses(rf.read_recording(sweeps[0], setup))
    assert {(p, d) for p, d in zip(test.plane.tolist(), test.direction.tolist(), strict=True)} == {
        ("disk", "x"), ("journal", "y"),
    }  # fmt: skip
    ratios = []
    for plane, direction in (("disk", "x"), ("journal", "y")):
        alone = test.select((test.plane == plane) & (test.direction == direction))
        H = RIG.receptance(RIG.vector(VALUES), alone.frequency, alone.speed)
        exact = (
            H[:, RIG.coordinate(plane, "z"), RIG.coordinate("disk", "z")]
            * alone.force
            * (1 if direction == "x" else -1j)
        )
        error = (alone.response - exact) / alone.sigma
        ratios += [error.real, error.imag]
    assert np.sqrt(np.mean(np.concatenate(ratios) ** 2)) == pytest.approx(1.0, abs=0.25)


def test_what_is_missing_or_mixed_is_refused(sweeps: list[Path], tmp_path: Path) -> None:
    started = rf.simulate_recordings(
        ROTOR, PAPER, tmp_path, "synchronous", duration=5.0, planes="inboard", instruments=SLOW
    )
    with refuses(ValueError):
        rf.responses([rf.read_recording(sweeps[0]), rf.read_recording(started[0])])
    with refuses(ValueError):
        rf.responses([])
    for paths in ("disk-fwd.h5", [Path("disk-fwd.h5")]):
        with refuses(TypeError):
            rf.responses(paths)  # type: ignore[arg-type]


def test_vectors_from_the_command_line_read_back_and_fit(
    sweeps: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rig.csv"
    assert main(["vectors", *map(str, sweeps[:2]), "--out", str(out)]) == 0
    assert "perturbation test" in capsys.readouterr().out
    test = rf.read(out)
    assert isinstance(test, rf.PerturbationTest)
    assert np.isfinite(test.sigma).all()
    assert main(["vectors", str(sweeps[0]), "--out", str(tmp_path / "rig.xyz")]) == 2
    assert main(["vectors", str(tmp_path / "none.h5"), "--out", str(out)]) == 2
    assert main(["fit", str(sweeps[0]), "--model", "one-mode", "--speed", "1500"]) == 2
    hear(capsys.readouterr().err)


def test_linear_path_is_that_of_a_general_integrator() -> None:
    """DOP853 at 1e-11 against modes and quadrature: a swept force and a speed that rises with it."""

    def speed(t: np.ndarray) -> np.ndarray:
        return np.asarray(100.0 + 30.0 * np.asarray(t))

    def force(t: np.ndarray) -> np.ndarray:
        f = np.zeros((t.size, 2), complex)
        f[:, 0] = 3.0 * np.exp(1j * (50.0 * t + 40.0 * t**2))
        return f

    theta, rate, count = RIG.vector(VALUES), 2048.0, 2048

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        k, c, m = RIG.coefficients(theta, float(speed(np.array(t))))
        z, v = state[:2], state[2:]
        return np.concatenate([v, np.linalg.solve(m, force(np.array([t]))[0] - k @ z - c @ v)])

    time = np.arange(count) / rate
    exact = solve_ivp(slope, (0, time[-1]), np.zeros(4, complex), method="DOP853", rtol=1e-10, atol=1e-16, t_eval=time)
    found = linear_path(RIG, theta, speed=speed, force=force, rate=rate, count=count)
    # a block of 64 steps is 31 ms: the speed is off by up to 0.5 rad/s at its ends, both ways
    assert np.abs(found - exact.y[:2].T).max() < 2e-3 * np.abs(found).max()
    steady = linear_path(RIG, theta, speed=lambda t: np.full(np.shape(t), 100.0), force=force, rate=rate, count=count)

    def steady_slope(t: float, state: np.ndarray) -> np.ndarray:
        k, c, m = RIG.coefficients(theta, 100.0)
        return np.concatenate([state[2:], np.linalg.solve(m, force(np.array([t]))[0] - k @ state[:2] - c @ state[2:])])

    exact = solve_ivp(
        steady_slope, (0, time[-1]), np.zeros(4, complex), method="DOP853", rtol=1e-11, atol=1e-17, t_eval=time
    )
    assert np.abs(steady - exact.y[:2].T).max() < 1e-8 * np.abs(steady).max()


def test_bundled_recordings_are_those_that_their_words_make(tmp_path: Path) -> None:
    import h5py

    made = rf.simulate_recordings(
        RIG, rf.datasets.truth("volts")["params"], tmp_path, speed_rpm=1500.0, duration=10.0,
        instruments=rf.Instruments(sample_rate=4096.0), seed=7,
    )  # fmt: skip
    for new, old in zip(made, rf.datasets.volts(), strict=True):
        with h5py.File(new) as a, h5py.File(old) as b:
            assert dict(a.attrs) == pytest.approx(dict(b.attrs))
            for name in b:
                # another machine may round a sample over to the next count
                assert np.abs(a[name][:].astype(int) - b[name][:]).max() <= 1, (old.name, name)


@pytest.mark.usefixtures("sketched")
def test_demo_from_volts_meets_the_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "rotorfit-demo"
    assert main(FROM_VOLTS) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "against the rig's truth" in shown.out
    fit = rf.load_fit(out / "fit.json")
    for name, value in rf.datasets.truth("volts")["params"].items():
        if name != "K3":
            assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name
    # The report shows what was recorded, what was done to it, and a cascade of each recording.
    page = (out / "report.html").read_text(encoding="utf-8")
    recorded = page[page.index("<h2>Recordings") : page.index("<h2>Model")]
    for path in rf.datasets.volts():
        record = rf.read_recording(path)
        assert recorded.count(record.name) >= 2, path
        assert f"({record.shaft_angle().pulses.size} pulses)" in recorded
        assert f"{record.force.mr * 1e6:.4g}"[:3] in recorded
    assert "local models in the signed frequency" in recorded
    assert len(list(out.glob("cascade_*.png"))) == 4


def test_recordings_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    test = {"kind": "synchronous", "duration": 3, "speed_rpm": [300, 5000], "sampling_hz": 2048}
    virtual = toml_file(tmp_path / "virtual.toml", model="two-disk", params=PAPER, test=test)
    assert main(["simulate", str(virtual), "--recordings", str(tmp_path / "raw")]) == 0
    names = ["inboard-0.h5", "inboard-180.h5", "outboard-0.h5", "outboard-180.h5"]
    assert sorted(path.name for path in (tmp_path / "raw").glob("*.h5")) == names
    assert capsys.readouterr().out.count("written: ") == 4


@pytest.mark.slow
def test_awkward_recordings_are_mended_and_give_the_same_rig(tmp_path: Path) -> None:
    """Probes at +-45 degrees, hum, three missing and four double pulses and a clipped channel, all at once."""
    awkward = rf.Instruments(
        sample_rate=4096.0, probe_angles=(-45.0, 45.0), hum=0.02, lost=3, doubled=4, clipped="disk_X"
    )
    paths = rf.simulate_recordings(RIG, VALUES, tmp_path, speed_rpm=1480.0, duration=10.0, instruments=awkward, seed=3)
    records = [rf.read_recording(path) for path in paths]
    test = rf.responses(records)
    found = test.findings
    assert {"probe-left-out"} <= {finding.code for finding in found}
    for record in records:
        said = {finding.code: finding.message for finding in record.findings}
        assert {"hum", "pulses-missing", "pulses-double", "channel-clipped"} <= set(said), record.name
        assert "3 pulses missing" in said["pulses-missing"]
        assert "4 edges that are no pulses" in said["pulses-double"]
        assert "disk_X" in said["channel-clipped"]
    assert not ((test.plane == "disk") & (test.direction == "y")).any()  # one probe stands for a circular orbit
    fit = plain_fit(RIG, test, known={"K3": 6e3})
    assert 0.8 < fit.redchi < 1.25
    for name in ("Md", "K1", "K2", "D", "lam"):
        assert abs(fit.params[name].value - VALUES[name]) < 4 * fit.params[name].stderr, name
    assert fit.params["lam"].value == pytest.approx(0.475, rel=1e-3)


def test_measured_forces_that_turn_and_that_do_not(tmp_path: Path) -> None:
    """A magnetic bearing's force: forward, backward and along x, 12 s each; one fit of all three."""
    paths = rf.simulate_recordings(
        RIG, VALUES, tmp_path, "measured-force", planes="journal", duration=12.0, instruments=SLOW, seed=4
    )
    test = rf.responses([rf.read_recording(path, tmp_path / "rig.toml") for path in paths])
    assert list(dict.fromkeys(test.force_direction.tolist())) == ["circular", "x"]
    turning = test.select(test.force_direction == "circular")
    assert {run: np.sign(turning.frequency[turning.run == run][0]) for run in turning.runs} == {
        "journal-forward": 1.0, "journal-backward": -1.0,
    }  # fmt: skip
    for name, ratio in over_sigma(RIG, VALUES, turning).items():
        assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.3, name
    fit = plain_fit(RIG, test, known={"K3": 6e3, "sigma": 1.0})
    assert 0.8 < fit.redchi < 1.25
    for name in ("Mb", "K0", "D", "lam", "Mf"):
        assert abs(fit.params[name].value - VALUES[name]) < 4 * fit.params[name].stderr, name
