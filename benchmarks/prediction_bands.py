"""Coverage of the bands of `predict`: the truth, and new readings, at an untested speed and an unforced plane.

A whirl-and-whip rotor is tested at two speeds, every plane forced and read forward and backward, three runs of each.
The response of the journal to a force at the disk is predicted at a speed a fifth above. Counted over the draws is how
often the 95 % bands hold the true amplitude and phase, point by point (mean over 40 points) and as whole curves, and
readings of a new run. Truth and readings come from the model's own matrices. In two cases the model takes something as
known that is wrong at random, with the standard uncertainty that `causes=` names; elsewhere no cause is listed.

    python benchmarks/prediction_bands.py --draws 200

The exit code is 1 where bands of ideal noise hold in less than 93 or more than 97 %, by more than chance.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table

import rotorfit as rf
from rotorfit.identify.uncertainty.prediction import Band

MODEL = rf.models.WhirlWhip()
VALUES = {
    "Md": 0.95, "Ds": 25.0, "K1": 14e3, "K2": 15e3, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 1e4, "D": 450.0,
    "lam": 0.475, "Mf": 0.35,
}  # fmt: skip
KNOWN = {"K3": 6e3}
SPEEDS, ELSEWHERE = (100.0, 180.0), 220.0  # rad/s
HALF = np.linspace(30.0, 400.0, 20)
FREQUENCY = np.linspace(30.0, 400.0, 40)
WHERE = {"force_plane": "disk", "plane": "journal"}
LEVEL, NOISE = 0.95, 0.02
CHANGE = "speed[lam]"
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A kind of noise, or of what the model takes as known.

    Attributes:
        given: whether sigma is given with the data.
        share: noise in proportion to the response, in place of equal noise.
        runs: standard deviation of K0 and D from run to run, as a share.
        assumed: what is taken as known, and its standard uncertainty.
        posterior: whether predicted from draws of the posterior.
    """

    given: bool = True
    share: bool = False
    runs: float = 0.0
    assumed: tuple[str, float] | None = None
    posterior: bool = False


CASES = {
    "equal noise, given": Case(),
    "equal noise": Case(given=False),
    "noise 2 % of the response": Case(given=False, share=True),
    "equal noise, given; posterior": Case(posterior=True),
    "oil 1 % from run to run, 12 runs": Case(runs=0.01),
    "Mf taken as known, +- 0.1 kg": Case(assumed=("Mf", 0.1)),
    "lam changes by +- 3 % at twice the speed": Case(assumed=(CHANGE, 0.03)),
}


def noisy(exact: Complex, plane: str, case: Case, rng: np.random.Generator) -> tuple[Complex, NDArray[np.float64]]:
    """Readings of a sweep, and their standard deviation."""
    sigma = NOISE * np.abs(exact) if case.share else np.full(exact.size, level_of(plane))
    return exact + sigma * (rng.normal(size=exact.size) + 1j * rng.normal(size=exact.size)), sigma


def response(values: Mapping[str, float], w: NDArray[np.float64], speed: float, plane: str, forced: str) -> Complex:
    """Response to 1 N by the model's own matrices."""
    at, force = (MODEL.coordinate(name, "z") for name in (plane, forced))
    return np.linalg.inv(MODEL.dynamic_stiffness(MODEL.vector(values), w, speed))[:, at, force]


@cache
def level_of(plane: str) -> float:
    """Equal noise of the readings of a plane, m."""
    tested = [response(VALUES, HALF, speed, plane, forced) for speed in SPEEDS for forced in MODEL.planes]
    return NOISE * float(np.sqrt(np.mean(np.abs(tested) ** 2)))


