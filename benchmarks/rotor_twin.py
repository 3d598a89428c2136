"""A digital twin's parameters from two records in volts: supports that differ in x and y, from unbalance alone.

    python benchmarks/rotor_twin.py --draws 100

writes results/rotor_twin.md. The rotor is that of a twin whose unscented Kalman filter was published: 5 kg with its
mass 0.1 mm off centre at 300 rad/s, k 1.0 and 1.2 MN/m, c 250 and 300 N s/m, 5 um of noise at 2 kHz for 8 s. Its motion
is integrated in time; a record with the unbalance where it is and one with it turned round are written as volts with a
Keyphasor, read by ``rf.read_recording``, reduced by ``rf.responses`` and fitted, the mass being known. Exit status 1
says that errors or coverage are off.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy import stats
from scipy.linalg import expm

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the Keyphasor lives with the tests

from recorded import notch, write_hdf5  # noqa: E402
from reporting import RESULTS, environment  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.base.array_types import Float  # noqa: E402

MASS, OFFSET, SPEED = 5.0, 1e-4, 300.0
TRUTH = {"kx": 1.0e6, "ky": 1.2e6, "cx": 250.0, "cy": 300.0}
EDGE = 0.1
"""Width of the mark's edge, rad: two thirds of a sample at 300 rad/s; wider ones overlap in a notch of 30 degrees."""
NOISE, RATE, SECONDS, SETTLING = 5e-6, 2000.0, 8.0, 1.0
PUBLISHED = {"kx": "-1.6 %", "ky": "-1.1 %", "cx": "110 %", "cy": "110 %"}
SETUP = """rotation = "ccw"
[shaft]
channel = "keyphasor_shaft"
level_V = -5.0
"""
LIMIT = {"k": 0.002, "c": 0.03}
"""Relative errors that two records must keep to."""

TAIL = 1e-2
"""Chance that exact intervals fail the limit of coverage, over all of them together."""


def motion(turned: float) -> Float:
    """x and y at the samples, m, the unbalance being this far ahead of the mark, rad; started at rest, then settled.

    The force turns with the state: steps of the matrix exponential are exact.
    """
    force = MASS * OFFSET * SPEED**2
    A = np.zeros((6, 6))  # x, y, their velocities, and the force's direction
    A[0, 2] = A[1, 3] = 1.0
    A[2, 0], A[2, 2], A[2, 4] = -TRUTH["kx"] / MASS, -TRUTH["cx"] / MASS, force / MASS
    A[3, 1], A[3, 3], A[3, 5] = -TRUTH["ky"] / MASS, -TRUTH["cy"] / MASS, force / MASS
    A[4, 5], A[5, 4] = -SPEED, SPEED
    step = expm(A / RATE)
    state = np.array([0.0, 0.0, 0.0, 0.0, np.cos(turned), np.sin(turned)])
    orbit = np.empty((2, round((SETTLING + SECONDS) * RATE)))
    for sample in range(orbit.shape[1]):
        orbit[:, sample] = state[:2]
        state = step @ state
    return orbit[:, round(SETTLING * RATE) :]


def record(folder: Path, degrees: float, orbit: Float, mark: float, rng: np.random.Generator) -> rf.Recording:
    """A record of volts: 7.87 V/mm, and pulses of a mark this far behind, rad."""
    t = SETTLING + np.arange(orbit.shape[1]) / RATE
    noisy = orbit + NOISE * rng.normal(size=orbit.shape)
    channels = {f"rotor_{axis}": -10.0 + 7870.0 * values for axis, values in zip("XY", noisy, strict=True)}
    channels["keyphasor_shaft"] = notch(SPEED * t - mark, spread=EDGE)
    attributes: dict[str, float | str] = {
        "sample_rate_hz": RATE, "sensitivity_V_per_mm": 7.87, "probe_angle_deg_X": 0.0, "probe_angle_deg_Y": 90.0,
        "weight_plane": "rotor", "weight_angle_deg": degrees + float(np.degrees(mark)), "mr_kg_m": MASS * OFFSET,
        "keyphasor": "falling edge of a notch, -2 V to -8 V",
    }  # fmt: skip
    path = write_hdf5(folder / f"rotor-{degrees:g}.h5", channels, attributes)
    (folder / "rig.toml").write_text(SETUP, encoding="utf-8")
    return rf.read_recording(path, folder / "rig.toml")


