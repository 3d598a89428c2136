"""Static positions from gap voltages, against the equilibria that were recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sentences import refuses
from unreliable import Unreliable

import rotorfit as rf
from rotorfit.apps.cli.main import main

RIG = rf.models.WhirlWhip()
VALUES = {"Md": 0.97, "Ds": 3.0, "K1": 14e3, "K2": 14e3, "sigma": 1.0, "Mb": 0.33, "K3": 6e3, "K0": 9e3, "D": 450.0,
          "lam": 0.475, "Mf": 0.35}  # fmt: skip
STEADY = rf.Instruments(sample_rate=2048.0, wander=0.0)
CENTRED = """
[[probe]]
plane = "disk"
channel = "disk_X"
centre_V = -10.0
[[probe]]
plane = "disk"
channel = "disk_Y"
centre_V = -10.0
[[probe]]
plane = "journal"
channel = "journal_X"
centre_V = -10.0
[[probe]]
plane = "journal"
channel = "journal_Y"
centre_V = -10.0
"""


def loaded(folder: Path, how: rf.Instruments = STEADY, seed: int = 0) -> list[rf.Recording]:
    """Without load and under 4 and 9 N, at two speeds."""
    paths = rf.simulate_recordings(
        RIG, VALUES, folder, "static-load", load=[4.0, 9.0], speed_rpm=[900.0, 1500.0], duration=2.0, instruments=how,
        seed=seed,
    )  # fmt: skip
    return [rf.read_recording(path) for path in paths]


def exact(test: rf.StaticTest) -> np.ndarray:
    H = RIG.receptance(RIG.vector(VALUES), np.zeros(len(test)), test.speed)
    to, at = [RIG.coordinate(plane, "z") for plane in test.plane], RIG.coordinate("journal", "z")
    return np.array([H[i, coordinate, at] for i, coordinate in enumerate(to)]) * test.load


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[rf.Recording]:
    return loaded(tmp_path_factory.mktemp("static"))


@pytest.mark.slow
def test_positions_are_those_of_the_loaded_rotor_and_errors_hold(tmp_path: Path, records: list[rf.Recording]) -> None:
    """From the centre's voltage: 5 draws of 8 complex positions, 80 numbers, whose rms is known to 8 %.

    The scatter over 16 parts, the larger of two ways to pool it, makes sigma up to a fifth too large.
    """
    setup = tmp_path / "centred.toml"
    setup.write_text(CENTRED)
    ratios = []
    for seed in range(5):
        test = rf.static_positions([rf.read_recording(r.path, setup) for r in loaded(tmp_path, seed=seed)])
        error = (test.displacement - exact(test)) / test.sigma
        ratios += [error.real, error.imag]
    assert len(test) == 8
    assert 0.65 < np.sqrt(np.mean(np.square(ratios))) < 1.2
    # counted from recordings without load: their error is in all, as often as there are positions that share it
    apart = rf.static_positions(records)
    assert np.abs((apart.displacement - exact(apart)) / apart.sigma).max() < 4
    # 1 + 2 times the variance of one recording, two groups of four of which are compared: known to 15 %
    assert np.mean(apart.sigma**2) / np.mean(test.sigma**2) > 1.5


def test_recordings_whose_worker_was_lost_are_read_again(records: list[rf.Recording]) -> None:
    """Two of eight are lost at first, and sent again."""
    pool = Unreliable(2)
    again = rf.static_positions(records, executor=pool)
    assert pool.attempts == len(records) + 2
    alone = rf.static_positions(records)
    np.testing.assert_array_equal(again.displacement, alone.displacement)
    np.testing.assert_array_equal(again.sigma, alone.sigma)


@pytest.mark.usefixtures("sketched")
def test_fit_from_the_command_line_finds_the_fluid(
    records: list[rf.Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = [
        word for name, value in VALUES.items() if name not in ("K0", "lam") for word in ("--known", f"{name}={value}")
    ]
    files = [str(record.path) for record in records]
    assert main(["fit", *files, "--model", "whirl-whip", *known, "--out", str(tmp_path / "out")]) == 0
    fit = rf.load_fit(tmp_path / "out" / "fit.json")
    assert 0.1 < fit.redchi < 1.5  # the shared error of the unloaded position counts twice in each of two
    for name in ("K0", "lam"):
        assert abs(fit.params[name].value - VALUES[name]) < 4 * fit.params[name].stderr, name
    assert "rf.static_positions([" in (tmp_path / "out" / "report.html").read_text()
    assert main(["vectors", *files, "--out", str(tmp_path / "static.csv"), "--quiet"]) == 0
    again = rf.read(tmp_path / "static.csv")
    assert isinstance(again, rf.StaticTest)
    capsys.readouterr()


def test_a_shaft_that_stands_still_and_repeated_zeros(tmp_path: Path) -> None:
    """Without marks; and two recordings without load that differ by 5 um say that every position may."""
    still = replace(STEADY, runout=())
    rest, under = rf.simulate_recordings(
        RIG, VALUES, tmp_path, "static-load", load=9.0, speed_rpm=0.0, duration=2.0, instruments=still
    )
    test = rf.static_positions([rf.read_recording(rest), rf.read_recording(under)])
    assert np.abs((test.displacement - exact(test)) / test.sigma).max() < 4
    (tmp_path / "again").mkdir()
    drifted = rf.simulate_recordings(
        RIG, VALUES, tmp_path / "again", "static-load", load=9.0, speed_rpm=0.0, duration=2.0,
        instruments=replace(still, gap=-10.0 + 7870 * 5e-6), seed=3,
    )[0].rename(tmp_path / "later.h5")  # fmt: skip
    wider = rf.static_positions([rf.read_recording(path) for path in (rest, under, drifted)])
    assert (wider.sigma > 3e-6).all()
    assert (test.sigma < 1e-7).all()


def test_positions_over_a_run_up_need_the_centre(tmp_path: Path) -> None:
    two = rf.models.TwoDisk()
    values = {"M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0, "D11": 14.2, "D12": 7.0, "D21": 7.0,
              "D22": 14.8, "beta1": 1.0, "beta2": 1.0}  # fmt: skip
    path = rf.simulate_recordings(
        two, values, tmp_path, "synchronous", speed_rpm=(1000.0, 2000.0), duration=8.0, planes="inboard",
        instruments=STEADY,
    )[0]  # fmt: skip
    setup = tmp_path / "rig.toml"
    setup.write_text('[load]\nplane = "inboard"\nN = 3.0\nangle_deg = -90\n')
    with refuses(ValueError):
        rf.static_positions(rf.read_recording(path, setup))
    probes = [f'[[probe]]\nplane = "{c[:-2]}"\nchannel = "{c}"\ncentre_V = -9.5\n'
              for c in ("inboard_X", "inboard_Y", "outboard_X", "outboard_Y")]  # fmt: skip
    setup.write_text("\n".join([setup.read_text(), *probes]))
    test = rf.static_positions(rf.read_recording(path, setup))
    assert len(test) == 40
    assert np.ptp(test.speed) > 90.0
    offset = -0.5 / 7870 * (1 + 1j)
    assert np.abs((test.displacement - offset) / test.sigma).max() < 5


def test_what_tells_no_position_is_refused(records: list[rf.Recording], tmp_path: Path) -> None:
    coupled = loaded(tmp_path, replace(STEADY, ac_coupled=True))
    with refuses(ValueError):
        rf.static_positions(coupled)
    with refuses(ValueError):
        rf.static_positions([r for r in records if r.rig.load.newton])  # type: ignore[union-attr]
    with refuses(ValueError):
        rf.static_positions(records[0])
    found = rf.static_positions([records[0], records[4]]).findings
    assert [finding.code for finding in found] == ["unloaded-elsewhere"] * 2
    setup = tmp_path / "one.toml"
    setup.write_text('[[probe]]\nplane = "disk"\nchannel = "disk_X"\n')
    with refuses(ValueError):
        rf.static_positions([rf.read_recording(r.path, setup) for r in records])
    setup.write_text('[load]\nplane = "disk"\nN = -3.0\n')
    with refuses(ValueError):
        rf.read_recording(records[0].path, setup)
    setup.write_text("[load]\nN = 3.0\n")
    (tmp_path / "bare").mkdir()
    bare = rf.simulate_recordings(RIG, VALUES, tmp_path / "bare", "impulse", blows=1, instruments=STEADY)[0]
    with refuses(ValueError):
        rf.read_recording(bare, setup)
