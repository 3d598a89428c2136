"""Do errors of rotors hold that were identified from their operating vibration: random rotors, forces and floors.

Rotors of one and of two planes, each at one speed, every third at three, 60 to 95 % of the threshold speed, are shaken
by a turbulence of random shape: white, falling with a power of frequency, another one at each plane, or with a corner,
and in half of them stronger forward than backward or the other way round. The floor of the probes is 25 to 40 dB under
the highest peak. Motion is drawn on a grid of frequencies twice as fine as that of the record, cut to its length, and
averaged over cells as a recording is. Fits know what gives the scale, and choose the spectra of force and floor
themselves.

A false warning is one of a fit whose rotor, force and floor are as assumed; the corner is none of the assumed shapes.

    python benchmarks/operating_coverage.py [--rigs 40] [--minutes 10] [--seed 1]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time

import numpy as np
from reporting import table
from scipy.fft import ifft, next_fast_len

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.signals.cells import averaged
from rotorfit.identify.fitting.headline import decrement_of
from rotorfit.identify.fitting.structure.modes import Mode
from rotorfit.lab.data.synchronous import join
from rotorfit.lab.kinds.operating_test import OperatingTest, operating_test
from rotorfit.models.motion.stability import eigenvalues, threshold_speed

RATE = 200.0  # samples a second
TOP = 60.0  # Hz, of the band
KNOWN = {"one-mode": ("M", "Ds", "K"), "whirl-whip": ("Md", "sigma", "K3")}
CLASSES = {"one-mode": rf.models.OneMode, "whirl-whip": rf.models.WhirlWhip}
MIDDLE = {
    "one-mode": {"M": 1.0, "K": 7000.0, "Ds": 5.0, "K0": 3000.0, "D": 400.0, "lam": 0.42, "Mf": 0.2},
    "whirl-whip": {
        "Md": 0.95, "Ds": 3.0, "K1": 14e3, "K2": 15e3, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 1e4, "D": 450.0,
        "lam": 0.475, "Mf": 0.35,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """A virtual rotor, its speeds (rad/s), the force of the flow, and the floor under the highest peak (dB)."""

    model: rf.models.RotorModel
    values: dict[str, float]
    speeds: Float
    flow: rf.Turbulence
    floor: float
    assumed: bool  # whether the force is of a shape that a fit may take


@dataclass(frozen=True)
class Row:
    """One result of one rig: what, its truth, the estimate and its standard error; the fit's choice and warnings."""

    rig: int
    model: str
    speeds: int
    assumed: bool
    what: str
    truth: float
    value: float
    stderr: float
    spectrum: str
    warnings: str
    seconds: float


