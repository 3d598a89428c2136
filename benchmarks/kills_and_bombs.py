"""Is anything lost where a command is killed, and does a small file that declares much end in a sentence?

    python benchmarks/kills_and_bombs.py --kills 40 --bombs 5 --seed 23

A command that replaces what is there is killed before its n-th change of the folder (a file opened for writing, a
rename, a removal, a transaction), n drawn at random. What it replaces must then be there as it was (*old*) or whole and
*new*, a folder of results under the name ``.previous`` if the kill came between its two renames (*aside*); inputs and
notes that are no result must be there too, and the same command, given again, must end as if nothing had happened. A
bomb is a file of some kilobytes whose content is multiplied by a factor from 1 to 3, drawn at random; it must be
refused in a line with its name, in 10 s of processor time and 1 GB. The exit code is 1 if anything is lost, hangs, or
is not refused so.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import sys
import tempfile
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from reporting import RESULTS, environment, table

import rotorfit as rf
from rotorfit.apps.cli.main import main as command

MEMORY = 1 << 30
"""Bytes that reading a bomb may take."""
SECONDS = 10
"""Processor time for it."""

DONE = {0, 1}
"""Exit codes of a command that wrote its results, converged or not."""

# ---- kills -------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Work:
    """A command that replaces what another has written."""

    first: str  # its words, which write what is replaced; {} is the value that differs
    values: tuple[str, str]
    outputs: tuple[str, ...]  # files by which the old state and the new are told
    folder: str = ""  # of results, which is switched as a whole


_FIT = "fit rig.csv --model whirl-whip --known K3={} --no-figures --quiet --out out"
_JOIN = "join rig.csv --where speed_rpm={} --quiet --out a"
_VIRTUAL = """model = "one-mode"
params = {M = 1.2, K = 8e3, Ds = 8, K0 = 9e3, D = 450, lam = 0.46, Mf = 0.4}
test = {kind = "balance", speed_rpm = 600, duration = 1}
"""
WORK = {
    "fit": Work(
        first=_FIT, values=("6000", "6500"), outputs=("out/fit.json", "out/curves.csv", "out/parameters.csv"),
        folder="out",
    ),
    "campaign": Work(
        first="campaign study-{}.toml rig.csv --quiet --out out --store kept.db",
        values=("6000", "6500"), outputs=("out/runs.csv",), folder="out",
    ),
    "posterior": Work(
        first=f"{_FIT} --sample --max-steps 60 --ess 10 --seed 1", values=("6000", "6500"),
        outputs=("out/posterior.nc",), folder="out",
    ),
    "predict": Work(
        first="predict fit.json --speed {} --force-plane disk --plane disk --quiet --out out", values=("1000", "1200"),
        outputs=("out/prediction.csv",), folder="out",
    ),
    **{
        f"join, {kind}": Work(first=f"{_JOIN}{suffix}", values=("1000", "2000"), outputs=(f"a{suffix}",))
        for kind, suffix in (("CSV", ".csv"), ("netCDF", ".nc"), ("MAT", ".mat"), ("UFF", ".uff"))
    },
    "recordings": Work(
        first="simulate virtual-{}.toml --quiet --recordings volts", values=("1", "2"),
        outputs=("volts/reference-600.h5",), folder="volts",
    ),
    "balance": Work(
        first="balance balance.csv --holes {} --quiet --out out", values=("8", "12"),
        outputs=("out/weights.csv", "out/summary.txt"), folder="out",
    ),
    "store": Work(first="store add machine.db {} --quiet", values=("rig.csv", "open.csv"), outputs=("machine.db",)),
}  # fmt: skip
_CHANGES = ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.chmod", "os.truncate")


def run(words: str, folder: Path, kill_before: int = 0) -> tuple[int, int]:
    """Carry a command out in a process of its own: its exit code, negative if killed, and the changes that it made."""
    pipe = os.pipe()
    child = os.fork()
    if not child:
        code = 70
        try:
            os.chdir(folder)
            made = _killing(folder, kill_before)
            for stream in (1, 2):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
            code = command(words.split())
            os.write(pipe[1], len(made).to_bytes(4, "little"))
        finally:
            os._exit(code)
    os.close(pipe[1])
    with os.fdopen(pipe[0], "rb") as said:
        count = int.from_bytes(said.read(), "little")
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), count


def _killing(folder: Path, kill_before: int) -> list[str]:
    """End this process before its n-th change of the folder; the list of changes grows."""
    made: list[str] = []
    inside = f"{folder}{os.sep}"

    def changes(event: str, words: tuple[Any, ...]) -> bool:
        if event == "sqlite3.connect":
            return True
        written = event == "open" and isinstance(words[2], int) and words[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if not (written or event in _CHANGES) or not isinstance(words[0], (str, os.PathLike)):
            return False
        return os.path.abspath(os.fspath(words[0])).startswith(inside)

    def hook(event: str, words: tuple[Any, ...]) -> None:
        if changes(event, words):
            made.append(event)
            if len(made) == kill_before:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    return made


def state(folder: Path, work: Work) -> tuple[Any, ...]:
    """What a folder holds of the outputs."""
    return tuple(_content(folder / name) for name in work.outputs)


def _content(path: Path) -> Any:
    """Content of a file, of which dates are no part; None where there is none."""
    if not path.exists():
        return None
    if path.suffix == ".db":
        store = rf.Store(path)
        return (*store.problems(), *sorted(test.content for test in store.tests))
    if path.suffix in (".h5", ".nc"):
        found: dict[str, str] = {}

        def note(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = repr(np.asarray(item[()]).tolist())  # NaN is no equal of NaN

        with h5py.File(path) as file:
            file.visititems(note)
        return found
    if path.suffix == ".mat":
        return path.read_bytes()[128:]  # behind the header with its date
    return path.read_bytes()


def kills(name: str, count: int, rng: np.random.Generator, base: Path) -> Counter[str]:
    """Kill a command again and again: how often the old state was left, the new one, or something else."""
    work, folder, start = WORK[name], base / "work", base / "start"
    for path in (folder, start):
        shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(base / "inputs", start)
    old_words, new_words = (work.first.format(value) for value in work.values)
    found: Counter[str] = Counter()
    if run(old_words, start)[0] not in DONE:
        raise RuntimeError(f"{name}: the command does not work")
    if work.folder:
        (start / work.folder / "notes").write_text("mine")
    inputs = {path.name: path.read_bytes() for path in (base / "inputs").iterdir()}
    old = state(start, work)
    shutil.copytree(start, folder)
    code, found["changes"] = run(new_words, folder)
    new = state(folder, work)
    if code not in DONE or new == old:
        raise RuntimeError(f"{name}: the command does not replace what is there")
    for _ in range(count):
        shutil.rmtree(folder)
        shutil.copytree(start, folder)
        code, _ = run(new_words, folder, int(rng.integers(1, found["changes"] + 1)))
        left = state(folder, work)
        aside = state(folder, replace(work, outputs=tuple(name.replace("/", ".previous/") for name in work.outputs)))
        gone = work.folder and not (folder / work.folder).exists()
        found["old" if left == old else "new" if left == new else "aside" if gone and aside == old else "lost"] += 1
        notes = [path for path in folder.rglob("notes") if path.read_text() == "mine"]
        same = all((folder / path).read_bytes() == content for path, content in inputs.items())
        found["lost"] += not same or len(notes) != bool(work.folder)
        ended = {run(new_words, folder)[0] for _ in range(2)} <= DONE
        kept = not work.folder or (folder / work.folder / "notes").exists()
        found["not repeated"] += not (ended and state(folder, work) == new and kept)
    return found


# ---- bombs -------------------------------------------------------------------------------------


def _archive(path: Path, factor: float) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xl/workbook.xml", "w") as part:
        for _ in range(int(80 * factor)):
            part.write(bytes(1 << 20))


def _sparse_sheet(path: Path, factor: float) -> None:
    from openpyxl import Workbook

    book = Workbook()
    book.active["A1"] = "run"
    book.active.cell(int(1048576 * factor / 3), 16384).value = 1.0
    book.save(path)
    book.close()


def _mat(path: Path, kind: int, content: bytes) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + kind.to_bytes(4, "little") + len(content).to_bytes(4, "little") + content)


def _packed_matrix(path: Path, factor: float) -> None:
    size = int(90 * factor) << 20
    _mat(path, 15, zlib.compress(b"\x0e\0\0\0" + size.to_bytes(4, "little") + bytes(size), 9))


def _cell_array(path: Path, factor: float) -> None:
    inside = bytes.fromhex("0600000008000000 0100000000000000 0500000008000000")
    _mat(path, 14, inside + np.array([6e8 * factor, 1], "<i4").tobytes() + bytes.fromhex("0100010061000000"))


def _sparse_matrix(path: Path, factor: float) -> None:
    from scipy import io, sparse

    size = int(20_000 * factor)
    io.savemat(path, {name: sparse.coo_matrix(([1.0], ([0], [0])), shape=(size, size)) for name in "MK"})


def _zeros(path: Path, factor: float) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as part:
        np.lib.format.write_array_header_1_0(
            part, {"descr": "<f8", "fortran_order": False, "shape": (int(1e7 * factor),)}
        )
        for _ in range(int(80 * factor)):
            part.write(bytes(1_000_000))


def _dataset(path: Path, factor: float) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(int(1e6 * factor),) * 2, dtype="f8", chunks=(1000, 1000))


def _external(path: Path, factor: float) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(int(100 * factor),), dtype="i2", external=[("/etc/passwd", 0, 1000)])


def _virtual(path: Path, factor: float) -> None:
    layout = h5py.VirtualLayout(shape=(int(100 * factor),), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=layout.shape)
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("x", layout)


def _parquet(path: Path, factor: float) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({"x": np.zeros(int(1e7 * factor))}), path, compression="zstd")


def _long_note(path: Path, factor: float) -> None:
    names = (
        "run speed_rpm frequency_rpm force_plane force_N force_phase_deg plane direction amplitude_um phase_deg note"
    )
    rows = [f"a,1000,{i},journal,2.5,30,journal,x,12,-40," for i in range(1, 2001)]
    rows[0] += "x" * int(15_000 * factor)
    path.write_text("\n".join([names, *rows]), encoding="utf-8")


def _text(of: Callable[[int], str]) -> Callable[[Path, float], None]:
    def write(path: Path, factor: float) -> None:
        path.write_text(of(int(1e5 * factor)), encoding="utf-8")

    return write


def _sparse_structure(path: Path, factor: float) -> None:
    _sparse_matrix(path.with_suffix(".mat"), factor)
    text = f'structure = "{path.stem}.mat"\nplanes = {{a = 0}}\nparams = {{}}\ntest = {{speed_rpm = 100}}\n'
    path.write_text(text, encoding="utf-8")


BOMBS: dict[str, tuple[str, Callable[[Path, float], None]]] = {
    "workbook, packed": ("info {}.xlsx", _archive),
    "workbook, last cell": ("info {}.xlsx", _sparse_sheet),
    "MAT, packed": ("info {}.mat", _packed_matrix),
    "MAT, cells": ("template {}.mat", _cell_array),
    "MAT, sparse": ("simulate {}.toml --out out.csv", _sparse_structure),
    "npz": ("template {}.npz", _zeros),
    "Parquet": ("template {}.parquet", _parquet),
    "HDF5": ("template {}.h5", _dataset),
    "HDF5, external": ("template {}.h5", _external),
    "HDF5, virtual": ("template {}.h5", _virtual),
    "netCDF": ("info {}.nc", _dataset),
    "CSV, cell": ("info {}.csv", _long_note),
    "TOML, dots": ("run {}.toml", _text(lambda count: ".".join("a" * count) + " = 1")),
    "TOML, depth": ("run {}.toml", _text(lambda count: "a = " + "[" * count)),
    "JSON, depth": ("judge {}.json", _text(lambda count: "[" * count)),
    "JSON, name": ("judge {}.json", _text(lambda count: '{"format": "rotorfit fit", "' + "x" * count + '": 1}')),
}
"""Words of the command that reads a bomb, and what writes it."""


def bomb(name: str, factor: float, folder: Path) -> tuple[str, int, float, float]:
    """What becomes of a bomb, its bytes, and the processor time and the bytes that it takes."""
    words, write = BOMBS[name]
    path = folder / f"bomb{words[words.index('}') + 1 :].split()[0]}"
    maker = os.fork()  # so that what making it takes is not this process's
    if not maker:
        write(path, factor)
        os._exit(0)
    os.waitpid(maker, 0)
    pipe = os.pipe()
    child = os.fork()
    if not child:
        code = 70
        try:
            os.close(pipe[0])
            os.dup2(pipe[1], 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
            space = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MEMORY
            resource.setrlimit(resource.RLIMIT_AS, (space, space))
            code = command(words.format(path.with_suffix("")).split())
        finally:
            os._exit(code)
    os.close(pipe[1])
    with os.fdopen(pipe[0], "rb") as stream:
        said = stream.read().decode(errors="replace")
    _, status, used = os.wait4(child, 0)
    code, size = os.waitstatus_to_exitcode(status), path.stat().st_size
    path.unlink()
    one_line = said.count("\n") == 1 and path.name in said and said.startswith("rotorfit: ")
    ending = "hang" if code == -signal.SIGXCPU else "refused" if code == 2 and one_line else f"{code}: {said[-300:]}"
    return ending, size, used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss


# ---- the table ---------------------------------------------------------------------------------


def study(killed: int, bombs: int, seed: int, names: list[str]) -> tuple[list[str], bool]:
    """Lines of both tables, and whether all is well."""
    rows, well = [], True
    with tempfile.TemporaryDirectory() as made:
        base = Path(os.path.realpath(made))
        inputs = base / "inputs"
        inputs.mkdir()
        shutil.copyfile(rf.datasets.path("rig_lumped.csv"), inputs / "rig.csv")
        shutil.copyfile(rf.datasets.path("rig_open.csv"), inputs / "open.csv")
        shutil.copyfile(rf.datasets.path("field_balance.csv"), inputs / "balance.csv")
        for K3 in WORK["campaign"].values:
            (inputs / f"study-{K3}.toml").write_text(f'model = "whirl-whip"\nknown = {{K3 = {K3}}}\n')
        for number in WORK["recordings"].values:
            (inputs / f"virtual-{number}.toml").write_text(f"seed = {number}\n{_VIRTUAL}")
        rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0}).save(inputs / "fit.json")
        kinds = ("changes", "old", "new", "aside", "lost", "not repeated")
        for number, name in enumerate(WORK):
            if name in names or not names:
                found = kills(name, killed, np.random.default_rng((seed, 0, number)), base)
                well &= not found["lost"] + found["not repeated"]
                rows.append([name, str(killed), *(str(found[kind] or "") for kind in kinds)])
                print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
        lines = [*table(["command", "kills", *kinds], rows), ""]
        rows = []
        idle = 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for number, name in enumerate(BOMBS):
            rng = np.random.default_rng((seed, 1, number))
            found_ = [bomb(name, factor, base) for factor in rng.uniform(1.0, 3.0, bombs)]
            endings, sizes, times, rooms = zip(*found_, strict=True)
            room = max(0.0, max(rooms) - idle)
            well &= set(endings) == {"refused"} and room < MEMORY
            said = "; ".join(sorted(set(endings)))
            rows.append([name, str(bombs), said, f"{max(sizes) / 1e3:.3g}", f"{max(times):.2f}", f"{room / 1e6:.0f}"])
        lines += table(["bomb", "drawn", "outcome", "largest, kB", "longest, s", "most memory, MB"], rows)
    return lines, well


def main() -> None:
    """Make the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=40, help="of each command")
    parser.add_argument("--bombs", type=int, default=5, help="of each kind")
    parser.add_argument("--commands", nargs="*", default=[], help="that are killed, all if left out")
    parser.add_argument("--seed", type=int, default=23)
    parser.add_argument("--out", type=Path, default=RESULTS / "kills_and_bombs.md")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    lines, well = study(given.kills, given.bombs, given.seed, given.commands)
    words = f"benchmarks/kills_and_bombs.py --kills {given.kills} --bombs {given.bombs} --seed {given.seed}"
    title = f"`{words}`: {environment('numpy', 'scipy', 'h5py', 'openpyxl', 'pyarrow')}."
    text = "\n".join(["# Kills and bombs", "", title, "", *lines, ""])
    given.out.write_text(text, encoding="utf-8")
    print(text)
    raise SystemExit(not well)


if __name__ == "__main__":
    main()
