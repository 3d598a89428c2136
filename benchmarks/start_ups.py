"""Start-ups of few lines, every run at speeds of its own: how often do 95 % intervals hold the truth?

    python benchmarks/start_ups.py --draws 100

prints a table. A two-disk rotor with residual unbalance at both disks and run-out at every probe, weights at 0 and 180
degrees, or at 0 degrees beside a run without a weight; noise 0.5 um, given or estimated.
"""

from __future__ import annotations

import argparse
import sys
from itertools import product
from pathlib import Path

import numpy as np

import rotorfit as rf
from rotorfit.models import TwoDisk

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "rigs"))  # the typical rotors live with the tests

from synthetic import TYPICAL

MODEL, TRUTH = TwoDisk(), TYPICAL["two-disk"]
NAMES = ("K1", "K2", "K3", "M1", "M2", "D11", "D22")
LINES, LOW, STEP = 60, 60.0, 9.0
WEIGHT, NOISE = 4e-5, 0.5e-6


def start_ups(seed: int, reference: bool, sigma_given: bool) -> rf.PerturbationTest:
    """All runs, not differenced."""
    rng = np.random.default_rng(seed)
    theta = MODEL.vector(TRUTH)
    residual = 1e-5 * (rng.normal(size=2) + 1j * rng.normal(size=2))
    runout = 5e-6 * (rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2)))
    runs = [(plane, 0.0, WEIGHT) for plane in MODEL.planes]
    runs += [("inboard", 0.0, 0.0)] if reference else [(plane, np.pi, WEIGHT) for plane in MODEL.planes]
    parts = []
    for plane, angle, weight in runs:
        w = LOW + STEP * (np.arange(LINES) + rng.uniform(-0.5, 0.5) + rng.uniform(-0.2, 0.2, LINES))
        force = weight * w**2 * np.exp(1j * angle)
        total = MODEL.force_vector(plane, w, force)
        for at, unbalance in zip(MODEL.planes, residual, strict=True):
            total = total + MODEL.force_vector(at, w, unbalance * w**2)
        motion = np.einsum("lij,lj->li", MODEL.receptance(theta, w, w), total)
        for (i, at), (k, turn) in product(enumerate(MODEL.planes), enumerate((1, -1j))):
            noise = NOISE * (rng.normal(size=LINES) + 1j * rng.normal(size=LINES))
            parts.append(
                {
                    "run": f"{plane} {np.degrees(angle):.0f} {weight:g}", "speed": w, "frequency": w,
                    "force_plane": plane, "force": force, "plane": at, "direction": "xy"[k],
                    "response": turn * motion[:, i] + runout[i, k] + noise, "sigma": NOISE if sigma_given else np.nan,
                }
            )  # fmt: skip
    columns = {key: [np.broadcast_to(np.asarray(part[key]), LINES) for part in parts] for key in parts[0]}
    return rf.perturbation_test(**{key: np.concatenate(values) for key, values in columns.items()})


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=100)
    draws = parser.parse_args().draws
    print(f"| runs | noise | {' | '.join(NAMES)} | redchi |\n|---|---|{'---|' * (len(NAMES) + 1)}")
    for reference, sigma_given in product((False, True), (True, False)):
        held, redchi = np.zeros(len(NAMES)), []
        for seed in range(draws):
            fit = rf.fit(MODEL, rf.difference_synchronous(start_ups(seed, reference, sigma_given)))
            ends = [fit.params[name].interval(0.95) for name in NAMES]
            held += [low <= TRUTH[name] <= high for name, (low, high) in zip(NAMES, ends, strict=True)]
            redchi.append(fit.redchi)
        shares = " | ".join(f"{100 * share:.0f} %" for share in held / draws)
        runs = "0 degrees and none" if reference else "0 and 180 degrees"
        print(
            f"| {runs} | {'given' if sigma_given else 'estimated'} | {shares} | {np.median(redchi):.2f} |", flush=True
        )


if __name__ == "__main__":
    main()