def twin() -> rf.models.RotorModel:
    """The mass, in a support that differs in x and y."""
    mass = rf.models.KnownStructure([[MASS]], None, None, [[0.0]], planes={"rotor": 0}, supports="rotor", dofs=("z",))
    return rf.models.Orthotropic(mass, at="rotor")


def draw(orbits: dict[float, Float], seed: int) -> dict[str, tuple[float, float, bool]]:
    """Relative error, its standard error and whether the 95 % interval holds, by coefficient."""
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        mark = rng.uniform(0, 2 * np.pi)
        test = rf.responses([record(Path(folder), degrees, orbit, mark, rng) for degrees, orbit in orbits.items()])
    fit = rf.fit(twin(), test, causes=None)  # what noise and run-out leave
    found = {}
    for name, truth in TRUTH.items():
        mean, half, sign = ("Ks", "dKs", 1) if name[0] == "k" else ("Ds", "dDs", 1)
        sign = 1 if name[1] == "x" else -1
        q = fit.derive(lambda p, mean=mean, half=half, sign=sign: getattr(p, mean) + sign * getattr(p, half) / 2)
        low, high = q.interval(0.95)
        found[name] = (q.value / truth - 1, q.stderr / truth, bool(low < truth < high))
    return found


def bounds() -> dict[str, float]:
    """Relative errors that no unbiased estimate of both records beats, all of the 16000 samples being used."""
    noise = NOISE * np.sqrt(2 / (2 * SECONDS * RATE))  # of real and imaginary part of a response, of both records
    found = {}
    for axis in "xy":
        stiffness = TRUTH[f"k{axis}"] - MASS * SPEED**2 + 1j * SPEED * TRUTH[f"c{axis}"]
        error = noise * np.abs(stiffness) ** 2 / (MASS * OFFSET * SPEED**2)
        found |= {f"k{axis}": error / TRUTH[f"k{axis}"], f"c{axis}": error / SPEED / TRUTH[f"c{axis}"]}
    return found


def main() -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    draws = parser.parse_args().draws
    orbits = {degrees: motion(np.radians(degrees)) for degrees in (0.0, 180.0)}
    every = [draw(orbits, seed) for seed in range(draws)]
    low, high = stats.binom.ppf([TAIL / 8, 1 - TAIL / 8], draws, 0.95) / draws
    rows, good = [], True
    for name, bound in bounds().items():
        errors = np.array([one[name][0] for one in every])
        held = float(np.mean([one[name][2] for one in every]))
        good = good and np.abs(errors).max() < LIMIT[name[0]] and low <= held <= high
        rows.append(
            f"| {name} | {PUBLISHED[name]} | {100 * np.sqrt(np.mean(errors**2)):.3f} % | "
            f"{100 * np.abs(errors).max():.3f} % | {100 * bound:.3f} % | {held:.2f} |"
        )
    lines = [
        "# A rotor twin from two records",
        "",
        f"{draws} pairs of records, {environment('numpy', 'scipy')}. Coverage within {low:.2f} to {high:.2f} is "
        "sampling error. The bound is that of the responses at the running speed from all samples.",
        "",
        "| coefficient | published error | this, rms | this, largest | bound | 95 % interval holds |",
        "| --- | --- | --- | --- | --- | --- |",
        *rows,
        "",
        "All within 0.2 % (stiffness) and 3 % (damping), coverage within sampling error."
        if good
        else "NOT all within 0.2 % (stiffness) and 3 % (damping) with coverage within sampling error.",
        "",
    ]
    (RESULTS / "rotor_twin.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
