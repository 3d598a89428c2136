"""Damping without an exciter: this package, subspace identification and pyOMA-2 on the same recordings.

Three virtual rotors at one speed, shaken by white turbulence, recorded in volts with run-out, a wandering speed and a
floor 30 dB below the highest peak, in minutes given by ``--minutes``:

- one mode: whirl at 0.76 of the threshold speed, forward decrement 0.84, backward hardly an oscillation;
- whirl-whip: at 0.81 of it, decrements 0.83 forward and 0.24 backward;
- compressor: 70 Hz, decrements 0.20 forward and 0.35 backward, the threshold at 3.6 times the speed.

Decrements come from

- a fit of the model to ``rf.operating_spectra``, which gives lam and the threshold speed too;
- covariance-driven subspace identification of the complex signal ``z = x + jy`` (20 lines here), the shaft's
  orders taken out as ``rf.operating_spectra`` does: the pole nearest to the truth, of the order of the model of 2 to 12
  with the least error, which nobody knows who measures;
- pyOMA-2 (``SSI``, method ``cov``) on x and y of the planes, likewise; and how many of its poles its default criteria
  leave. It is left out, in a sentence, where it is not installed (``pip install pyOMA-2``).

    python benchmarks/operating_vibration.py [--draws 8] [--minutes 10]
"""

from __future__ import annotations

import argparse
import resource
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from time import process_time

import numpy as np
from operating_coverage import pole
from reporting import RESULTS, environment, table, write_csv
from scipy.signal import resample_poly

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray
from rotorfit.identify.fitting.headline import decrement_of
from rotorfit.models.motion.stability import eigenvalues, threshold_speed

ORDERS = range(2, 13)  # states of a subspace model


@dataclass(frozen=True)
class Rotor:
    """A virtual rotor in operation: model, its true values, those that are known to a fit, its speed (rad/s), the level
    of the turbulence (N per root Hz), the recorder's rate (Hz), and over how many samples subspace methods average."""

    name: str
    model: rf.models.RotorModel
    values: dict[str, float]
    known: tuple[str, ...]
    speed: float
    level: float
    rate: int
    slower: int


ROTORS = (
    Rotor(
        "one mode",
        rf.models.OneMode(),
        {"M": 1.0, "K": 8000.0, "Ds": 5.0, "K0": 3000.0, "D": 400.0, "lam": 0.40, "Mf": 0.2},
        ("M", "K", "Ds"),
        200.0,
        0.1,
        2000,
        20,
    ),
    Rotor(
        "whirl-whip",
        rf.models.WhirlWhip(),
        {"Md": 0.95, "Ds": 3.0, "K1": 14e3, "K2": 15e3, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 1e4, "D": 450.0,
         "lam": 0.475, "Mf": 0.35},
        ("Md", "sigma", "K3"),
        250.0,
        0.02,
        2000,
        10,
    ),
    Rotor(
        "compressor",
        rf.models.OneMode(),
        {"M": 20.0, "K": 3.7e6, "Ds": 558.0, "K0": 1.7e5, "D": 212.0, "lam": 0.45, "Mf": 0.0},
        ("M", "K0", "D", "Mf"),
        968.0,
        1.0,
        5000,
        20,
    ),
)  # fmt: skip


def modes(rotor: Rotor) -> ComplexArray:
    """True poles of a rotor that whirl, forward and least damped backward, 1/s."""
    s = eigenvalues(rotor.model, rotor.model.vector(rotor.values), rotor.speed)
    s = s[-s.real < 2 * np.abs(s.imag)]
    return np.array([min(s[way * s.imag > 0], key=decrement) for way in (1, -1) if (way * s.imag > 0).any()])


def decrement(s: complex) -> float:
    """Logarithmic decrement of a pole."""
    return float(-2 * np.pi * s.real / abs(s.imag))


