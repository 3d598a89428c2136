"""Which damaged or altered files end in a sentence, whatever command reads them?

    python benchmarks/mutated_commands.py --mutations 100 --seed 42

Half of the files are damaged as by ``mutated_files.py``; the others are altered by somebody who knows the format:
cells, lines and columns of tables, nodes of JSON, attributes and data of HDF5, rows of a store, whose checksums are put
anew. Each file is given to one of the commands that read it, in a process with a limit of processor time. The command
*did* its work, *refused* (every line on stderr is a sentence of rotorfit), is *unclear* (a line of a package, NumPy's
warnings, remains of Python), or ended in a *traceback*, a *hang* or a *crash*.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import resource
import shutil
import sqlite3
import sys
import tempfile
from collections import Counter
from contextlib import closing, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import mutated_files
import numpy as np
from mutated_files import FORMATS, RIG, Format, Reader, mutated
from reporting import environment, table

import rotorfit as rf
from rotorfit.apps.cli.main import main as command
from rotorfit.apps.store.database import SEALED, put_seal
from rotorfit.base.file_reading import seal

MEMORY = 3 << 30
"""Address space of the process, bytes: the packages of all commands together take most of it."""
SECONDS = 60.0
"""Processor time of one command, which may fit what it has read."""
OUTCOMES = ("did", "refused", "unclear", "traceback", "hang", "crash")

_REMAINS = re.compile(
    r"Traceback|<class|object at 0x|NoneType|list index|encountered in|Error:|invalid value|has no attribute"
    r"|not subscript|positional argument|unexpected keyword|could not be broadcast|must be (?:str|real number)"
    r"|Singular matrix|converge$"
)
_MODEL = "--model whirl-whip --known K3=6000"
_TABLES = (
    "info {}",
    "fit {} --model modal --json",
    f"fit {{}} {_MODEL} --no-figures --out out",
    f"fit {{}} {_MODEL} --json",
    "fit {} --model modal --no-figures",
    "campaign any.toml {} --json",
    "store add tests.db {} --study study.toml",
    "join {} whole.csv --out joined.csv",
    "join {} --out joined.nc",
    "balance {}",
    "trend {}",
    f"fit {{}} {_MODEL} --clearance-um 200 --laws all --json",
    "run study.toml --json",
    "watch inbox --study any.toml --store watched.db --once --settle 0",
    f"fit {{}} {_MODEL} --bootstrap 4 --json",
    f"fit whole.csv {{}} {_MODEL} --json",
    f"fit whole.csv {_MODEL} --baseline {{}} --json",
)
_RECORDINGS = (
    "look {}",
    "look {} --setup rig.toml",
    "vectors {} --setup rig.toml --out vectors.csv",
    "template {}",
    "info {}",
    "fit {} --setup rig.toml --model modal --no-figures",
    "fit {} --setup rig.toml --model modal --out out",
    "store add tests.db {} --setup rig.toml --study study.toml",
    "vectors {} --out vectors.csv",
    "join {} --setup rig.toml --out joined.csv",
    "look {} --setup rig.toml --out drawn",
    "watch inbox --study any.toml --store watched.db --setup rig.toml --once --settle 0",
    "info {} --setup rig.toml",
)
COMMANDS = {
    "tables": _TABLES,
    "recordings": _RECORDINGS,
    "weights": ("balance {}", "balance {} --json --out out", "info {}", "join {} --out joined.csv", "trend {}"),
    "fits": (
        "judge {} --json",
        "judge {} --unbalance disk=10",
        "predict {} --speed 1000 --synchronous --force-plane disk",
        "trend {} {} {}",
        "predict {} --speed 1000 --frequency 500:1000:3 --json --force-plane disk",
    ),
    "studies": (
        "run {} --json",
        "campaign {} whole.csv --json",
        "store add tests.db whole.csv --study {}",
        "store refit tests.db --study {}",
        "watch inbox --study {} --store watched.db --once --settle 0",
    ),
    "setups": (
        "look whole.npz --setup {}",
        "vectors whole.npz --setup {} --out vectors.csv",
        "info whole.npz --setup {}",
        "store add tests.db whole.npz --setup {}",
    ),
    "plans": ("plan {}", "plan {} --json"),
    "virtual tests": ("simulate {} --out simulated.csv", "simulate {} --recordings simulated"),
    "shafts": ("fit whole.csv --structure {} --planes disk=0,journal=1 --fluid journal --json",),
    "stores": (
        "store list {}",
        "store trend {}",
        "store check {}",
        "store get {} 1 --out out",
        "store list {} --json",
        "store refit {} --study study.toml",
        "store add {} whole.csv --study study.toml",
        "store trend {} --follow lam",
        "watch inbox --study any.toml --store {} --once --settle 0",
    ),
    "posteriors": ("posterior {}",),
}
"""Commands by what they read. No command reads posteriors: ``rf.load_posterior`` does."""
_KINDS = {
    "rig.toml": "setups",
    "study": "studies",
    "plan": "plans",
    "virtual test": "virtual tests",
    "shaft": "shafts",
    "store": "stores",
    "posterior": "posteriors",
    "fit.json": "fits",
    **dict.fromkeys(("CSV", "Excel", "UFF, vectors", "netCDF", "netCDF of others", "MAT, vectors"), "tables"),
    **dict.fromkeys(("UFF, foreign", "JSON", "dynamic stiffness"), "tables"),
}


def _weights(path: Path) -> None:
    shutil.copyfile(rf.datasets.path("field_balance.csv"), path)


def _overhung(path: Path) -> None:
    rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0}).save(path)


FILES: dict[str, tuple[str, Format]] = {
    **{name: (_KINDS.get(name, "recordings"), one) for name, one in FORMATS.items() if name != "checkpoint"},
    "weights": ("weights", Format(suffix=".csv", write=_weights, read=rf.read)),
    "fit.json, two planes": ("fits", Format(suffix=".json", write=_overhung, read=rf.load_fit)),
}
"""Files, what reads them, and how they are written."""

# ---- alterations ---------------------------------------------------------------------------------------------------


_VALUES = (
    None, True, "x", "", "nan", -1, 0, 1, 7.5, 1e300, -1e300, 1e-300, 1 << 70, [], {}, [None], {"array": "float64"},
    "1e3", ["x", "y"], "free", [[1.0, 2.0]], {"float": "nan"}, {"float": "inf"}, "\u202e<b>",
)  # fmt: skip
_CELLS = (
    "", "0", "-0", "1e30", "1e-30", "1e300", "1e-300", "-1", "nan", "inf", "x", "#N/A", "1,5", "2026-03-01", "9" * 40,
    "z", "y", "journal", "1e15", "0.0000001", "TRUE", "1+2j", "-1e30", "\u00b5", "'", "=1+1", "12:30", "1e160",
)  # fmt: skip


def altered(path: Path, rng: np.random.Generator) -> None:
    """Change a file as somebody does who knows its format."""
    change = {".json": _json, ".db": _store, ".nc": _hdf5, ".h5": _hdf5, ".npz": _arrays}.get(path.suffix, _text)
    try:
        change(path, rng)
    except UnicodeDecodeError:
        path.write_bytes(mutated(path.read_bytes(), rng))


def _text(path: Path, rng: np.random.Generator) -> None:
    """Cells, lines and columns of a text."""
    lines = path.read_text(encoding="utf-8").split("\n")
    for _ in range(int(rng.integers(1, 4))):
        at, kind = int(rng.integers(len(lines))), rng.integers(8)
        mark = next((mark for mark in "\t,;" if mark in lines[at]), " ")
        cells = lines[at].split(mark)
        column = int(rng.integers(len(cells)))
        if kind < 3:
            cells[column] = str(rng.choice(_CELLS))
            lines[at] = mark.join(cells)
        elif kind == 3:
            del lines[at : at + int(rng.integers(1, 1 + len(lines)))]
        elif kind == 4:
            lines.insert(at, lines[int(rng.integers(len(lines)))])
        elif kind == 5:  # a number everywhere
            value = str(rng.choice(_CELLS))
            for i, line in enumerate(lines[1:], 1):
                row = line.split(mark)
                lines[i] = mark.join([*row[:column], value, *row[column + 1 :]]) if column < len(row) else line
        elif kind == 6:  # a column lost
            for i, line in enumerate(lines):
                row = line.split(mark)
                lines[i] = mark.join([*row[:column], *row[column + 1 :]])
        else:  # scaled
            factor = float(rng.choice([1e-9, 1e-3, 1e3, 1e9, -1.0, 1e20]))
            for i, line in enumerate(lines):
                row = line.split(mark)
                with suppress(ValueError, IndexError):
                    row[column] = repr(float(row[column]) * factor)
                    lines[i] = mark.join(row)
        lines = lines or [""]
    path.write_text("\n".join(lines), encoding="utf-8")


def _json(path: Path, rng: np.random.Generator) -> None:
    """Nodes with other values, lost, or exchanged."""
    content = json.loads(path.read_text(encoding="utf-8"))
    nodes: list[tuple[Any, Any]] = []

    def gather(node: Any) -> None:
        entries = (
            list(node.items()) if isinstance(node, dict) else list(enumerate(node)) if isinstance(node, list) else []
        )
        few = 12  # entries of a long list that stand for all
        for key, value in entries[:few] if isinstance(node, list) else entries:
            nodes.append((node, key))
            gather(value)

    gather(content)
    for _ in range(int(rng.integers(1, 4))):
        node, key = nodes[int(rng.integers(len(nodes)))]
        other, place = nodes[int(rng.integers(len(nodes)))]
        kind = rng.integers(4)
        with suppress(LookupError):
            if kind < 2:
                node[key] = _VALUES[int(rng.integers(len(_VALUES)))]
            elif kind == 2:
                del node[key]
            else:
                node[key] = json.loads(json.dumps(other[place]))
    path.write_text(json.dumps(content), encoding="utf-8")


def _store(path: Path, rng: np.random.Generator) -> None:
    """A cell with another value, or a row lost, and checksums put anew."""
    with closing(sqlite3.connect(path)) as connection:
        connection.row_factory = sqlite3.Row
        tables = [row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for _ in range(int(rng.integers(1, 3))):
            chosen = str(rng.choice(tables))
            columns = [row["name"] for row in connection.execute(f"PRAGMA table_info({chosen})")]
            column, other = rng.choice(columns, size=2)
            value = _VALUES[int(rng.integers(len(_VALUES)))]
            value = (
                json.dumps(value)
                if isinstance(value, list | dict)
                else min(value, 1 << 60)
                if value == 1 << 70
                else value
            )
            statement, values = f"UPDATE {chosen} SET {column} = ?", (value,)
            kind = rng.integers(5)
            if kind == 3:
                statement, values = f"UPDATE {chosen} SET {column} = {other}", ()
            elif kind == 4:
                statement, values = f"DELETE FROM {chosen}", ()
            with suppress(sqlite3.Error):
                connection.execute(statement, values)
        with suppress(sqlite3.Error):
            for name in SEALED if rng.random() < 0.7 else ():
                for (number,) in connection.execute(f"SELECT number FROM {name}").fetchall():
                    put_seal(connection, name, number)
        connection.commit()


def _hdf5(path: Path, rng: np.random.Generator) -> None:
    """Attributes and data with other values, types and shapes, sealed anew."""
    import h5py

    sealed = path.read_bytes()[-48:].startswith(b"rotorfit sha256 ")
    with h5py.File(path, "r+") as file:
        items: list[Any] = [file]
        file.visititems(lambda _, item: items.append(item))
        for _ in range(int(rng.integers(1, 4))):
            item = items[int(rng.integers(len(items)))]
            with suppress(Exception):  # the library takes not every value; what a file cannot hold is no test
                _alter_item(item, rng)
    if sealed:
        seal(path)


def _alter_item(item: Any, rng: np.random.Generator) -> None:
    import h5py

    value = _VALUES[int(rng.integers(len(_VALUES)))]
    names = [name for name in item.attrs if not name.startswith(("DIMENSION", "REFERENCE"))]
    if names and rng.random() < 0.5:
        name = str(rng.choice(names))
        if rng.random() < 0.3:
            del item.attrs[name]
        else:
            item.attrs[name] = json.dumps(value) if isinstance(value, list | dict) else value
    elif isinstance(item, h5py.Dataset):
        kind = rng.integers(4)
        parent, name = item.parent, item.name
        if kind == 0:
            data = item[()]
            data[...] = value
            item[...] = data
        elif kind == 1:
            del parent[name]
        else:
            data = np.asarray(item[()])
            attributes = dict(item.attrs)
            del parent[name]
            if kind == 2:
                data = data[: len(data) // 2] if data.ndim else data.reshape(1)
            else:
                data = data.astype("S8") if data.dtype.kind in "fiu" else np.zeros(data.shape)
            made = parent.create_dataset(name, data=data)
            for key, one in attributes.items():
                with suppress(Exception):
                    made.attrs[key] = one


def _arrays(path: Path, rng: np.random.Generator) -> None:
    """Arrays with other shapes, kinds and numbers."""
    with np.load(path) as stored:
        arrays = dict(stored)
    name = str(rng.choice(list(arrays)))
    array = arrays[name]
    kind = rng.integers(7)
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        arrays[name] = array.astype(str)
    elif kind == 2:
        arrays[name] = array.astype(complex) * (1 + 1j)
    elif kind == 3:
        arrays[name] = array * float(rng.choice([0.0, np.nan, 1e300, -1.0, 1e-300, np.inf, 1e160]))
    elif kind == 4:
        arrays[name] = np.array([array, array])
    elif kind == 5:
        arrays[name] = array[:1] if array.ndim else np.array([])
    else:
        arrays[f"{name}2"] = array.ravel()[::-1]
    np.savez(path, **arrays)


# ---- the working process -------------------------------------------------------------------------------------------


def outcome_of(words: str) -> tuple[str, str]:
    """How a command ends, and what is odd in what it said."""
    answer, said = io.StringIO(), io.StringIO()
    with redirect_stdout(answer), redirect_stderr(said):
        try:
            code = _posterior(words.split()[1]) if words.startswith("posterior ") else command(words.split())
        except SystemExit as end:
            code = int(end.code or 0)
        except Exception as problem:
            return "traceback", f"{type(problem).__name__}: {problem}"
    lines = said.getvalue().splitlines()
    if code == 4:
        return "traceback", " / ".join(lines[-5:])
    odd = [line for line in lines if not line.startswith("rotorfit: ") or _REMAINS.search(line)]
    odd += [line for line in answer.getvalue().splitlines() if "Traceback" in line]
    if code == 2 and not lines and "nothing" not in answer.getvalue() and "store check" not in words:
        odd = ["refused without a word"]
    if odd:
        return "unclear", " / ".join(odd)
    return ("refused" if code == 2 else "did"), " / ".join(lines)


def _posterior(name: str) -> int:
    try:
        rf.load_posterior(name, mutated_files._fit()).summary()
    except (ValueError, OSError) as problem:
        print(f"rotorfit: {problem}", file=sys.stderr)
        return 2
    return 0


def serve(folder: Path) -> None:
    """Carry out the commands that come in, a line each, and answer how each ended."""
    import os

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    os.chdir(folder)
    for line in sys.stdin:
        print(
            *(part.replace("\t", " ") for part in outcome_of(line.split("\t")[1])), sep="\t", file=answers, flush=True
        )


class Worker(Reader):
    """A process that carries out commands."""

    script = __file__

    def prepare(self, name: str = "", file: str = "") -> None:
        """Carry out one command: imports take their time once."""
        self.outcome("info whole.csv", "", seconds=60.0)


def _fresh(folder: Path, damaged: Path) -> None:
    """Take away what commands have written, and put the file where a watch and a study look."""
    for name in ("tests.db", "watched.db", "joined.csv", "joined.nc", "vectors.csv", "simulated.csv"):
        (folder / name).unlink(missing_ok=True)
    for name in ("out", "out.previous", "drawn", "drawn.previous", "inbox", "results", "simulated"):
        shutil.rmtree(folder / name, ignore_errors=True)
    (folder / "inbox").mkdir()
    known = 'model = "whirl-whip"\nknown = {K3 = 6000.0}\n'
    file = damaged.name if damaged.suffix not in (".toml", ".db") else "whole.csv"
    shutil.copyfile(folder / file, folder / "inbox" / file)
    (folder / "study.toml").write_text(f'files = ["{file}"]\n{known}', encoding="utf-8")
    (folder / "any.toml").write_text(f'files = ["*"]\n{known}', encoding="utf-8")
    rig = RIG.replace("disk_X", "channel_1").replace("disk_Y", "channel_2") if damaged.suffix == ".wav" else RIG
    (folder / "rig.toml").write_text(rig, encoding="utf-8")


def _of_file(name: str, folder: Path, mutations: int, seed: int, keep: Path | None) -> tuple[Counter[str], list[str]]:
    """Outcomes of one kind of file, and a line for each that is none of the harmless ones."""
    kind, form = FILES[name]
    whole, damaged = folder / f"first{form.suffix}", folder / f"damaged{form.suffix}"
    FORMATS["CSV"].write(folder / "whole.csv")
    FORMATS["npz"].write(folder / "whole.npz")
    form.write(whole)
    shutil.copyfile(folder / "whole.csv", folder / "last_year.csv")
    rng = np.random.default_rng((seed, list(FILES).index(name)))
    count: Counter[str] = Counter()
    lines = []
    with closing(Worker(folder)) as worker:
        worker.prepare()
        for at in range(-len(COMMANDS[kind]), mutations):  # first the file as it is, by every command
            shutil.copyfile(whole, damaged)
            if at >= 0 and rng.random() < 0.5:
                damaged.write_bytes(mutated(whole.read_bytes(), rng))
            elif at >= 0:
                altered(damaged, rng)
            _fresh(folder, damaged)
            words = COMMANDS[kind][at % len(COMMANDS[kind])].replace("{}", damaged.name)
            ending, said = worker.outcome(words, "", seconds=SECONDS)
            if at >= 0:
                count[ending] += 1
            if ending not in ("did", "refused") or at < 0:
                lines.append(f"{name}, {'whole' if at < 0 else f'mutation {at}'}, {words}: {ending}: {said}")
                if keep is not None and at >= 0:
                    shutil.copyfile(damaged, keep / f"{name.replace(' ', '_')}-{at}{form.suffix}")
    return count, lines


def main() -> None:
    """Make the table, or serve as a working process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--mutations", type=int, default=100, help="of each kind of file")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--files", nargs="*", default=list(FILES))
    parser.add_argument("--keep", type=Path, help="folder for files whose end is none of the harmless ones")
    parser.add_argument("--out", type=Path, help="file for the table, else it is printed")
    given = parser.parse_args()
    if given.serve:
        serve(given.serve)
        return
    rows = []
    for name in given.files:
        with tempfile.TemporaryDirectory() as made:
            counts, lines = _of_file(name, Path(made), given.mutations, given.seed, given.keep)
        rows.append([name, str(counts.total()), *(str(counts[ending] or "") for ending in OUTCOMES)])
        print(*lines, " | ".join(rows[-1]), sep="\n", flush=True)
    words = f"benchmarks/mutated_commands.py --mutations {given.mutations} --seed {given.seed}"
    title = f"`{words}`: {environment('numpy', 'h5py')}."
    text = "\n".join(["# Damaged files, by command", "", title, "", *table(["file", "files", *OUTCOMES], rows), ""])
    print(text)
    if given.out is not None:
        given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
