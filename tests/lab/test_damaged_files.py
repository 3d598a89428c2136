"""Files that are damaged, or ask for more than they hold, end in one sentence, in time and without memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.base import file_reading
from rotorfit.base.file_reading import check_hdf5, check_mat, reading
from rotorfit.lab.recordings.formats.files import open_raw

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def _benchmarks_on_the_path() -> Iterator[None]:
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.usefixtures("_benchmarks_on_the_path")
def test_mutations_of_every_format_end_in_a_sentence() -> None:
    """The short form of ``benchmarks/mutated_files.py``, with another seed."""
    from mutated_files import FORMATS, HARMLESS, study

    counts, lines = study(list(FORMATS), 1, seed=1)
    assert lines == []
    assert all(sum(found[ending] for ending in HARMLESS) == 1 for found in counts.values())


# ---- the boundary ------------------------------------------------------------------------------


def test_whatever_a_package_raises_becomes_one_line_with_its_cause() -> None:
    with refuses(ValueError) as caught:
        raise_in_reading(OSError("first\n second"))
    assert isinstance(caught.value.__cause__, OSError)
    with refuses(ValueError):
        raise_in_reading(IndexError("list index out of range"))
    with refuses(ValueError):
        raise_in_reading(ValueError("a.wav: line 3 is odd"))


def test_a_stop_passes_and_a_lack_of_memory_is_a_sentence() -> None:
    """A damaged file may declare any size; a traceback says nothing of it."""
    with pytest.raises(KeyboardInterrupt), reading("a.wav", "WAV file"):
        raise KeyboardInterrupt
    with refuses(ValueError), reading("a.wav", "WAV file"):
        raise MemoryError


def raise_in_reading(problem: BaseException) -> None:
    with reading("a.wav", "WAV file"):
        raise problem


def test_sampling_rates_that_are_none_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.zeros(100)
        file.attrs["fs"] = 1e200
    with refuses(ValueError):
        open_raw(tmp_path / "a.h5")


# ---- seals ---------------------------------------------------------------------------------


def test_one_bit_in_a_netcdf_file_of_ours_is_found(tmp_path: Path) -> None:
    path = tmp_path / "rig.nc"
    rf.write(rf.datasets.rig_open(), path)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    with refuses(ValueError):
        rf.read(path)


def test_a_file_over_which_the_library_loops_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By processor time, which the process that opens it first may spend whoever ended the one that waits for it."""
    endless = file_reading._OPEN.replace("with h5py", "while True:\n    pass\nwith h5py")
    monkeypatch.setattr(file_reading, "_OPEN", endless)
    with refuses(ValueError):
        file_reading.refuse_deadly(tmp_path / "a.nc")


def test_a_netcdf_file_that_others_changed_is_read(tmp_path: Path) -> None:
    path = tmp_path / "rig.nc"
    rf.write(rf.datasets.rig_open(), path)
    with h5py.File(path, "r+") as file:
        file["response_real"][3] *= 2.0
    assert len(rf.read(path)) == len(rf.datasets.rig_open())


# ---- declared sizes ----------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited in processes that Linux makes")
def test_bombs_are_refused_and_kills_lose_nothing(tmp_path: Path) -> None:
    """The short form of ``benchmarks/kills_and_bombs.py``, with another seed: in a process that makes others."""
    script = [sys.executable, str(BENCHMARKS / "kills_and_bombs.py"), "--out", str(tmp_path / "table.md")]
    words = ["--kills", "1", "--bombs", "1", "--seed", "1", "--commands", "join, CSV", "store"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run([*script, *words], env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_limits_are_raised_by_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", shape=(20_000_000,), dtype="f8", chunks=(1000,))
    with refuses(ValueError):
        check_hdf5(tmp_path / "a.h5")
    monkeypatch.setenv("ROTORFIT_FILE_LIMITS", "10")
    check_hdf5(tmp_path / "a.h5")
    monkeypatch.setenv("ROTORFIT_FILE_LIMITS", "none")
    with refuses(ValueError):
        check_hdf5(tmp_path / "a.h5")


def test_a_long_name_is_refused_at_once(tmp_path: Path) -> None:
    """The nearest of the allowed names is not looked for with all of a very long one."""
    path = tmp_path / "fit.json"
    path.write_text(json.dumps({"format": "rotorfit fit", "schema": 1, "x" * 100_000: 1}), encoding="utf-8")
    with refuses(ValueError):
        rf.load_fit(path)
    with refuses(KeyError) as caught:
        plain_fit(rf.models.TwoDisk(), rf.datasets.two_disk(), known={"K" * 100_000: 1.0})
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("kind", [5, 6])
def test_dimensions_of_mat_files_are_checked_whatever_their_type(tmp_path: Path, kind: int) -> None:
    """SciPy takes dimensions as integers with and without a sign, and crashes over a text that has none."""
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    flags, name = bytes.fromhex("0600000008000000 0100000000000000"), bytes.fromhex("0100010061000000")
    for shape, words in (((100_000_000, 1), "declares content of 1.6e"), ((1,), "fewer than two dimensions")):
        sizes = np.array(shape, "<i4").tobytes()
        tag = np.array([kind, len(sizes)], "<i4").tobytes()
        content = flags + tag + sizes.ljust(8, b"\0") + name
        path = tmp_path / "a.mat"
        path.write_bytes(head + np.array([14, len(content)], "<i4").tobytes() + content)
        with pytest.raises(ValueError, match=words):
            check_mat(path)


@pytest.mark.parametrize(("column", "cell"), [(1, "1e308"), (4, "1e200"), (8, "1e299")])
def test_numbers_that_have_no_squares_are_refused(tmp_path: Path, column: int, cell: str) -> None:
    """A fit of them did not come to an end."""
    lines = rf.datasets.path("rig_lumped.csv").read_text(encoding="utf-8").splitlines()
    cells = lines[100].split(",")
    cells[column] = cell
    (tmp_path / "a.csv").write_text("\n".join([*lines[:100], ",".join(cells), *lines[101:]]), encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"a\.csv: reading \d+: \w+ is -?[\d.e+]+ .*(numbers may be up to|up to 1e\+10 are allowed)"
    ):
        rf.read(tmp_path / "a.csv")


@pytest.mark.parametrize(("suffix", "read"), [(".h5", rf.read_recording), (".nc", rf.read)])
def test_names_in_hdf5_that_are_no_text_are_refused(
    suffix: str, read: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / f"named{suffix}"
    with h5py.File(path, "w") as file:
        file.attrs["sample_rate_hz"] = 1000.0
        file.create_group("signals")
        file[b"signals/K\xf6rper_X"] = np.zeros(5000)
    with pytest.raises(ValueError, match=rf"named{suffix}: the name b'signals/K.xf6rper_X' in it is no text in UTF-8"):
        read(path)