def rigs(count: int, seed: int) -> Iterator[Rig]:
    """Rotors within some tens of per cent of those of the documents, stable at their speeds."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        name = ("one-mode", "whirl-whip")[number % 2]
        model = CLASSES[name]()
        fixed = {"sigma", "lam"}
        middle = MIDDLE[name].items()
        values = {key: value if key in fixed else value * np.exp(rng.normal(0, 0.25)) for key, value in middle}
        values["lam"] = rng.uniform(0.38, 0.49)
        onset = threshold_speed(model, model.vector(values))
        assert onset is not None
        shares = rng.uniform(0.6, 0.95, 3 if number % 3 == 2 else 1)
        planes = model.planes
        shape = number // 2 % 4
        own = rng.uniform(0.2, 1.5, len(planes))
        flow = rf.Turbulence(
            level={plane: 0.1 * np.exp(rng.normal(0, 0.5)) for plane in planes},
            exponent={0: 0.0, 1: float(own[0]), 2: dict(zip(planes, own.tolist(), strict=True)), 3: 0.0}[shape],
            low_pass_hz=rng.uniform(10, 40) if shape == 3 else np.inf,
            forward=float(np.exp(rng.normal(0, 0.5))) if rng.random() < 0.5 else 1.0,
            correlation=float(rng.uniform(-0.6, 0.6)),
        )
        yield Rig(model, values, np.sort(shares * onset.speed), flow, rng.uniform(25, 40), shape != 3)


def recorded(rig: Rig, minutes: float, rng: np.random.Generator) -> OperatingTest:
    """Records at each speed, as cells."""
    count = int(60 * minutes * RATE)
    size = next_fast_len(2 * count)
    f = np.fft.fftfreq(size, 1 / RATE)
    planes = rig.model.planes
    tests = []
    for number, speed in enumerate(rig.speeds.tolist()):
        h = rig.model.receptance(rig.model.vector(rig.values), 2 * np.pi * f, speed)
        force = normal(rng, size, len(planes)) @ rig.flow._mixing(len(planes)).T * np.sqrt(rig.flow.spectrum(planes, f))
        z = ifft(np.einsum("fij,fj->fi", h, force), axis=0)[:count].T * np.sqrt(size * RATE)
        clean = averaged(z, RATE, band=(1.0, TOP), width=0.5)
        peaks = np.einsum("cii->ci", clean.power).real.max(axis=0).reshape(2, -1).max(axis=0)
        floor = np.sqrt(peaks * 10 ** (-rig.floor / 10) * RATE)
        cells = averaged(z + floor[:, None] * normal(rng, len(planes), count), RATE, band=(1.0, TOP), width=0.25)
        tests.append(operating_test(f"run {number + 1}", speed, planes, cells, {}, ""))
    return join(tests)


def normal(rng: np.random.Generator, *shape: int) -> ComplexArray:
    """Complex normal numbers of unit variance."""
    return np.asarray((rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2))


def rows(number: int, rig: Rig, minutes: float, seed: int) -> Iterator[Row]:
    """What one fit finds."""
    test = recorded(rig, minutes, np.random.default_rng([seed, number]))
    begin = process_time()
    fit = rf.fit(rig.model, test, known={name: rig.values[name] for name in KNOWN[rig.model.name]}, causes=None)
    seconds = process_time() - begin
    theta = rig.model.vector(rig.values)
    onset = threshold_speed(rig.model, theta)
    assert onset is not None
    speed = float(rig.speeds[-1])
    s = eigenvalues(rig.model, theta, speed)
    s = s[-s.real < np.abs(s.imag)]
    found = {
        "threshold": (onset.speed, fit.threshold_speed()),
        "lam": (rig.values["lam"], fit.params["lam"]),
    }
    for way, name in ((1, "forward"), (-1, "backward")):
        own = s[way * s.imag > 0]
        if own.size:
            true = own[np.argmin(-own.real / np.abs(own.imag))]
            near = min(fit.modes(speed=speed), key=lambda mode: abs(pole(mode) - true))
            found[f"decrement {name}"] = (-2 * np.pi * true.real / abs(true.imag), decrement_of(near.damping_ratio))
    codes = " ".join(sorted({finding.code for finding in fit.notices if finding.severity == "warning"}))
    for what, (truth, quantity) in found.items():
        yield Row(
            number, rig.model.name, rig.speeds.size, rig.assumed, what, float(truth), float(quantity.value),
            float(quantity.stderr), fit.settings.force_spectrum, codes, seconds,
        )  # fmt: skip


def pole(mode: Mode) -> complex:
    """Eigenvalue of a mode, 1/s."""
    damped, ratio = mode.frequency.value, mode.damping_ratio.value
    return complex(-abs(damped) * ratio / np.sqrt(max(1 - ratio**2, 1e-12)), damped)


def summary(results: list[Row]) -> list[str]:
    """Table of the document."""
    lines = []
    for model in dict.fromkeys(row.model for row in results):
        for what in dict.fromkeys(row.what for row in results):
            own = [row for row in results if row.model == model and row.what == what and 0 < row.stderr < np.inf]
            if not own:
                continue
            error = np.array([row.value - row.truth for row in own])
            stated = np.array([row.stderr for row in own])
            size = np.array([row.truth for row in own])
            z = error / stated
            lines.append([
                model, what, str(len(own)), f"{np.sqrt(np.mean(z**2)):.2f}", f"{np.mean(np.abs(z) < 1.96):.0%}",
                f"{100 * np.median(stated / size):.2g}",
            ])  # fmt: skip
    return table(("model", "result", "fits", "rms of error / stated", "within 95 %", "stated, % (median)"), lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    results: list[Row] = []
    for number, rig in enumerate(rigs(given.rigs, given.seed)):
        results += rows(number, rig, given.minutes, given.seed)
        last = [row for row in results if row.rig == number]
        said = (f"{row.what} {(row.value - row.truth) / row.stderr:+.1f}" for row in last if row.stderr > 0)
        print(number, rig.model.name, rig.speeds.size, f"{last[0].seconds:.1f} s", last[0].spectrum, last[0].warnings,
              *said, flush=True)  # fmt: skip
    one = {row.rig: row for row in results}.values()
    print("\n".join(summary(results)))
    for assumed, whose in ((True, "a force of a shape that can be chosen"), (False, "another force")):
        own = [row for row in one if row.assumed == assumed]
        print(f"{sum(bool(row.warnings) for row in own)} of {len(own)} fits with {whose} were warned of")


if __name__ == "__main__":
    main()
