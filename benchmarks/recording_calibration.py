"""Do the errors of responses from volts hold, whatever the instruments do?

Rigs are swept in 10 s (or as fast as --seconds says), disk or journal, forward or backward, each with instruments drawn
at random: run-out to 30 um, hum up to 2 um, 12 to 16 bits, speed that wanders up to 0.2 %, noisy Keyphasors, probes at
0/90 or -45/45, missing and double pulses. Counted are errors over stated sigma of the component in the direction of the
force, and of fits of four such records, errors of D and lam over their standard errors.

    python benchmarks/recording_calibration.py --rigs 16
    python benchmarks/recording_calibration.py --rigs 16 --seconds 3
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest

RIG = rf.models.WhirlWhip()
VALUES = {"Md": 0.97, "Ds": 3.0, "K1": 14e3, "K2": 14e3, "sigma": 1.0, "Mb": 0.33, "K3": 6e3, "K0": 9e3, "D": 450.0,
          "lam": 0.475, "Mf": 0.35}  # fmt: skip


def instruments(rng: np.random.Generator) -> rf.Instruments:
    return rf.Instruments(
        sample_rate=5120.0,
        noise=float(rng.uniform(1e-3, 6e-3)),
        runout=tuple(float(a) * 1e-6 for a in rng.uniform(0, [30, 10, 4, 2, 1])),
        hum=float(rng.choice([0.0, rng.uniform(0, 0.016)])),
        hum_hz=float(rng.choice([50.0, 60.0]) + rng.uniform(-0.05, 0.05)),
        bits=int(rng.choice([12, 14, 16])),
        wander=float(rng.uniform(0, 2e-3)),
        keyphasor_noise=float(rng.uniform(0.01, 0.15)),
        probe_angles=((0.0, 90.0), (-45.0, 45.0))[int(rng.integers(2))],
        lost=int(rng.integers(4)),
        doubled=int(rng.integers(4)),
    )


def ratios(test: PerturbationTest, values: dict[str, float]) -> NDArray:
    """Error over sigma, complex over sqrt(2), of all lines."""
    theta, found = RIG.vector(values), []
    for run in test.runs:
        for plane in test.planes:
            x, y = ((test.run == run) & (test.plane == plane) & (test.direction == d) for d in "xy")
            w = test.frequency[x]
            z = np.where(w > 0, test.response[x] + 1j * test.response[y], test.response[x] - 1j * test.response[y]) / 2
            H = RIG.receptance(theta, w, test.speed[x])
            H = H[:, RIG.coordinate(plane, "z"), RIG.coordinate(str(test.force_plane[x][0]), "z")]
            exact = np.where(w > 0, H, H.conj()) * test.force[x]
            found.append((z - exact) / (np.hypot(test.sigma[x], test.sigma[y]) / 2))
    return np.concatenate(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=10.0, help="of a sweep; others than ten are printed only")
    options = parser.parse_args()
    rng, errors, pulls, redchi = np.random.default_rng(11), [], [], []
    for rig in range(options.rigs):
        values = {**VALUES, "lam": float(rng.uniform(0.3, 0.48)), "D": float(rng.uniform(150, 600))}
        speed = float(rng.uniform(900, 1800))
        with tempfile.TemporaryDirectory() as folder:
            paths = rf.simulate_recordings(
                RIG, values, folder, speed_rpm=speed, duration=options.seconds, instruments=instruments(rng), seed=rig
            )
            test = rf.responses([rf.read_recording(path) for path in paths])
        errors.append(ratios(test, values))
        fit = rf.fit(RIG, test, known={"K3": 6e3}, causes=None)
        redchi.append(fit.redchi)
        pulls.append([(fit.params[n].value - values[n]) / fit.params[n].noise for n in ("D", "lam", "K1", "Mf")])
    each = np.array([np.sqrt(np.mean(np.abs(e) ** 2) / 2) for e in errors])
    both = np.concatenate(errors)
    parts = np.concatenate([both.real, both.imag])
    pull = np.array(pulls)
    rows = [
        ["rms of error over sigma, all lines", f"{np.sqrt(np.mean(parts**2)):.3f}", "1"],
        ["the same, rig by rig", f"{each.min():.2f} to {each.max():.2f}", "1"],
        ["robust (median absolute)", f"{1.4826 * np.median(np.abs(parts)):.3f}", "1"],
        ["beyond 1.96 sigma", f"{np.mean(np.abs(parts) > 1.96):.3f}", "0.050"],
        ["beyond 3 sigma", f"{np.mean(np.abs(parts) > 3):.4f}", "0.0027"],
        ["reduced chi-squared of fits", f"{min(redchi):.2f} to {max(redchi):.2f}", "1"],
        ["rms pull of D, lam, K1, Mf", ", ".join(f"{v:.2f}" for v in np.sqrt(np.mean(pull**2, axis=0))), "1"],
    ]
    text = "\n".join(
        [
            "# Errors of responses from volts",
            "",
            f"{options.rigs} rigs with random instruments, four sweeps of {options.seconds:g} s each, {parts.size} "
            "numbers.",
            "",
            *table(["", "found", "if honest"], rows),
            "",
            f"`python benchmarks/recording_calibration.py --rigs {options.rigs}`. {environment('numpy', 'scipy')}",
        ]
    )
    print(text)
    if options.seconds == 10.0:
        (RESULTS / "recording_calibration.md").write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
