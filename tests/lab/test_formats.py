"""Universal, netCDF and MAT files: round trips to the last digit of the format, and files that are broken."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analyser_files import shaker_test, written
from any_test import PLAIN_NAMES, imposed_orbits, rigs, same
from hypothesis import HealthCheck, given, settings
from seal_campaigns import seal_campaign
from sentences import refuses
from slow_cases import slow_but
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.io.files import read
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.models import WhirlWhip

UFF_RTOL = 1.1e-11
"""Twelve digits round to 5e-12 of a number; a response is FRF times force, so two such errors meet."""


def round_trip(test: Experiment, path: Path) -> Experiment:
    """Write and read again, by the suffix of the path."""
    rf.write(test, path)
    return read(path, difference=False)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the examples of hypothesis may share."""
    return tmp_path_factory.mktemp("formats")


few = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])


# ---- round trips ------------------------------------------------------------------------------


@few
@given(test=rigs())
def test_netcdf_keeps_every_bit_of_any_test(place: Path, test: PerturbationTest) -> None:
    same(round_trip(test, place / "t.nc"), test, rtol=0)


@few
@given(test=rigs())
def test_mat_keeps_every_bit_of_any_test(place: Path, test: PerturbationTest) -> None:
    same(round_trip(test, place / "t.mat"), test, rtol=0)


@few
@given(test=rigs(PLAIN_NAMES, text_attributes=False))
def test_uff_keeps_twelve_digits_of_any_test(place: Path, test: PerturbationTest) -> None:
    same(round_trip(test, place / "t.uff"), test, rtol=UFF_RTOL)


@pytest.mark.slow
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(test=imposed_orbits())
def test_imposed_orbits_keep_every_bit(place: Path, test: DisplacementTest) -> None:
    for suffix in (".nc", ".mat"):
        same(round_trip(test, place / f"orbit{suffix}"), test, rtol=0)


@pytest.mark.parametrize("suffix", [".csv", ".uff", ".unv", ".nc", ".mat"])
@pytest.mark.parametrize("name", slow_but(["rig_open", "two_disk"], "two_disk"))
def test_bundled_rigs_through_every_format(tmp_path: Path, name: str, suffix: str) -> None:
    test = rf.read(rf.datasets.path(f"{name}.csv"), difference=False)
    same(
        round_trip(test, tmp_path / f"t{suffix}"), test, rtol={".nc": 0, ".mat": 0, ".csv": 1e-13}.get(suffix, UFF_RTOL)
    )


@pytest.mark.parametrize("suffix", [".uff", ".nc", ".mat"])
def test_a_fit_does_not_see_the_format(tmp_path: Path, suffix: str) -> None:
    rig = rf.datasets.rig_open()
    start = rf.closed_form(WhirlWhip(), rig, known={"K3": 6000.0})
    again = rf.closed_form(WhirlWhip(), round_trip(rig, tmp_path / f"rig{suffix}"), known={"K3": 6000.0})
    for name, parameter in start.params.items():
        assert again.params[name].value == pytest.approx(parameter.value, rel=1e-8)


def test_several_speeds_noise_phases_and_attributes_survive(tmp_path: Path) -> None:
    model = WhirlWhip()
    theta = model.vector(TYPICAL["whirl-whip"])
    w = covering_frequencies(model, theta, (100.0, 200.0), 20)
    test = circular_test(model, theta, speeds=(100.0, 200.0), frequency=w, noise=0.01, sigma_known=True)
    values = {name: getattr(test, name) for name in test._columns()}
    values["force"] = test.force * np.exp(1j * np.linspace(-3, 3, len(test)))
    values["sigma"] = np.where(np.arange(len(test)) % 3 == 0, np.nan, test.sigma)
    oil = np.where(np.arange(len(test)) % 5 == 0, np.nan, 40 + np.arange(len(test)) / 7)
    test = PerturbationTest(**values, attributes={"oil_C": oil, "pressure, bar": oil / 20}, source="made")
    for suffix in (".csv", ".uff", ".nc", ".mat"):
        again = round_trip(test, tmp_path / f"t{suffix}")
        same(again, test, rtol=UFF_RTOL)
        assert again.source == f"t{suffix}"


