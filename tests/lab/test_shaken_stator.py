"""Recordings of forces along x and along y at once: cross-talk, dry runs, exchanged channels."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
from plain import plain_fit
from seal_rig import FLUID
from sentences import hear, refuses
from shaken_stator import SETUP, multisine, rods, shaken

import rotorfit as rf

MODEL = rf.models.Anisotropic(("stator",))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stator")
    (folder / "rig.toml").write_text(SETUP)
    swapped = SETUP.replace('channel_x = "cell_X"', 'channel_x = "cell_Y"').replace('y = "cell_Y"', 'y = "cell_X"')
    (folder / "swapped.toml").write_text(swapped)
    shaken(folder, rpm=3000.0, band_hz=(40.0, 200.0), duration=6.0)
    return folder


def with_attributes(rig: Path, folder: Path, axis: str, attributes: dict[str, object]) -> rf.Recording:
    """A recording of the rig whose file says more of its state."""
    path = folder / f"wet-3000-shaken-{axis}.h5"
    shutil.copyfile(rig / path.name, path)
    with h5py.File(path, "r+") as file:
        file.attrs.update(attributes)
    return rf.read_recording(path, rig / "rig.toml")


def reduced(folder: Path, names: list[str], setup: str = "rig.toml") -> rf.PerturbationTest:
    return rf.responses([rf.read_recording(folder / f"{name}.h5", folder / setup) for name in names])


def misses(fit: rf.FitResult, wet: bool = True) -> np.ndarray:
    """Errors of K and D over their standard errors, the rods counted with the fluid where nothing was taken out."""
    K, C = rods()
    held = dict(zip([k + a + b for k in "KD" for a in "xy" for b in "xy"], [*K.ravel(), *C.ravel()], strict=True))
    truth = FLUID(3000.0)
    names = [name for name in truth if name[0] in "KD"]
    return np.array(
        [(fit.params[n].value - truth[n] - (held[n] if wet else 0.0)) / fit.params[n].stderr for n in names]
    )


def test_cross_talk_of_the_other_shaker_biases_nothing(rig: Path, tmp_path: Path) -> None:
    """3 % and 40 %; noise of forces and motion, motion integrated in time."""
    test = reduced(rig, ["wet-3000-shaken-x", "wet-3000-shaken-y"])
    assert test.forces == ("stator along x", "stator along y")
    fit = plain_fit(MODEL, test)
    assert np.abs(misses(fit)).max() < 4
    assert 0.7 < fit.redchi < 1.3
    (tmp_path / "rig.toml").write_text(SETUP)
    shaken(tmp_path, rpm=3000.0, cross_talk=0.4, band_hz=(40.0, 200.0), duration=6.0)
    test = reduced(tmp_path, ["wet-3000-shaken-x", "wet-3000-shaken-y"])
    assert test.forces == ("stator along x + stator along y", "stator along y + stator along x")
    fit = plain_fit(MODEL, test)
    assert np.abs(misses(fit)).max() < 4
    assert 0.7 < fit.redchi < 1.3


def test_responses_are_chosen_by_frequency(rig: Path) -> None:
    records = [rf.read_recording(rig / f"wet-3000-shaken-{axis}.h5", rig / "rig.toml") for axis in "xy"]
    whole, part = rf.responses(records), rf.responses(records, where={"frequency_hz": (80.0, 120.0)})
    hz = np.abs(whole.frequency) / (2 * np.pi)
    np.testing.assert_array_equal(part.response, whole.response[(hz >= 80.0) & (hz <= 120.0)])


@pytest.mark.parametrize("attributes", [{}, {"shake": "xy"}, {"shake": "xy", "P_bar": (30.0, 30.0)}])
def test_a_pair_is_reduced_together_whatever_tells_it_apart(
    rig: Path, tmp_path: Path, attributes: dict[str, Sequence[object]]
) -> None:
    """A word for the axis keeps no pair apart."""
    whole = reduced(rig, ["wet-3000-shaken-x", "wet-3000-shaken-y"])
    marked = [
        with_attributes(rig, tmp_path, axis, {name: values[number] for name, values in attributes.items()})
        for number, axis in enumerate("xy")
    ]
    test = rf.responses(marked)
    found = test.findings
    assert test.forces == whole.forces
    np.testing.assert_array_equal(test.response, whole.response)
    assert not [one for one in found if one.code == "shaken-apart"]


def test_what_keeps_a_pair_apart_is_named(rig: Path, tmp_path: Path) -> None:
    marked = [with_attributes(rig, tmp_path, axis, {"P_bar": bar}) for axis, bar in (("x", 29.0), ("y", 31.0))]
    found = rf.responses(marked).findings
    (one,) = [one for one in found if one.code == "shaken-apart"]
    hear(one.message)


def test_repeats_are_averaged(tmp_path: Path) -> None:
    """Two tests of six recordings, whose errors are a root of three less."""
    (tmp_path / "rig.toml").write_text(SETUP)
    records = []
    for seed in range(3):
        (tmp_path / str(seed)).mkdir()
        for path in shaken(tmp_path / str(seed), rpm=3000.0, duration=4.0, band_hz=(40.0, 200.0), seed=seed):
            records.append(rf.read_recording(path, tmp_path / "rig.toml"))
    one, all_of_them = rf.responses(records[:2]), rf.responses(records)
    assert [run.rpartition("/")[2] for run in all_of_them.runs] == [
        f"wet-3000-shaken-{axis} and 2 more" for axis in "xy"
    ]
    size = [np.median(np.abs(test.sigma / test.response)) for test in (one, all_of_them)]
    per_line = np.sqrt(len(one) / len(all_of_them))
    assert size[0] * per_line / size[1] == pytest.approx(np.sqrt(3), rel=0.25)
    fit = plain_fit(MODEL, all_of_them)
    assert np.abs(misses(fit)).max() < 4
    assert 0.7 < fit.redchi < 1.3


def test_tones_of_a_multisine_are_the_lines(tmp_path: Path) -> None:
    """Every 10 Hz, among them 50, 60 and 150: each is told as well as its own noise allows, and is not hum."""
    (tmp_path / "rig.toml").write_text(SETUP)
    tones = np.arange(20.0, 191.0, 10.0)
    records = [rf.read_recording(path, tmp_path / "rig.toml") for path in multisine(tmp_path, tones)]
    test = rf.responses(records)
    found = test.findings
    assert not [one for one in found if one.code == "hum"]
    hz = np.unique(np.round(np.abs(test.frequency) / (2 * np.pi), 6))
    assert np.abs(hz - tones[np.abs(hz[:, None] - tones).argmin(axis=1)]).max() < 0.25  # half a line of the record
    assert hz.size == tones.size
    fit = plain_fit(MODEL, test)
    assert np.abs(misses(fit)).max() < 4
    assert 0.5 < fit.redchi < 1.5


def test_one_recording_alone_has_both_forces(rig: Path) -> None:
    test = reduced(rig, ["wet-3000-shaken-x"])
    assert test.forces == ("stator along x + stator along y",)
    ratio = np.array([acting[0][1] for acting in test.further_forces]) / test.force
    off = (ratio - 0.03 * np.exp(-2e-3j * test.frequency)) * test.force / test.force_sigma
    assert np.sqrt(np.mean(np.abs(off) ** 2) / 2) == pytest.approx(1.0, abs=0.2)


def test_a_dry_run_in_volts_is_taken_out(rig: Path, tmp_path: Path) -> None:
    shaken(rig, rpm=0.0, wet=False, band_hz=(10.0, 240.0), duration=12.0, force=90.0, seed=4)
    test = reduced(rig, ["wet-3000-shaken-x", "wet-3000-shaken-y"])
    dry = reduced(rig, ["dry-0-shaken-x", "dry-0-shaken-y"])
    known = {f"M{a}{b}": 0.0 for a in "xy" for b in "xy"}
    fit = plain_fit(MODEL, test, baseline=dry, known=known)
    assert np.abs(misses(fit, wet=False)).max() < 4
    rf.write(dry, tmp_path / "dry.csv")  # with sigma and, as a column more, the coherence
    again = rf.read(tmp_path / "dry.csv")
    np.testing.assert_allclose(again.sigma, dry.sigma)
    np.testing.assert_allclose(again.attributes["coherence"].astype(float), dry.attributes["coherence"])


def test_shakers_that_run_at_once_are_refused(rig: Path) -> None:
    shaken(rig, rpm=100.0, cross_talk=0.4, both=True, duration=4.0)
    records = [rf.read_recording(rig / f"wet-100-shaken-{axis}.h5", rig / "rig.toml") for axis in "xy"]
    with refuses(ValueError):
        rf.responses(records)


def test_exchanged_force_channels_are_named(rig: Path) -> None:
    names = ["wet-3000-shaken-x", "wet-3000-shaken-y"]
    assert not [f for f in rf.check(reduced(rig, names)) if f.severity == "error"]
    found = [f for f in rf.check(reduced(rig, names, "swapped.toml")) if f.severity == "error"]
    assert [f.code for f in found] == ["axes"]
    hear(found[0].message)


def test_a_test_of_many_recordings_is_called_for_the_first() -> None:
    from rotorfit.lab.data.rows import short_source

    assert short_source("a.mat, b.mat with rig.toml") == "a.mat, b.mat with rig.toml"
    assert short_source(", ".join(f"{k}.mat" for k in range(24)) + " with rig.toml") == "0.mat and 23 more"
