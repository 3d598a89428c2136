"""Does ``rf.trend`` find a support that loosens, and does it cry wolf: histories of start-ups beside a 3-sigma rule.

A rotor of two masses on a flexible shaft is started 40 times to half its first critical speed, without and with a trial
weight; after the 25th start the support at the coupling end has lost a share of its stiffness. Mounting the weight anew
scatters its vector by 2 %, readings scatter by 0.3 %. The usual rule looks at the 1x amplitude with the weight at the
highest speed, takes the first 15 starts as a baseline and calls a change when two starts in a row lie beyond 3 standard
deviations on the same side.

    python benchmarks/trend_detection.py [--histories 500]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from reporting import environment

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray

STARTS, CHANGE = 40, 25
LOSSES = (0.05, 0.02, 0.01, 0.0)
MOUNTING, NOISE = 0.02, 0.003
SPEED = np.linspace(30.0, 80.0, 15)  # rad/s, to half of the first critical speed
UNBALANCE = 2e-4  # kg m
RESIDUAL = 1.2e-4 * np.exp(0.7j)
BASELINE, SIGMAS = 15, 3.0


def receptance(support: float, weight: tuple[int, int] = (0, 0)) -> ComplexArray:
    """Motion of one mass per unit force on one mass, m/N: two masses, a shaft between, a support at each."""
    M = np.diag([30.0, 25.0])
    K = np.array([[1e6 + support, -1e6], [-1e6, 1e6 + 5e5]])
    C = np.diag([400.0, 300.0])
    kappa = K[None] + 1j * SPEED[:, None, None] * C - SPEED[:, None, None] ** 2 * M
    return np.asarray(np.linalg.inv(kappa)[:, weight[0], weight[1]])


def history(random: np.random.Generator, *, loss: float) -> tuple[list[rf.PerturbationTest], NDArray[np.float64]]:
    """Tests of one history (weight run minus run without), and the 1x amplitudes with the weight at the top speed."""
    tests, amplitudes = [], []
    for start in range(STARTS):
        H = receptance(7e5 * (1 - loss * (start >= CHANGE)))
        mounted = UNBALANCE * (1 + MOUNTING * (random.normal() + 1j * random.normal()) / np.sqrt(2))
        scale = NOISE * np.abs(H * UNBALANCE * SPEED**2).max()
        noise = scale * (random.normal(size=(2, SPEED.size)) + 1j * random.normal(size=(2, SPEED.size)))
        without = H * RESIDUAL * SPEED**2 + noise[0]
        loaded = H * (RESIDUAL + mounted) * SPEED**2 + noise[1]
        tests.append(
            rf.perturbation_test(
                run=f"start {start + 1}",
                speed=SPEED,
                frequency=SPEED,
                force_plane="coupling end",
                force=UNBALANCE * SPEED**2,
                plane="coupling end",
                direction="z",
                response=loaded - without,
                sigma=scale * np.sqrt(2),
                source=f"start {start + 1:02d}",
            )
        )
        amplitudes.append(abs(loaded[-1]))
    return tests, np.array(amplitudes)


def usual_rule(amplitudes: NDArray[np.float64]) -> bool:
    """Two starts in a row beyond three standard deviations of the baseline, on the same side."""
    base = amplitudes[:BASELINE]
    score = (amplitudes[BASELINE:] - base.mean()) / base.std(ddof=1)
    beyond = np.where(np.abs(score) > SIGMAS, np.sign(score), 0.0)
    return bool(np.any((beyond[1:] == beyond[:-1]) & (beyond[1:] != 0)))


def judged(histories: int, *, loss: float, seed: int, false_alarm: float) -> dict[str, float]:
    """Shares of histories in which either rule sees a change, and how well it is placed and named."""
    random = np.random.default_rng(seed)
    found = usual = placed = named = 0
    for _ in range(histories):
        tests, amplitudes = history(random, loss=loss)
        (place,) = rf.trend([s for t in tests for s in rf.observed_stiffness(t)], false_alarm=false_alarm).places
        usual += usual_rule(amplitudes)
        if place.found and place.change is not None:
            found += 1
            placed += abs(place.change.index - CHANGE) <= 1
            named += place.causes[0].name == "K"
    return {
        "found": found / histories,
        "placed": placed / max(found, 1),
        "named": named / max(found, 1),
        "usual": usual / histories,
    }


def main() -> None:
    """Print the table and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--histories", type=int, default=500)
    parser.add_argument("--false-alarm", type=float, default=0.01)
    options = parser.parse_args()
    begin = perf_counter()
    lines = [
        "# Changes found in histories of start-ups",
        "",
        f"Made by `python benchmarks/trend_detection.py --histories {options.histories}` on "
        f"{environment('numpy', 'scipy')}.",
        "",
        "| support | change found | within one start | called K alone, first | 3-sigma rule on 1x amplitude |",
        "|---|---|---|---|---|",
    ]
    for loss in LOSSES:
        text = f"loses {100 * loss:g} % after start {CHANGE}" if loss else "does not change"
        row = judged(options.histories, loss=loss, seed=1, false_alarm=options.false_alarm)
        where = (f"{row['placed']:.3f}", f"{row['named']:.3f}") if loss else ("", "")
        lines.append(f"| {text} | {row['found']:.3f} | {where[0]} | {where[1]} | {row['usual']:.3f} |")
    lines += ["", f"{len(LOSSES) * options.histories / (perf_counter() - begin):.1f} histories a second."]
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parent / "results" / "trend_detection.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