def test_text_attributes_are_refused_by_uff_only(tmp_path: Path) -> None:
    test = perturbation_test(
        run=["a"], speed=1.0, frequency=2.0, force_plane=["p"], force=1.0, plane=["p"], direction=["x"],
        response=1e-6, attributes={"oil": "VG 32"},
    )  # fmt: skip
    with refuses(ValueError):
        rf.write(test, tmp_path / "t.uff")
    assert list(tmp_path.iterdir()) == []
    same(round_trip(test, tmp_path / "t.nc"), test, rtol=0)


# ---- broken files -----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".uff", ".nc", ".mat", ".csv"])
@pytest.mark.parametrize("content", [b"", b"\x00\x01\xff junk", b"-1\n 58\n", b"CDF\x01", b"\x89HDF\r\n\x1a\n"])
def test_junk_is_refused_in_words(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"t{suffix}"
    path.write_bytes(content)
    with refuses(ValueError) as error:
        rf.read(path)
    assert len(str(error.value).split()) > 4


@pytest.mark.parametrize("suffix", [".uff", ".nc", ".mat"])
@pytest.mark.filterwarnings("ignore")  # what libraries say about a file cut short is not ours
def test_files_cut_short_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    rf.write(rf.datasets.two_disk(), path)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    for size in [*range(0, 200, 50), *rng.integers(200, len(whole) - 100, 8).tolist()]:
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=path.name):
            rf.read(path)


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.filterwarnings("ignore")  # unknown units and directions that the damage made
def test_damaged_universal_files_are_read_or_refused_in_words(tmp_path: Path, own: bool) -> None:
    path = tmp_path / "t.uff"
    if own:
        rf.write(rf.datasets.two_disk().select(np.arange(0, 960, 12)), path)
    else:
        written(path, shaker_test())
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    for _ in range(80):
        content = bytearray(whole)
        for at in rng.integers(len(whole) - 50, size=rng.integers(1, 6)).tolist():
            if rng.random() < 0.5:
                content[at] = rng.integers(256)
            else:
                del content[at : at + int(rng.integers(1, 40))]
        path.write_bytes(content)
        try:
            rf.check(rf.read(path))
        except ValueError as error:
            refusal = str(error)
            assert refusal.startswith("t.uff"), refusal
            assert len(refusal.split()) > 4


def test_a_file_that_is_no_netcdf_says_so_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "t.nc").write_bytes(b"junk")
    words = [sys.executable, "-m", "rotorfit", "info", str(tmp_path / "t.nc")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("rotorfit: t.nc is not a readable netCDF file")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("suffix", [".csv", ".uff", ".nc", ".mat"])
def test_missing_files_and_folders(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(FileNotFoundError):
        rf.read(tmp_path / f"absent{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with refuses(OSError):
        rf.read(tmp_path / f"folder{suffix}")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "t.uff"
    rf.write(rf.datasets.two_disk(), path)
    before = path.read_bytes()
    sound = rf.datasets.two_disk().select(np.arange(4))
    assert isinstance(sound, PerturbationTest)
    broken = replace(sound, response=np.where(np.arange(4) == 1, np.nan, sound.response))
    with refuses(ValueError):
        rf.write(broken, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["t.uff"]


def test_mat_of_version_73_is_named(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "t.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["speed"] = 1.0
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(header + path.read_bytes()[len(header) :])
    with refuses(ValueError):
        rf.read(path)


def test_netcdf_files_are_written_beside_a_dask_client(tmp_path):
    """xarray then locks by the cluster, which takes files only; posteriors are drawn on workers."""
    distributed = pytest.importorskip("distributed")
    table, _ = seal_campaign(1)
    here = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    options = {"processes": False, "protocol": "tcp", "threads_per_worker": 1, "scheduler_kwargs": here}
    with distributed.LocalCluster(1, **options) as workers, distributed.Client(workers):
        rf.write(table, tmp_path / "a.nc")
    assert len(rf.read(tmp_path / "a.nc")) == len(table)
