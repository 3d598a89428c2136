"""Which damaged files end in a sentence? Mutations of a small file of every format, read in processes with limits.

    python benchmarks/mutated_files.py --mutations 2000 --seed 23

Each mutation is read with at most 1 GB of address space and 10 s of processor time. It is *read*, *refused* (one line
with the file's name), *unclear* (a refusal of several lines, without the name, or with remains of Python), a
*traceback*, a *hang* or a *crash*. Where files carry a checksum, *other numbers* counts those that were read with other
content than written.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import re
import resource
import select
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from reporting import RESULTS, environment, table
from rigs import RIGS

import rotorfit as rf
from rotorfit.apps.study_files.plan_file import read_plan
from rotorfit.apps.study_files.study_file import read_study
from rotorfit.apps.study_files.virtual_test import read_virtual_test
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.recordings.rig.rig_toml import read_setup
from rotorfit.lab.simulation.simulate import SIMULATED

MEMORY = 1 << 30
"""Address space of a reading process, bytes."""
SECONDS = 10.0
"""Processor time for one file."""
WAITED = 60.0
"""Time after which one that takes none hangs too, s."""
OUTCOMES = ("read", "refused", "unclear", "traceback", "hang", "crash", "other numbers")
HARMLESS = ("read", "refused")

_RATE, _SAMPLES = 1000.0, 2500
_PYTHON = re.compile(r"Traceback|<class|object at 0x|numpy\.|np\.|NoneType|list index")
_LONGEST = 1500
"""Characters of a sentence that lists the allowed keys of a table."""
_TOKENS = (b"1e999", b"-1", b"99999999999999999999", b"nan", b"", b"1e300", b"x" * 5000, b"[" * 3000, b'"', b"\n")
_WORDS = tuple(bytes.fromhex(word) for word in (
    "ffffffff", "00000000", "ffffff7f", "7fffffff", "80000000", "00000080", "ffffffffffffffff", "0000000000000080",
    "ffffffffffffff7f", "000000000000f07f", "000000000000f87f", "9c7500883ce4377e",
))  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Format:
    """A kind of file that rotorfit reads."""

    suffix: str
    write: Callable[[Path], None]
    read: Callable[[Path], Any]  # what was read, as arrays, numbers and text
    checked: bool = False  # whether it carries a checksum


# ---- valid files -------------------------------------------------------------------------------


def _test() -> PerturbationTest:
    rig = rf.datasets.rig_lumped()
    assert isinstance(rig, PerturbationTest)
    return rig.select(np.flatnonzero(np.isin(rig.frequency, np.unique(rig.frequency)[::6])))


def _columns(path: Path) -> list[Any]:
    test = rf.read(path, difference=False)
    return [getattr(test, name) for name in test._columns()]


def _write_xlsx(path: Path) -> None:
    from openpyxl import Workbook

    rf.write(_test(), path.with_suffix(".csv"))
    book = Workbook()
    for line in path.with_suffix(".csv").read_text(encoding="utf-8").splitlines():
        book.active.append([float(cell) if re.fullmatch(r"-?[0-9.e+-]+", cell) else cell for cell in line.split(",")])
    book.save(path)


def _write_unsealed(path: Path) -> None:
    rf.write(_test(), path)
    path.write_bytes(path.read_bytes()[:-48])


def _volts() -> dict[str, Any]:
    """A disk at rest that a hammer strikes: its probe, and the force."""
    from scipy.signal import lfilter

    t = np.arange(_SAMPLES) / _RATE
    force = sum(np.exp(-0.5 * ((t - hit) / 1.5e-3) ** 2) for hit in (0.1, 0.57, 1.13, 1.58, 2.11))
    force = force + 1e-4 * np.random.default_rng(7).normal(size=_SAMPLES)
    pole = 0.98 * np.exp(2j * np.pi * 40.0 / _RATE)
    moved = lfilter([0.01], [1.0, -2 * pole.real, abs(pole) ** 2], force)
    return {"disk_X": -10.0 + moved + 1e-4 * np.random.default_rng(5).normal(size=_SAMPLES), "disk_Y": force}


def _write_h5(path: Path) -> None:
    from rotorfit.lab.simulation.instruments import write_counts

    write_counts(path, _volts(), {"sample_rate_hz": _RATE, "rig": "one with a name"})


def _write_tdms(path: Path) -> None:
    from nptdms import ChannelObject, RootObject, TdmsWriter

    with TdmsWriter(str(path)) as file:
        file.write_segment(
            [RootObject({"fs": _RATE}), *(ChannelObject("g", name, v, {"unit": "V"}) for name, v in _volts().items())]
        )


def _write_wav(path: Path) -> None:
    from scipy.io import wavfile

    wavfile.write(path, int(_RATE), np.round(np.column_stack(list(_volts().values())) * 3000).astype("i2"))


def _write_float_wav(path: Path) -> None:
    from scipy.io import wavfile

    wavfile.write(path, int(_RATE), np.column_stack(list(_volts().values())).astype("f4"))


def _write_mat(path: Path, packed: bool = True) -> None:
    from scipy.io import savemat

    struct = {"function_record": {"name": "disk_X"}, "values": _volts()["disk_Y"]}
    savemat(path, {**_volts(), "fs": _RATE, "Signal_1": struct}, do_compression=packed)


def _write_mat73(path: Path) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {**_volts(), "fs": np.array(_RATE)}.items():
            item = file.create_dataset(name, data=np.atleast_2d(values), chunks=True, compression="gzip")
            item.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _write_parquet(path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({"time_s": np.arange(_SAMPLES) / _RATE, **_volts()}), path)


def _write_text(path: Path) -> None:
    rows = np.column_stack(list(_volts().values()))
    np.savetxt(path, rows, "%.5f", ",", header=f"sample_rate_hz = {_RATE}\ndisk_X,disk_Y", comments="# ")
    path.write_text(path.read_text(encoding="utf-8").replace("# disk", "disk"), encoding="utf-8")


def _universal(binary: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        import pyuff

        record = {
            "type": 58, "func_type": 1, "rsp_node": 1, "ref_node": 1, "ref_dir": 1, "binary": binary,
            "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8,
            "orddenom_spec_data_type": 0,
        }  # fmt: skip
        t = np.arange(_SAMPLES) / _RATE
        sets = [
            {**record, "rsp_ent_name": "disk", "id1": name, "rsp_dir": i, "x": t, "data": values}
            for i, (name, values) in enumerate(_volts().items(), 1)
        ]
        path.unlink(missing_ok=True)
        pyuff.UFF(str(path)).write_sets(sets, mode="add")

    return write


def _write_lvm(path: Path) -> None:
    volts = _volts()
    head = [
        "LabVIEW Measurement",
        "Separator\tTab",
        "Decimal_Separator\t,",
        "X_Columns\tOne",
        "***End_of_Header***",
        "",
    ]
    head += ["Channels\t2", f"Samples\t{_SAMPLES}\t{_SAMPLES}", "Y_Unit_Label\tVolts\tVolts", "X0\t0,0\t0,0"]
    head += [
        f"Delta_X\t{1 / _RATE!r}\t{1 / _RATE!r}".replace(".", ","),
        "***End_of_Header***",
        "X_Value\tdisk_X\tdisk_Y\tComment",
    ]
    rows = zip(np.arange(_SAMPLES) / _RATE, *volts.values(), strict=True)
    lines = ["\t".join(f"{value:.6f}".replace(".", ",") for value in row) + "\tOK" for row in rows]
    path.write_text("\n".join([*head, *lines, ""]), encoding="utf-8")


def _write_extensible_wav(path: Path) -> None:
    counts = np.round(np.column_stack(list(_volts().values())) * 4e5).astype("<i4")
    content = counts.reshape(-1, 1).view(np.uint8)[:, :3].tobytes()
    form = np.array([0xFFFE, 2], "<u2").tobytes() + np.array([_RATE, 6 * _RATE], "<u4").tobytes()
    form += np.array([6, 24, 22, 24, 0, 0, 1], "<u2").tobytes() + bytes.fromhex("000000001000800000aa00389b71")
    body = b"WAVEfmt " + np.uint32(len(form)).tobytes() + form + b"data" + np.uint32(len(content)).tobytes() + content
    path.write_bytes(b"RIFF" + np.uint32(len(body)).tobytes() + body)


def _write_matrix(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["data"], file["fs"] = np.column_stack(list(_volts().values())), _RATE
        file["names"] = np.array(list(_volts()), dtype="S")


def _write_foreign_uff(path: Path) -> None:
    w = 2 * np.pi * np.linspace(5.0, 80.0, 25)
    values = 1 / (4e5 - 12 * w**2 + 60j * w)
    lines: list[str] = []
    for axis in (1, 2):
        lines += ["    -1", "    58", *["NONE"] * 5]
        lines.append(f"    4         0    0         0 {'bearing housing'}{7:10d}{axis:4d} {'NONE':10s}{7:10d}{axis:4d}")
        lines.append(f"{6:10d}{25:10d}{1:10d}{5:13.5E}{3.125:13.5E}{1500:13.5E}")
        labels = (18, "Hz"), (8, "m"), (13, "N"), (19, "rpm")
        lines += [f"{kind:10d}    0    0    0 {'NONE':20s} {unit:20s}" for kind, unit in labels]
        lines += [f"{a.real:20.12E}{a.imag:20.12E}{b.real:20.12E}{b.imag:20.12E}".replace("E", "D")
                  for a, b in zip(values[::2], [*values[1::2], 0j], strict=True)]  # fmt: skip
        lines.append("    -1")
    path.write_text("\n".join([*lines, ""]), encoding="ascii")


def _write_json(path: Path) -> None:
    path.write_text(rf.to_dataframe(_test()).to_json(orient="records"), encoding="utf-8")


def _write_stiffness(path: Path) -> None:
    f = np.arange(10.0, 260.0, 10.0)
    rows = ["frequency_hz,speed_rpm,Re_Hxx_MN_m,Im_Hxx_MN_m,Re_Hxy_MN_m,Im_Hxy_MN_m"]
    rows += [f"{v},7000,{180 + 2e-4 * v**2:.6g},{1.4 * v:.6g},{60 + np.sin(v):.6g},{-0.1 * v:.6g}" for v in f]
    path.write_text("\n".join(rows), encoding="utf-8")


def _recorded(path: Path) -> list[Any]:
    raw = open_raw(path)
    channels = list(raw.channels.values())
    return [raw.sample_rate, *[c.sample_rate for c in channels], *[c.samples(0, c.size) for c in channels]]


@cache
def _fit() -> FitResult:
    """The fit that posteriors and checkpoints belong to."""
    rig = RIGS["one-mode"]
    return rf.fit(rig.model, rig.test(8, 0.01), known={name: rig.truth[name] for name in rig.known})


def _sample(path: Path) -> Posterior:
    return _fit().sample(walkers=16, max_steps=10, seed=1, checkpoint=path, accelerate=False)


def _shaft(path: Path) -> list[Any]:
    shaft = rf.models.KnownStructure.from_ross(path, planes={"journal": 1}, fluid="journal")
    return [str(shaft.parameters)]


def _write_store(path: Path) -> None:
    table = path.with_suffix(".csv")
    rf.write(RIGS["one-mode"].test(8, 0.01), table)
    path.unlink(missing_ok=True)
    rf.Store(path).add([table], {"model": "one-mode", "known": {"M": 1.0, "K": 8000.0}})


def _stored(path: Path) -> list[Any]:
    store = rf.Store(path)
    tests = [(test, *(experiment.frequency for experiment in store.experiments(test.number))) for test in store.tests]
    return [*tests, *((fit, store.result(fit.number).x) for fit in store.fits), store.problems()]


def _draws(posterior: Posterior) -> list[Any]:
    return [posterior.chain, posterior.log_density]


_STUDY = """files = ["rig.csv", {path = "other.csv", probe_angles_deg = {journal = [45, 135]}, speed_rpm = 1000.0}]
model = "whirl-whip"
planes = ["disk", "journal"]
known = {K3 = 6000.0, sigma = "free"}
bounds = {lam = [0.0, 0.6]}
priors = {sigma = {norm = [1.0, 0.01]}}
seed = 1
bootstrap = 20
clearance_um = 200.0
"""
_PLAN = """model = "whirl-whip"
known = {K3 = 6000.0}
quantity = ["lam", "threshold_speed"]
noise_um = 0.5
tests = ["last_year.csv"]
[values]
Md = 0.95
K1 = [12e3, 16e3]
Ds = 4.0
K2 = 14e3
sigma = 1.0
Mb = 0.7
K0 = 9e3
Mf = 0.4
lam = 0.46
D = {norm = [450.0, 50.0]}
[design]
speed_rpm = [600, 1000, 1400]
speed_count = 2
frequency_rpm = {from = 100, to = 3000, count = 40}
force_N = 5.0
"""
_VIRTUAL = """model = "one-mode"
noise = 0.01
seed = 1
[params]
M = 1.2
K = 8e3
Ds = 8
K0 = 9e3
D = 450
lam = 0.46
Mf = 0.4
[test]
kind = "perturbation"
speed_rpm = [900, 1500]
frequency_rpm = {from = 200, to = 1600, count = 3}
force = 5
"""
RIG = """rotation = "ccw"
speed_rpm = 0.0
[[probe]]
plane = "disk"
channel = "disk_X"
angle_deg = 0.0
sensitivity_V_per_mm = 7.87
[force]
plane = "disk"
channel_x = "disk_Y"
sensitivity_mV_per_N = 2.25
[[channel]]
name = "disk_X"
volts_per_count = 1e-3
[[channel]]
name = "disk_Y"
volts_per_count = 1e-3
"""

FORMATS = {
    "CSV": Format(suffix=".csv", write=lambda path: rf.write(_test(), path), read=_columns),
    "Excel": Format(suffix=".xlsx", write=_write_xlsx, read=_columns),
    "UFF, vectors": Format(suffix=".uff", write=lambda path: rf.write(_test(), path), read=_columns),
    "netCDF": Format(suffix=".nc", write=lambda path: rf.write(_test(), path), read=_columns, checked=True),
    "netCDF of others": Format(suffix=".nc", write=_write_unsealed, read=_columns),
    "MAT, vectors": Format(suffix=".mat", write=lambda path: rf.write(_test(), path), read=_columns),
    "HDF5": Format(suffix=".h5", write=_write_h5, read=_recorded),
    "MAT 5": Format(suffix=".mat", write=_write_mat, read=_recorded),
    "MAT 7.3": Format(suffix=".mat", write=_write_mat73, read=_recorded),
    "TDMS": Format(suffix=".tdms", write=_write_tdms, read=_recorded),
    "WAV, integers": Format(suffix=".wav", write=_write_wav, read=_recorded),
    "WAV, floats": Format(suffix=".wav", write=_write_float_wav, read=_recorded),
    "Parquet": Format(suffix=".parquet", write=_write_parquet, read=_recorded),
    "text": Format(suffix=".txt", write=_write_text, read=_recorded),
    "UFF58, ASCII": Format(suffix=".uff", write=_universal(0), read=_recorded),
    "UFF58, binary": Format(suffix=".uff", write=_universal(1), read=_recorded),
    "fit.json": Format(suffix=".json", write=lambda path: _fit().save(path), read=lambda path: rf.load_fit(path).x),
    "posterior": Format(
        suffix=".nc",
        write=lambda path: _sample(path.with_suffix(".h5")).save(path),
        read=lambda path: _draws(rf.load_posterior(path, _fit())),
        checked=True,
    ),
    "checkpoint": Format(
        suffix=".h5", write=lambda path: [_sample(path)].clear(), read=lambda path: _draws(_sample(path)), checked=True
    ),
    "study": Format(suffix=".toml", write=lambda path: [path.write_text(_STUDY)].clear(), read=read_study),
    "rig.toml": Format(suffix=".toml", write=lambda path: [path.write_text(RIG)].clear(), read=read_setup),
    "MAT 5, not packed": Format(suffix=".mat", write=lambda path: _write_mat(path, packed=False), read=_recorded),
    "npz": Format(suffix=".npz", write=lambda path: np.savez(path, **_volts(), fs=_RATE), read=_recorded),
    "shaft": Format(
        suffix=".npz", write=lambda path: np.savez(path, M=np.eye(8), K=np.eye(8), nodes=np.arange(2.0)), read=_shaft
    ),
    "LabVIEW": Format(suffix=".lvm", write=_write_lvm, read=_recorded),
    "WAV, extensible": Format(suffix=".wav", write=_write_extensible_wav, read=_recorded),
    "HDF5 matrix": Format(suffix=".h5", write=_write_matrix, read=_recorded),
    "UFF, foreign": Format(suffix=".uff", write=_write_foreign_uff, read=_columns),
    "JSON": Format(suffix=".json", write=_write_json, read=_columns),
    "dynamic stiffness": Format(suffix=".csv", write=_write_stiffness, read=_columns),
    "plan": Format(suffix=".toml", write=lambda path: [path.write_text(_PLAN)].clear(), read=read_plan),
    "virtual test": Format(
        suffix=".toml",
        write=lambda path: [path.write_text(_VIRTUAL)].clear(),
        read=partial(read_virtual_test, kinds=SIMULATED),
    ),
    "store": Format(suffix=".db", write=_write_store, read=_stored),
}


# ---- mutations ---------------------------------------------------------------------------------


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A file with one kind of damage: bits, bytes, sizes, a lost end, pieces lost, doubled or zeroed, other text."""
    if content.startswith(b"PK\x03\x04") and rng.random() < 0.7:
        return _in_archive(content, rng)
    data = bytearray(content)
    kind = rng.integers(8)
    begin = int(rng.integers(len(data)))
    end = min(len(data), begin + int(2 ** rng.uniform(0, np.log2(len(data)))))
    if kind == 0:
        for at in rng.integers(len(data), size=rng.integers(1, 9)):
            data[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        for at in rng.integers(len(data), size=rng.integers(1, 9)):
            data[at] = int(rng.integers(256))
    elif kind == 2:
        del data[begin:]
    elif kind == 3:
        del data[begin:end]
    elif kind == 4:
        data[begin:begin] = data[begin:end]
    elif kind == 5:
        data[begin:end] = bytes(end - begin)
    elif kind == 6:
        word = _WORDS[rng.integers(len(_WORDS))]
        data[begin : begin + len(word)] = word
    else:
        tokens = list(re.finditer(rb"[-+.0-9eE]{1,12}|[A-Za-z_]+", content))
        chosen = tokens[rng.integers(len(tokens))]
        data[chosen.start() : chosen.end()] = _TOKENS[rng.integers(len(_TOKENS))]
    return bytes(data)


def _in_archive(content: bytes, rng: np.random.Generator) -> bytes:
    """The same damage inside a part of an archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as whole:
        parts = {name: whole.read(name) for name in whole.namelist()}
    damaged = list(parts)[rng.integers(len(parts))]
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, mutated(part, rng) if name == damaged and part else part)
    return target.getvalue()


# ---- the reading process -----------------------------------------------------------------------


def outcome_of(kind: Format, path: Path) -> tuple[str, str]:
    """How reading a file ends, and the fingerprint of what was read or the words of the end."""
    try:
        return "read", _fingerprint(kind.read(path))
    except (ValueError, OSError) as problem:
        words = str(problem)
        clear = "\n" not in words and path.name in words and len(words) < _LONGEST and not _PYTHON.search(words)
        return ("refused" if clear else "unclear"), f"{type(problem).__name__}: {words}"
    except Exception as problem:
        return "traceback", f"{type(problem).__name__}: {problem}"


def _fingerprint(values: Any) -> str:
    parts = values if isinstance(values, list) else [values]
    words = "".join(str(part.tolist() if isinstance(part, np.ndarray) else part) for part in parts)
    return hashlib.sha256(words.encode()).hexdigest()


def serve(folder: Path) -> None:
    """Write or read the files whose formats and names come in, a line each, and answer how it ended."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    for line in sys.stdin:
        action, name, file = line.rstrip("\n").split("\t")
        if action == "write":
            FORMATS[name].write(folder / file)
        ending, words = outcome_of(FORMATS[name], folder / file)
        print(ending, repr(words)[:400], sep="\t", file=answers, flush=True)


class Reader:
    """A process that reads files, made anew where one ended it or took too long."""

    script = __file__

    def __init__(self, folder: Path) -> None:
        self._folder, self._process = folder, self._started(folder)

    def _started(self, folder: Path) -> subprocess.Popen[str]:
        command = [sys.executable, self.script, "--serve", str(folder)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        environment |= {"ARROW_DEFAULT_MEMORY_POOL": "system", "PYTHONPATH": os.pathsep.join(sys.path)}
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)

    def _answered(self, seconds: float) -> bool:
        """True once there is an answer, false when the time for it has passed."""
        begin, used = time.monotonic(), self._used()
        while not select.select([self._process.stdout], [], [], 1.0)[0]:
            if self._used() - used > seconds or time.monotonic() - begin > WAITED:
                return False
        return True

    def _used(self) -> float:
        """Processor time of the process and of those that it has started, s."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")

    def outcome(self, name: str, file: str, action: str = "read", seconds: float = SECONDS) -> tuple[str, str]:
        """How reading a file ends, that is written first if the action says so."""
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("the reading process has no pipes")
        process.stdin.write(f"{action}\t{name}\t{file}\n")
        process.stdin.flush()
        if self._answered(seconds):
            answer = process.stdout.readline()
            if answer:
                ending, _, words = answer.rstrip("\n").partition("\t")
                return ending, words
            ending = ("crash", f"exit code {process.wait()}")
        else:
            ending = ("hang", f"more than {seconds:g} s of processor time, or {WAITED:g} s in all")
        self.close()
        self._process = self._started(self._folder)
        self.prepare(name, file)
        return ending

    def prepare(self, name: str = "", file: str = "") -> None:
        """Read a whole file: imports take their time once."""
        self.outcome(name, str(Path(file).with_stem("whole")), seconds=60.0)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


def _format(name: str, folder: Path, reader: Reader, mutations: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Outcomes of one format, and a line for each that is none of the harmless ones."""
    kind = FORMATS[name]
    whole, damaged = folder / f"whole{kind.suffix}", folder / f"damaged{kind.suffix}"
    ending, fingerprint = reader.outcome(name, f"{folder.name}/{whole.name}", "write", 60.0)
    if ending != "read":
        raise RuntimeError(f"{name}: the valid file was not read: {fingerprint}")
    rng = np.random.default_rng((seed, list(FORMATS).index(name)))
    count: Counter[str] = Counter()
    lines = []
    for at in range(mutations):
        damaged.write_bytes(mutated(whole.read_bytes(), rng))
        ending, words = reader.outcome(name, f"{folder.name}/{damaged.name}")
        if ending == "read" and kind.checked and words != fingerprint:
            ending = "other numbers"
        count[ending] += 1
        if ending not in HARMLESS:
            lines.append(f"{name}, mutation {at}: {ending}: {words}")
    return count, lines


def study(names: list[str], mutations: int, seed: int) -> tuple[dict[str, Counter[str]], list[str]]:
    """Outcomes by format, and a line for each that is none of the harmless ones."""
    counts: dict[str, Counter[str]] = {}
    lines: list[str] = []
    with tempfile.TemporaryDirectory() as made:
        together = 4  # formats that a process reads: the libraries of all leave little of its address space
        for begin in range(0, len(names), together):
            with closing(Reader(Path(made))) as reader:
                for number, name in enumerate(names[begin : begin + together], begin):
                    folder = Path(made) / f"{number}"
                    folder.mkdir()
                    counts[name], found = _format(name, folder, reader, mutations, seed)
                    lines += found
    return counts, lines


def report(counts: dict[str, Counter[str]], title: str, before: str = "") -> str:
    """The table of outcomes; of formats that were not read, the rows of the table before."""
    rows = {
        name: [name, str(found.total()), *(str(found[ending] or "") for ending in OUTCOMES)]
        for name, found in counts.items()
    }
    for line in before.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in FORMATS:
            rows.setdefault(cells[0], cells)
    ordered = [rows[name] for name in FORMATS if name in rows]
    return "\n".join(["# Damaged files", "", title, "", *table(["format", "mutations", *OUTCOMES], ordered), ""])


def main() -> None:
    """Make the table, or serve as a reading process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--mutations", type=int, default=2000, help="of each format")
    parser.add_argument("--seed", type=int, default=23)
    parser.add_argument("--formats", nargs="*", default=list(FORMATS), help="others keep their rows in the table")
    parser.add_argument("--out", type=Path, default=RESULTS / "mutated_files.md")
    given = parser.parse_args()
    if given.serve:
        serve(given.serve)
        return
    counts, lines = study(given.formats, given.mutations, given.seed)
    title = (
        f"`benchmarks/mutated_files.py --seed {given.seed}`, with `--mutations` as the rows say: "
        f"{environment('numpy', 'scipy', 'h5py', 'pyuff', 'openpyxl', 'nptdms', 'pyarrow')}."
    )
    text = report(counts, title, given.out.read_text(encoding="utf-8") if given.out.exists() else "")
    given.out.write_text(text, encoding="utf-8")
    print(text, *lines, sep="\n")


if __name__ == "__main__":
    main()
