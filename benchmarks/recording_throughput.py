"""From volts to vectors in times real time: 16 channels at 25.6 kHz on one core, memory bounded, beside a plain STFT.

A recording of 16 channels (seven planes with two probes, two Keyphasors) is simulated piece by piece and written to
HDF5 as 16-bit counts. Timed is all that ``rf.responses`` does, opening of the file included: pulses and angles,
checks of the channels, filtering, spectra and local fits. Beside it stand reading alone and SciPy's
``ShortTimeFFT`` of the same 14 probe channels, which gives amplitudes and neither force, orders nor errors. Each runs
in a process of its own, whose largest memory is told.

    python benchmarks/recording_throughput.py --minutes 15

The exit code is 1 below 100 times real time, or above 1 GB.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table

RATE = 25_600.0
PLANES = 7
PIECE = 1 << 19
SPEED, FIRST, LAST = 157.08, 6.0, 520.0
WANTED, MEMORY = 100.0, 1024.0


def write_recording(path: Path, minutes: float, compression: str | None) -> None:
    """A two-mode rotor's quasi-steady motion at seven planes; good enough for a stopwatch."""
    import h5py

    count, duration = int(minutes * 60 * RATE), minutes * 60
    slope, rng = (LAST - FIRST) / duration, np.random.default_rng(0)
    names = [f"plane{p}_{axis}" for p in range(PLANES) for axis in "XY"]
    with h5py.File(path, "w") as file:
        for name in [*names, "keyphasor_shaft", "keyphasor_perturbator"]:
            data = file.create_dataset(name, shape=(count,), dtype="i2", chunks=(1 << 16,), compression=compression)
            data.attrs["volts_per_count"] = 20 / 32768
        for begin in range(0, count, PIECE):
            t = np.arange(begin, min(begin + PIECE, count)) / RATE
            w, angle = FIRST + slope * t, FIRST * t + slope * t**2 / 2
            here = slice(begin, begin + t.size)
            for p in range(PLANES):
                H = 1e-2 / (2e4 * (1 + 0.1 * p) - w**2 + 1j * 14 * w)
                z = 2e-5 * w**2 * H * np.exp(1j * angle) + 1e-5 * np.exp(1j * (SPEED * t + p))
                for axis, part in zip("XY", (z.real, z.imag), strict=True):
                    volts = -10 + 7870 * part + 3e-3 * rng.standard_normal(t.size)
                    file[f"plane{p}_{axis}"][here] = np.rint(volts * 32768 / 20).astype(np.int16)
            for name, turned in (("shaft", SPEED * t), ("perturbator", angle)):
                into = np.mod(np.degrees(turned), 360.0)
                volts = -2 - 6 * (np.clip(into / 4, 0, 1) - np.clip((into - 24) / 4, 0, 1))
                volts += 0.02 * rng.standard_normal(t.size)
                file[f"keyphasor_{name}"][here] = np.rint(volts * 32768 / 20).astype(np.int16)
        file.attrs.update(
            {
                "sample_rate_hz": RATE, "sensitivity_V_per_mm": 7.87, "probe_angle_deg_X": 0.0,
                "probe_angle_deg_Y": 90.0, "force_plane": "plane0", "whirl": "forward", "mr_kg_m": 2e-5,
                "heavy_spot_deg_ahead_of_mark": 0.0, "speed_rpm": SPEED * 30 / np.pi,
                "keyphasor": "falling edge of a notch",
            }
        )  # fmt: skip


def vectors(path: Path) -> int:
    import rotorfit as rf

    return len(rf.responses(rf.read_recording(path)))


def reading(path: Path) -> int:
    import h5py

    with h5py.File(path) as file:
        return sum(int(data[a : a + PIECE].size) for data in file.values() for a in range(0, data.size, PIECE))


def stft(path: Path) -> int:
    """Windows of 24 turns at 1500 rpm, half overlapping, in pieces."""
    import h5py
    from scipy.signal import ShortTimeFFT
    from scipy.signal.windows import hann

    size, total = 24_576, 0
    transform = ShortTimeFFT(hann(size), hop=size // 2, fs=RATE, scale_to="magnitude")
    with h5py.File(path) as file:
        for name, data in file.items():
            if name.startswith("plane"):
                for begin in range(0, data.size, PIECE):
                    total += transform.stft(data[begin : begin + PIECE] * data.attrs["volts_per_count"]).size
    return total


JOBS = {"rf.responses": vectors, "scipy ShortTimeFFT": stft, "reading alone": reading}


def timed(job: str, path: Path) -> dict[str, float]:
    """Processor time and largest memory of one job in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--job", job, "--file", str(path)], check=True, capture_output=True, text=True
    )
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--compression", default="none", help="none, lzf or gzip")
    parser.add_argument("--job", choices=JOBS, help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.job:
        begin = time.process_time()
        found = JOBS[options.job](options.file)
        seconds = time.process_time() - begin
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps({"seconds": seconds, "memory": memory, "found": found}))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        write_recording(path, options.minutes, None if options.compression == "none" else options.compression)
        size = path.stat().st_size / 1e6
        found = {job: timed(job, path) for job in JOBS}
    real = options.minutes * 60
    rows = [
        [job, f"{one['seconds']:.2f}", f"{real / one['seconds']:.0f}", f"{one['memory']:.0f}"]
        for job, one in found.items()
    ]
    command = f"--minutes {options.minutes:g} --compression {options.compression}"
    text = "\n".join(
        [
            "# From volts to vectors: throughput",
            "",
            f"16 channels at 25.6 kHz, {options.minutes:g} minutes, 16-bit counts, compression {options.compression} "
            f"({size:.0f} MB). Processor time of one thread; memory is the largest of the process, Python and all "
            "libraries included.",
            "",
            *table(["", "seconds", "times real time", "memory, MB"], rows),
            "",
            f"`python benchmarks/recording_throughput.py {command}`. {environment('numpy', 'scipy', 'h5py')}",
        ]
    )
    print(text)
    name = "recording_throughput" + ("" if options.compression == "none" else f"_{options.compression}")
    (RESULTS / f"{name}.md").write_text(text + "\n", encoding="utf-8")
    ours = found["rf.responses"]
    return int(real / ours["seconds"] < WANTED or ours["memory"] > MEMORY)


if __name__ == "__main__":
    sys.exit(main())
