"""Vectors of the same swept recordings by several methods: error and time side by side.

A whirl-whip rig is swept at disk and journal, both ways, in 10 and 60 s, integrated in time and recorded with noise and
run-out. From the same files come vectors by

- local models of the whole record's spectrum (``rf.responses``),
- windows of 24 and of 6 turns with the orders of both marks, as a tracking filter with two references does
  (``rf.responses(turns=...)``), and with the perturbator's mark alone, as one with a single reference does,
- SciPy's ``ShortTimeFFT`` of motion and force, divided at the line nearest to the frequency of the moment,
- a Vold-Kalman filter of two poles with the orders w and 1x together (J. Tuma, 2005; written here, 30 lines, because no
  open one was found that installs from PyPI), of the bandwidth of a window of 24 turns in the middle of the sweep.

Error is that of the component in the direction of the force against the rotor's receptance, between 60 and 480 rad/s
and off the shaft's orders. D and lam come from a fit of each method's vectors; the last two state no errors, so the
fit finds the noise itself. Time is the processor time for all four records, reading included.

    python benchmarks/recording_methods.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table, write_csv

import rotorfit as rf
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.estimators.signals.tracking import track_windows
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.recordings.recording import Recording
from rotorfit.lab.recordings.reduction.reduced_record import ReducedRecord, reduce_record

RIG = rf.models.WhirlWhip()
VALUES = {"Md": 0.97, "Ds": 3.0, "K1": 14e3, "K2": 14e3, "sigma": 1.0, "Mb": 0.33, "K3": 6e3, "K0": 9e3, "D": 450.0,
          "lam": 0.475, "Mf": 0.35}  # fmt: skip
SPEED = 1500.0
DURATIONS = (10.0, 60.0)
LOW, HIGH = 60.0, 480.0
Vectors = Callable[[list[Recording]], PerturbationTest]


@dataclass(frozen=True)
class Result:
    """One method on the sweeps of one duration.

    Attributes:
        method: name.
        duration: of a sweep, s.
        lines: of all four records.
        median, worst: relative error of H, median over all, and 95 % quantile.
        off_D, off_lam: of the fitted values, per cent.
        redchi: of that fit.
        seconds: processor time for four records.
    """

    method: str
    duration: float
    lines: int
    median: float
    worst: float
    off_D: float
    off_lam: float
    redchi: float
    seconds: float


def reduced(record: Recording) -> ReducedRecord:
    return reduce_record(record, record.perturbator_angle(), record.force.whirl)


def as_test(record: Recording, w: NDArray, along: dict[str, NDArray], clear: NDArray) -> PerturbationTest:
    """Rows of complex amplitudes over force, seen turning with the drive, at each plane."""
    force = record.force
    parts = [(plane, H[clear]) for plane, H in along.items()]
    w = w[clear]
    newton = force.mr * w**2 * np.exp(1j * force.angle)
    turned = [(plane, H * newton if force.whirl > 0 else (H * newton).conj()) for plane, H in parts]
    return perturbation_test(
        run=record.name,
        speed=SPEED * RAD_S_PER_RPM,
        frequency=np.tile(force.whirl * w, len(parts)),
        force_plane=force.plane,
        force=np.tile(newton, len(parts)),
        plane=np.repeat([plane for plane, _ in turned], w.size),
        direction="z",
        response=np.concatenate([z for _, z in turned]),
        source=record.name,
    )


def joined(parts: list[PerturbationTest]) -> PerturbationTest:
    from rotorfit.lab.data.synchronous import join

    return join(parts)


def one_reference(records: list[Recording]) -> PerturbationTest:
    """Windows of 24 turns that know nothing of the shaft."""
    parts = []
    for record in records:
        r = reduced(record)
        signals = np.array([z if r.whirl > 0 else z.conj() for z in r.motion.values()])
        found = track_windows(signals, r.drive_angle, None, turns=24)
        w = r.drive_speed[found.centre]
        force = record.force.mr * w**2 * np.exp(1j * record.force.angle)
        along = {plane: found.along[i] / force for i, plane in enumerate(r.motion)}
        parts.append(as_test(record, w, along, np.ones(w.size, bool)))
    return joined(parts)


def short_time(records: list[Recording]) -> PerturbationTest:
    from scipy.signal import ShortTimeFFT
    from scipy.signal.windows import hann

    parts = []
    for record in records:
        r = reduced(record)
        size = int(24 * 2 * np.pi / 250.0 * r.rate)
        transform = ShortTimeFFT(hann(size), hop=size // 4, fs=r.rate, fft_mode="twosided", mfft=4 * size)
        force = record.force.mr * np.exp(1j * record.force.angle) * r.unit_force
        F = transform.stft(force)
        t = np.clip((transform.t(force.size) * r.rate).round().astype(int), 0, force.size - 1)
        w = r.drive_speed[t]
        row = np.argmin(np.abs(transform.f[:, None] - w / (2 * np.pi)), axis=0)
        column = np.arange(t.size)
        along = {}
        for plane, z in r.motion.items():
            Z = transform.stft(z if r.whirl > 0 else z.conj())
            with np.errstate(invalid="ignore"):  # slices before the record begins
                along[plane] = Z[row, column] / F[row, column]
        inside = (column > 4) & (column < t.size - 4)
        parts.append(as_test(record, 2 * np.pi * transform.f[row], along, inside))
    return joined(parts)


def vold_kalman(records: list[Recording]) -> PerturbationTest:
    """Envelopes of the orders w and 1x whose second differences are small: one banded system."""
    from scipy.linalg import solveh_banded

    parts = []
    for record in records:
        r = reduced(record)
        count, turn = r.time.size, np.exp(1j * r.drive_angle)
        shaft = np.exp(1j * r.whirl * r.shaft_angle)
        width = 250.0 / (24 * 2 * np.pi)  # Hz, of a window of 24 turns at 250 rad/s
        weight = (np.sqrt(np.sqrt(2) - 1) / (2 - 2 * np.cos(np.pi * width / r.rate))) ** 2
        second = np.zeros((3, count))  # bands of the product of second differences, main diagonal last
        for i, a in enumerate((1.0, -2.0, 1.0)):
            for k, b in enumerate((1.0, -2.0, 1.0)):
                if k >= i:
                    second[2 - (k - i), k : count - 2 + k] += a * b
        bands = np.zeros((5, 2 * count), complex)  # unknowns interleaved: w, 1x, w, 1x, ...
        bands[4] = 1 + weight * np.repeat(second[2], 2)
        bands[2, 2:] = weight * np.repeat(second[1, 1:], 2)
        bands[0, 4:] = weight * np.repeat(second[0, 2:], 2)
        bands[3, 1::2] = turn.conj() * shaft
        right = np.zeros((2 * count, len(r.motion)), complex)
        for i, z in enumerate(r.motion.values()):
            signal = (z if r.whirl > 0 else z.conj()) - z.mean()
            right[::2, i], right[1::2, i] = turn.conj() * signal, shaft.conj() * signal
        envelope = solveh_banded(bands, right)[::2]
        at = np.linspace(0, count - 1, 130).astype(int)[4:-4]
        w = r.drive_speed[at]
        force = record.force.mr * w**2 * np.exp(1j * record.force.angle)
        along = {plane: envelope[at, i] / force for i, plane in enumerate(r.motion)}
        parts.append(as_test(record, w, along, np.abs(w / r.shaft_speed - np.rint(w / r.shaft_speed)) > 0.05))
    return joined(parts)


METHODS: dict[str, Vectors] = {
    "local models of the spectrum": rf.responses,
    "windows of 24 turns, two references": lambda records: rf.responses(records, turns=24),
    "windows of 6 turns, two references": lambda records: rf.responses(records, turns=6),
    "windows of 24 turns, one reference": one_reference,
    "scipy ShortTimeFFT": short_time,
    "Vold-Kalman, two poles": vold_kalman,
}


def errors(test: PerturbationTest) -> NDArray:
    """Relative errors of the component in the direction of the force."""
    theta, found = RIG.vector(VALUES), []
    for run in test.runs:
        for plane in test.planes:
            here = (test.run == run) & (test.plane == plane)
            parts = {d: here & (test.direction == d) for d in "xyz"}
            rows = parts["z"] if parts["z"].any() else parts["x"]
            w, F = test.frequency[rows], test.force[rows]
            if parts["z"].any():
                z = test.response[rows]
            else:
                x, y = test.response[parts["x"]], test.response[parts["y"]]
                z = np.where(w > 0, x + 1j * y, (x - 1j * y).conj()) / 2
            at, forced = RIG.coordinate(plane, "z"), RIG.coordinate(str(test.force_plane[rows][0]), "z")
            H = RIG.receptance(theta, w, test.speed[rows])[:, at, forced]
            off = np.abs(np.abs(w) / test.speed[rows] - np.rint(np.abs(w) / test.speed[rows]))
            kept = (np.abs(w) > LOW) & (np.abs(w) < HIGH) & (off > 0.02)
            found.append(np.abs(z / (H * np.where(w > 0, F, F.conj())) - 1)[kept])
    return np.concatenate(found)


def measure(method: str, duration: float, paths: list[Path]) -> Result:
    records = [rf.read_recording(path) for path in paths]
    begin = time.process_time()
    test = METHODS[method](records)
    seconds = time.process_time() - begin
    off = errors(test)
    fit = rf.fit(RIG, test, known={"K3": 6e3})
    D, lam = (100 * (fit.params[name].value / VALUES[name] - 1) for name in ("D", "lam"))
    lines = len(test) // (2 * len(test.planes) if test.direction[0] != "z" else len(test.planes))
    return Result(
        method, duration, lines, float(np.median(off)), float(np.quantile(off, 0.95)), D, lam, fit.redchi, seconds
    )


def main() -> int:
    results = []
    for duration in DURATIONS:
        with tempfile.TemporaryDirectory() as folder:
            paths = rf.simulate_recordings(
                RIG, VALUES, folder, speed_rpm=SPEED, duration=duration, instruments=rf.Instruments(sample_rate=4096.0)
            )
            rf.responses(rf.read_recording(paths[0]))  # imports
            results += [measure(method, duration, paths) for method in METHODS]
    rows = [
        [f"{r.duration:g}", r.method, str(r.lines), f"{100 * r.median:.2g}", f"{100 * r.worst:.2g}", f"{r.off_D:+.2g}",
         f"{r.off_lam:+.2g}", f"{r.redchi:.3g}", f"{r.seconds:.1f}"]
        for r in results
    ]  # fmt: skip
    head = ["sweep, s", "method", "lines", "median error, %", "95 % below, %", "D off, %", "lam off, %", "redchi", "s"]
    text = "\n".join(
        [
            "# Vectors of swept recordings by several methods", "",
            "Four sweeps (disk and journal, forward and backward), 60 to 5000 rpm at 1500 rpm, 0.4 um noise, run-out "
            "of 12 um; errors of H between 60 and 480 rad/s.", "",
            *table(head, rows), "",
            f"`python benchmarks/recording_methods.py`. {environment('numpy', 'scipy')}",
        ]
    )  # fmt: skip
    print(text)
    (RESULTS / "recording_methods.md").write_text(text + "\n", encoding="utf-8")
    write_csv(results, RESULTS / "recording_methods.csv", "python benchmarks/recording_methods.py")
    return 0


if __name__ == "__main__":
    sys.exit(main())