def record(rotor: Rotor, minutes: float, seed: int, folder: str) -> rf.Recording:
    """One recording, its floor 30 dB below the highest peak of the motion."""
    f = np.linspace(-120, 120, 20_001)
    h = rotor.model.receptance(rotor.model.vector(rotor.values), 2 * np.pi * f, rotor.speed)
    peak = rotor.level**2 * (np.abs(h) ** 2).sum(axis=2).max()
    probe = np.sqrt(1e-3 * peak * rotor.rate / 2)
    how = rf.Instruments(sample_rate=float(rotor.rate), noise=float(7870.0 * probe))
    (file,) = rf.simulate_recordings(
        rotor.model, rotor.values, folder, "operating", speed=rotor.speed, duration=60 * minutes, residual=0.0,
        turbulence=rotor.level, instruments=how, seed=seed,
    )  # fmt: skip
    return rf.read_recording(file)


def slower(rotor: Rotor, recording: rf.Recording) -> ComplexArray:
    """Motion of the planes without orders of the shaft, at the rate for subspace methods, shape ``(T, n)``."""
    z = np.column_stack([recording.motion(plane) for plane in rotor.model.planes])
    z = resample_poly(z - z.mean(axis=0), 1, rotor.slower, axis=0)
    angle = recording.shaft_angle().angle(np.arange(len(z)) * rotor.slower / rotor.rate)
    turns = np.exp(1j * angle[:, None] * np.arange(-5, 6))
    normal = turns.conj().T @ turns
    return np.asarray(z - turns @ np.linalg.solve(normal, turns.conj().T @ z))


def subspace(rotor: Rotor, recording: rf.Recording) -> dict[int, ComplexArray]:
    """Poles by covariance-driven subspace identification of the complex signal, 1/s, by number of states."""
    z, rows = slower(rotor, recording), 50
    count, n = z.shape
    spectrum = np.fft.fft(z, 2 * count, axis=0)
    lags = np.fft.ifft(spectrum[:, :, None] * spectrum[:, None].conj(), axis=0)[: 2 * rows + 1]
    hankel = np.block([[lags[i + j + 1] for j in range(rows)] for i in range(rows)])
    left, size, _ = np.linalg.svd(hankel)
    found = {}
    for order in ORDERS:
        seen = left[:, :order] * np.sqrt(size[:order])
        ahead = np.linalg.lstsq(seen[:-n], seen[n:], rcond=None)[0]
        found[order] = np.log(np.linalg.eigvals(ahead)) * rotor.rate / rotor.slower
    return found


def packaged(rotor: Rotor, recording: rf.Recording) -> tuple[dict[int, ComplexArray], int, int]:
    """Poles by pyOMA-2 from x and y, those with criteria off, 1/s; and how many there are with its own, and without."""
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    z = slower(rotor, recording)
    both = np.column_stack([part for column in z.T for part in (column.real, column.imag)])
    setup = SingleSetup(both, fs=rotor.rate / rotor.slower)
    how = {"br": 25, "ordmax": 2 * ORDERS.stop}
    off = {"xi_max": 1.0, "mpc_lim": None, "mpd_lim": None, "CoV_max": None}
    every, own = SSI(name="all", method="cov", hc=off, **how), SSI(name="own", method="cov", **how)
    setup.add_algorithms(every, own)
    setup.run_all()
    poles = every.result.Lambds  # in x and y a mode and its conjugate are one
    both_ways = np.concatenate([poles, poles.conj()])
    counts = [int(np.isfinite(each.result.Fn_poles).sum()) for each in (own, every)]
    return {k: s[np.isfinite(s)] for k, s in enumerate(both_ways.T) if np.isfinite(s).any()}, counts[0], counts[1]


@dataclass(frozen=True)
class Row:
    """One number of one record: by whom, the truth, the estimate and its stated error (NaN where there is none)."""

    rotor: str
    draw: int
    what: str
    by: str
    truth: float
    value: float
    stderr: float


