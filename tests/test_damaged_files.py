"""Files that are damaged, or ask for more than they hold, end in one sentence, in time and without memory."""

from __future__ import annotations

import json
import sys
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

import rotorfit as rf
from rotorfit.estimators import file_limits
from rotorfit.estimators.file_limits import check_hdf5
from rotorfit.estimators.file_reading import reading
from rotorfit.recordings.formats.files import open_raw
from rotorfit.recordings.rig.rig_toml import read_setup

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.fixture
def _benchmarks_on_the_path() -> Iterator[None]:
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


@pytest.mark.usefixtures("_benchmarks_on_the_path")
def test_mutations_of_every_format_end_in_a_sentence() -> None:
    """The short form of ``benchmarks/mutated_files.py``, with another seed."""
    from mutated_files import FORMATS, HARMLESS, study

    counts, lines = study(list(FORMATS), 5, seed=1)
    assert lines == []
    assert all(sum(found[ending] for ending in HARMLESS) == 5 for found in counts.values())


# ---- the boundary ------------------------------------------------------------------------------


def test_whatever_a_package_raises_becomes_one_line_with_its_cause() -> None:
    with pytest.raises(ValueError, match=r"^a\.wav is not a readable WAV file .*: first second$") as caught:
        raise_in_reading(OSError("first\n second"))
    assert isinstance(caught.value.__cause__, OSError)
    with pytest.raises(ValueError, match=r"^a\.wav is not a readable WAV file [^:]*$"):
        raise_in_reading(IndexError("list index out of range"))
    with pytest.raises(ValueError, match=r"^a\.wav: line 3 is odd$"):
        raise_in_reading(ValueError("a.wav: line 3 is odd"))


def test_a_stop_passes_and_a_lack_of_memory_is_a_sentence() -> None:
    """A damaged file may declare any size; a traceback says nothing of it."""
    with pytest.raises(KeyboardInterrupt), reading("a.wav", "WAV file"):
        raise KeyboardInterrupt
    with pytest.raises(ValueError, match=r"a\.wav takes more memory than there is"), reading("a.wav", "WAV file"):
        raise MemoryError


def raise_in_reading(problem: BaseException) -> None:
    with reading("a.wav", "WAV file"):
        raise problem


def test_sampling_rates_that_are_none_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = np.zeros(100)
        file.attrs["fs"] = 1e200
    with pytest.raises(ValueError, match=r"a\.h5: x has a sampling rate of 1e\+200 Hz"):
        open_raw(tmp_path / "a.h5")


# ---- seals ---------------------------------------------------------------------------------


def test_one_bit_in_a_netcdf_file_of_ours_is_found(tmp_path: Path) -> None:
    path = tmp_path / "rig.nc"
    rf.write(rf.datasets.rig_open(), path)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    with pytest.raises(ValueError, match=r"rig\.nc is damaged"):
        rf.read(path)