def simulated(case: Case, at: Mapping[float, Mapping[str, float]], rng: np.random.Generator) -> rf.PerturbationTest:
    """Twelve runs at the tested speeds."""
    w = np.r_[-HALF[::-1], HALF]
    columns: dict[str, list[NDArray[np.generic]]] = {
        name: [] for name in ("run", "speed", "frequency", "force_plane", "plane", "response", "sigma")
    }
    for number, (speed, forced) in enumerate((s, p) for s in SPEEDS for p in MODEL.planes for _ in range(3)):
        oil = 1 + case.runs * rng.normal()
        values = {**at[speed], "K0": at[speed]["K0"] * oil, "D": at[speed]["D"] * oil}
        for plane in MODEL.planes:
            read, sigma = noisy(response(values, w, speed, plane, forced), plane, case, rng)
            row = (f"r{number}", speed, w, forced, plane, read, sigma if case.given else np.nan)
            for name, value in zip(columns, row, strict=True):
                columns[name].append(np.broadcast_to(np.asarray(value), w.shape))
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    return rf.perturbation_test(force=1.0, direction="z", **whole)


def held(band: Band, values: Complex) -> NDArray[np.bool_]:
    """Whether a band holds amplitudes and phases, shape ``(2, N)``."""
    size, middle = np.abs(values), band.phase.mean(axis=1)
    inside = (band.amplitude[:, 0] <= size) & (size <= band.amplitude[:, 1])
    turned = np.abs(np.angle(values * np.exp(-1j * middle)))
    return np.stack([inside, turned <= np.diff(band.phase, axis=1)[:, 0] / 2])


def draw(case: Case, seed: int) -> list[float]:
    """Shares held in one draw: amplitude and phase by points, whole curves, new readings by points and whole."""
    rng = np.random.default_rng(seed)
    at, known, name = dict.fromkeys((*SPEEDS, ELSEWHERE), VALUES), dict(KNOWN), ""
    if case.assumed is not None:
        name, size = case.assumed[0], case.assumed[1] * rng.normal()
        mean = np.mean(SPEEDS)
        if name == CHANGE:
            at = {s: VALUES | {"lam": VALUES["lam"] * (1 + size * (s - mean) / mean)} for s in at}
        else:
            at, known = dict.fromkeys(at, VALUES | {name: VALUES[name] + size}), known | {name: VALUES[name]}
    test = simulated(case, at, rng)
    fit = rf.fit(MODEL, test, known=known, causes=None)
    if case.assumed is not None:
        others = {row.name: 0.0 for row in rf.fit(MODEL, test, known=known).causes}
        fit = rf.fit(MODEL, test, known=known, causes=others | dict([case.assumed]))
    source = fit.sample(seed=seed) if case.posterior else fit
    exact = response(at[ELSEWHERE], FREQUENCY, ELSEWHERE, WHERE["plane"], WHERE["force_plane"])
    reading = noisy(exact, WHERE["plane"], case, rng)[0]
    keywords = {**WHERE, "level": LEVEL}
    each, whole = (source.predict(FREQUENCY, ELSEWHERE, whole=choice, **keywords) for choice in (False, True))
    inside, new = held(each.band, exact), held(each.band_new, reading)[0]
    return [*inside.mean(axis=1), held(whole.band, exact).all(), new.mean(), held(whole.band_new, reading)[0].all()]


def main() -> int:
    """Draw, count, write, judge."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--draws", type=int, default=200)
    draws = arguments.parse_args().draws
    rows, bad = [], []
    for name, case in CASES.items():
        shares = np.array([draw(case, seed) for seed in range(draws)], dtype=float)
        mean, error = shares.mean(axis=0), shares.std(axis=0, ddof=1) / np.sqrt(draws)
        rows.append((name, *(f"{100 * m:.1f} +- {100 * e:.1f} %" for m, e in zip(mean, error, strict=True))))
        print(" | ".join(rows[-1]), flush=True)
        if name.startswith("equal noise"):
            bad += [name] * bool(((mean + 3 * error < 0.93) | (mean - 3 * error > 0.97)).any())
    lines = [
        "# Bands of predictions",
        "",
        f"`python benchmarks/prediction_bands.py --draws {draws}` on {environment('casadi', 'numpy', 'scipy')}. "
        "Share of 95 % bands that hold the truth, and readings of a new run, at 220 rad/s, tested at 100 and 180.",
        "",
        *table(("case", "amplitude", "phase", "whole curve", "new reading", "new curve"), rows),
        "",
        "Where runs differ, a new run is further from the mean than the band of a new reading: predictions say so.",
    ]
    (RESULTS / "prediction_bands.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