def rows(rotor: Rotor, draw: int, minutes: float, kept: list[str]) -> Iterator[Row]:
    """All of one record."""
    with tempfile.TemporaryDirectory() as folder:
        recording = record(rotor, minutes, draw, folder)
        begin = process_time()
        test = rf.operating_spectra(recording)
        fit = rf.fit(rotor.model, test, known={name: rotor.values[name] for name in rotor.known})
        seconds = process_time() - begin
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        others = {"subspace": subspace(rotor, recording)}
        if find_spec("pyoma2"):
            others["pyOMA-2"], own, every = packaged(rotor, recording)
            kept.append(f"{rotor.name}, record {draw}: {own} of {every}")
    codes = [finding.code for finding in fit.notices if finding.severity == "warning"]
    print(rotor.name, draw, f"{seconds:.1f} s, {memory:.2f} GB", fit.settings.force_spectrum, *codes, flush=True)
    theta = rotor.model.vector(rotor.values)
    onset = threshold_speed(rotor.model, theta)
    assert onset is not None
    for what, true, q in (
        ("threshold", onset.speed, fit.threshold_speed()),
        ("lam", rotor.values["lam"], fit.params["lam"]),
    ):
        yield Row(rotor.name, draw, what, "fit", true, q.value, q.stderr)
    for s in modes(rotor).tolist():
        what = f"decrement {'forward' if s.imag > 0 else 'backward'}"
        near = min(fit.modes(speed=rotor.speed), key=lambda mode: abs(pole(mode) - s))
        q = decrement_of(near.damping_ratio)
        yield Row(rotor.name, draw, what, "fit", decrement(s), q.value, q.stderr)
        for by, found in others.items():
            for order, poles in found.items():
                nearest = poles[np.argmin(np.abs(poles - s))]
                yield Row(rotor.name, draw, what, f"{by} {order}", decrement(s), decrement(nearest), np.nan)


def summary(results: list[Row]) -> list[str]:
    """Table of the document: rms errors in per cent of the truth."""
    lines = []
    for rotor in dict.fromkeys(row.rotor for row in results):
        for what in dict.fromkeys(row.what for row in results if row.rotor == rotor):
            every = [row for row in results if (row.rotor, row.what) == (rotor, what)]
            size: dict[str, float] = {}
            for by in dict.fromkeys(row.by for row in every):
                size[by] = rms([row.value / row.truth - 1 for row in every if row.by == by])
            own = [row for row in every if row.by == "fit"]
            z = [(row.value - row.truth) / row.stderr for row in own]
            stated = 100 * float(np.median([row.stderr / row.truth for row in own]))
            best = [
                min((v for by, v in size.items() if by.startswith(name)), default=np.nan)
                for name in ("subspace", "pyOMA-2")
            ]
            lines.append(
                [rotor, what, f"{100 * size['fit']:.2g}", f"{stated:.2g}", f"{rms(z):.2f}",
                 f"{np.mean(np.abs(z) < 1.96):.0%}", *(f"{100 * v:.2g}" if np.isfinite(v) else "-" for v in best)]
            )  # fmt: skip
    head = (
        "rotor", "result", "fit, rms, %", "stated, %", "rms / stated", "within 95 %", "subspace, best order, rms, %",
        "pyOMA-2, best order, rms, %",
    )  # fmt: skip
    return table(head, lines)


def rms(values: list[float]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=10.0)
    given = parser.parse_args()
    results: list[Row] = []
    kept: list[str] = []
    for draw in range(given.draws):
        for rotor in ROTORS:
            results += rows(rotor, draw, given.minutes, kept)
    command = f"python benchmarks/operating_vibration.py --draws {given.draws} --minutes {given.minutes:g}"
    text = [
        "# Damping without an exciter, beside subspace identification", "",
        f"Made by `{command}` on {environment('numpy', 'scipy')}.", "", *summary(results), "",
        "The subspace columns take the pole nearest to the truth and, of 2 to 12 states, the number with the least",
        "error. Poles that the default criteria of pyOMA-2 keep, of all that it finds in any order:", "",
        *(f"- {line}" for line in kept[: len(ROTORS)]),
    ]  # fmt: skip
    path = RESULTS / "operating_vibration.md"
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    write_csv(results, path.with_suffix(".csv"), command)
    print("\n".join(text))


if __name__ == "__main__":
    main()