def test_a_file_over_which_the_library_loops_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By processor time, which the process that opens it first may spend whoever ended the one that waits for it."""
    endless = file_limits._OPEN.replace("with h5py", "while True:\n    pass\nwith h5py")
    monkeypatch.setattr(file_limits, "_OPEN", endless)
    with pytest.raises(ValueError, match=r"^a\.nc is not a readable HDF5 file"):
        file_limits.refuse_deadly(tmp_path / "a.nc")


def test_a_netcdf_file_that_others_changed_is_read(tmp_path: Path) -> None:
    path = tmp_path / "rig.nc"
    rf.write(rf.datasets.rig_open(), path)
    with h5py.File(path, "r+") as file:
        file["response_real"][3] *= 2.0
    assert len(rf.read(path)) == len(rf.datasets.rig_open())


# ---- declared sizes ----------------------------------------------------------------------------


def archive_bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xl/workbook.xml", "w") as part:
        for _ in range(80):
            part.write(bytes(1 << 20))


def sparse_sheet(path: Path) -> None:
    from openpyxl import Workbook

    book = Workbook()
    book.active["A1"] = "run"
    book.active["XFD1048576"] = 1.0
    book.save(path)
    book.close()


def packed_matrix(path: Path) -> None:
    """A MAT file with a compressed variable of 90 MB of zeros."""
    body = b"\x0e\0\0\0" + (90 << 20).to_bytes(4, "little") + bytes(90 << 20)
    packed = zlib.compress(body, 9)
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(header + b"\x0f\0\0\0" + len(packed).to_bytes(4, "little") + packed)


def huge_cell_array(path: Path) -> None:
    """A MAT file whose cell array declares 1e9 cells and holds none."""
    inside = bytes.fromhex("0600000008000000 0100000000000000 0500000008000000") + np.array([10**9, 1], "<i4").tobytes()
    inside += bytes.fromhex("0100010061000000")
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(header + b"\x0e\0\0\0" + len(inside).to_bytes(4, "little") + inside)


def huge_dataset(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(3_000_000, 3_000_000), dtype="f8", chunks=(1000, 1000))


def external_storage(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(100,), dtype="i2", external=[("/etc/passwd", 0, 200)])


def external_link(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["x"] = h5py.ExternalLink("other.h5", "/x")
        file["y"] = np.zeros(100)


def virtual_dataset(path: Path) -> None:
    layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=(100,))
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("x", layout)


def long_note(path: Path) -> None:
    rows = [f"a,1000,{i},journal,2.5,30,journal,x,12,-40," for i in range(1, 2001)]
    header = (
        "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg,note"
    )
    path.write_text("\n".join([header, rows[0] + "x" * 20_000, *rows[1:]]), encoding="utf-8")


def dotted_key(path: Path) -> None:
    path.write_text(".".join(["a"] * 100_000) + " = 1\n", encoding="utf-8")


def deep_array(path: Path) -> None:
    path.write_text("a = " + "[" * 100_000, encoding="utf-8")


def deep_fit(path: Path) -> None:
    path.write_text("[" * 100_000, encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "write", "read"),
    [
        ("a.xlsx", archive_bomb, rf.read),
        ("b.xlsx", sparse_sheet, rf.read),
        ("a.mat", packed_matrix, open_raw),
        ("b.mat", packed_matrix, rf.read),
        ("c.mat", huge_cell_array, open_raw),
        ("a.h5", huge_dataset, open_raw),
        ("b.h5", external_storage, open_raw),
        ("c.h5", external_link, open_raw),
        ("d.h5", virtual_dataset, open_raw),
        ("a.nc", huge_dataset, rf.read),
        ("a.csv", long_note, rf.read),
        ("a.toml", dotted_key, read_setup),
        ("b.toml", deep_array, read_setup),
        ("a.json", deep_fit, rf.load_fit),
    ],
)
def test_declared_sizes_are_checked_first(
    tmp_path: Path, name: str, write: Callable[[Path], None], read: Callable[[Path], object]
) -> None:
    write(tmp_path / name)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=name.replace(".", r"\.")) as caught:
            read(tmp_path / name)
        assert "\n" not in str(caught.value)
        assert tracemalloc.get_traced_memory()[1] < 2e8
    finally:
        tracemalloc.stop()


def test_limits_are_raised_by_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", shape=(20_000_000,), dtype="f8", chunks=(1000,))
    with pytest.raises(ValueError, match="ROTORFIT_FILE_LIMITS"):
        check_hdf5(tmp_path / "a.h5")
    monkeypatch.setenv("ROTORFIT_FILE_LIMITS", "10")
    check_hdf5(tmp_path / "a.h5")
    monkeypatch.setenv("ROTORFIT_FILE_LIMITS", "none")
    with pytest.raises(ValueError, match="is a positive factor, not 'none'"):
        check_hdf5(tmp_path / "a.h5")


def test_a_long_name_is_refused_at_once(tmp_path: Path) -> None:
    """The nearest of the allowed names is not looked for with all of a very long one."""
    path = tmp_path / "fit.json"
    path.write_text(json.dumps({"format": "rotorfit fit", "schema": 1, "x" * 100_000: 1}), encoding="utf-8")
    with pytest.raises(ValueError, match="incomplete"):
        rf.load_fit(path)
    with pytest.raises(KeyError, match="unknown parameter") as caught:
        rf.fit(rf.models.TwoDisk(), rf.datasets.two_disk(), known={"K" * 100_000: 1.0})
    assert len(str(caught.value)) < 1000
