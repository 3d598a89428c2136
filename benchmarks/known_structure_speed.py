"""What a line costs where the shaft is known but for a scale factor, beside a model reduced by hand, and how exact.

A shaft of finite elements with disk and journal, 200 lines at two speeds, all four responses, 1 % noise; the factor on
its stiffness is fitted with the fluid. "exact": all inner coordinates eliminated at every line, as before there was a
reduction. "by hand": the same structure after Craig and Bampton, given as matrices, with as few inner modes as keep the
predictions within 1e-3 of the noise. Times are processor times of one evaluation of all predictions and their
derivatives at a new factor, over the lines, medians of turns. Errors are those of predictions against "exact", over the
noise, at a factor of 1.05.

    python benchmarks/known_structure_speed.py
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "rigs"))
from beams import shaft
from reporting import RESULTS, environment, table

import rotorfit as rf
from rotorfit.identify.fitting.notices import structure_error
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.models import KnownStructure

ELEMENTS = (30, 60, 100, 200, 300)
LINES = 200
SPEEDS = (105.0, 210.0)
TRUTH = {"Ds": 3.0, "K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35, "E_scale": 0.98}
TURNS = 9


@dataclass(frozen=True, kw_only=True)
class Row:
    """One size of structure; times in microseconds a line, builds and fits in seconds."""

    coordinates: int
    kept: int
    by_hand: int
    build: float
    reduced: float
    hand: float
    exact: float
    error_reduced: float
    error_hand: float
    fit: float
    fit_hand: float
    stated: str


def matrices(elements: int) -> tuple[dict[str, Any], Any, dict[str, int]]:
    """M, G, K, the shaft's own K, and the nodes of the planes."""
    K, M, G = shaft(0.42, elements, 0.01, 2.11e11, 8.12e10, 7810.0)
    alone = K.copy()
    planes = {"disk": elements // 2, "journal": round(elements * 6 / 7)}
    for plane, mass, tilt in (("disk", 0.8, 7.5e-4), ("journal", 0.2, 3e-5)):
        at = 2 * planes[plane]
        M[at, at] += mass
        M[at + 1, at + 1] += tilt / 2
        G[at + 1, at + 1] += tilt
    K[0, 0] += 5e7
    K[2 * planes["journal"], 2 * planes["journal"]] += 6000.0
    return {"M": M, "G": G, "K": K}, alone, planes


def by_hand(given: dict[str, Any], alone: Any, planes: dict[str, int], count: int) -> tuple[dict[str, Any], Any]:
    """Craig and Bampton: the planes, and the modes of the rest with the planes held."""
    seen = np.array([2 * node for node in planes.values()])
    inner = np.setdiff1d(np.arange(len(given["K"])), seen)
    K, M = given["K"][np.ix_(inner, inner)], given["M"][np.ix_(inner, inner)]
    root = np.linalg.inv(np.linalg.cholesky(M))
    modes = root.T @ np.linalg.eigh(root @ K @ root.T)[1][:, :count]
    T = np.zeros((len(given["K"]), seen.size + modes.shape[1]))
    T[seen, np.arange(seen.size)] = 1.0
    T[inner, : seen.size] = -np.linalg.solve(K, given["K"][np.ix_(inner, seen)])
    T[inner, seen.size :] = modes
    return {kind: T.T @ matrix @ T for kind, matrix in given.items()}, T.T @ alone @ T


def model_of(given: dict[str, Any], alone: Any, planes: dict[str, int], dofs: tuple[str, ...]) -> KnownStructure:
    """The rotor to fit."""
    return KnownStructure(
        given["M"], None, given["G"], given["K"], planes=planes, fluid="journal", damping="disk",
        scales={"E_scale": {"K": alone}}, dofs=dofs,
    )  # fmt: skip


def measured(model: KnownStructure) -> Any:
    """Readings of a rotor with 1 % noise."""
    half = np.linspace(10.0, 520.0, LINES // 4)
    w, rng, parts = np.r_[-half[::-1], half], np.random.default_rng(1), []
    for speed in SPEEDS:
        pieces = [w[i : i + 20] for i in range(0, w.size, 20)]  # few lines at a time are condensed exactly
        receptance = np.concatenate([model.receptance(model.vector(TRUTH), piece, speed) for piece in pieces])
        for column, force_plane in enumerate(model.planes):
            for row, plane in enumerate(model.planes):
                z = 10.0 * receptance[:, row, column]
                sigma = 0.01 * float(np.sqrt(np.mean(np.abs(z) ** 2)))
                noisy = z + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                run = f"{force_plane} {speed:g}"
                columns = {
                    "force_plane": force_plane, "plane": plane, "response": noisy, "sigma": sigma, "frequency": w,
                    "speed": speed, "run": run,
                }  # fmt: skip
                parts.append({name: np.broadcast_to(value, w.shape) for name, value in columns.items()})
    data = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return rf.perturbation_test(**data, force=10.0, direction="z")


def clock(work: Any) -> float:
    """Processor time of some work, seconds."""
    start = time.process_time()
    work()
    return time.process_time() - start


def compare(elements: int) -> Row:
    """Measure one size of structure."""
    given, alone, planes = matrices(elements)
    model = model_of(given, alone, planes, ("z", "r"))
    test = measured(model)
    settings = FitSettings(known={"E_scale": None})
    problem = build_problem(model, test, settings)
    x = np.array([TRUTH[name] for name in problem.space.names])
    place = problem.space.names.index("E_scale")
    x[place] = 1.05
    first = clock(lambda: problem.jacobian(x))  # makes the reduced structure
    shaft_ = model.shaft
    few = slice(0, LINES, 8)
    block = problem.blocks[0]
    keep = np.zeros(block.frequency.size, dtype=bool)
    keep[few] = True
    rows = keep[block.line]
    exact = (block.lines(keep).predict(problem.space.theta(x)) - block.measured[rows]) / block.sigma[rows]
    error = float(np.abs(problem.residuals(x)[: rows.size][rows] - exact).max())
    for count in range(1, 40):
        small, small_alone = by_hand(given, alone, planes, count)
        hand = model_of(small, small_alone, {"disk": 0, "journal": 1}, ("z",))
        problem_by_hand = build_problem(hand, test, settings)
        error_hand = float(np.abs(problem_by_hand.residuals(x)[: rows.size][rows] - exact).max())
        if error_hand < 1e-3:
            break
    times: list[list[float]] = [[], []]
    for turn in range(TURNS):
        x[place] = 1.05 + 1e-4 * (turn + 1)
        for each, list_ in zip((problem, problem_by_hand), times, strict=True):
            list_.append(clock(lambda each=each: each.jacobian(x)))
    s, speed = block.s[few], block.speed[few]
    full = clock(lambda: shaft_.terms.condense(s, speed, np.full((s.size, 1), 1.07))) / s.size
    lines = sum(b.frequency.size for b in problem.blocks)
    reduced, by = (float(np.median(list_)) for list_ in times)
    fits = []
    result = None
    for each in (model_of(given, alone, planes, ("z", "r")), hand):
        start = time.process_time()
        fit = rf.fit(each, test, known={"E_scale": None})
        fits.append(time.process_time() - start)
        result = result or fit
    assert result is not None
    stated = structure_error(result)
    return Row(
        coordinates=shaft_.terms.size,
        kept=max(r.size for r in shaft_.reductions) if shaft_.reductions else shaft_.terms.size,
        by_hand=len(small["K"]),
        build=first - reduced,
        reduced=1e6 * reduced / lines,
        hand=1e6 * by / lines,
        exact=1e6 * (full + by / lines),
        error_reduced=error,
        error_hand=error_hand,
        fit=fits[0],
        fit_hand=fits[1],
        stated="-" if stated is None else f"{stated.over_noise:.0e}",
    )


def main() -> None:
    """Measure all sizes and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", type=int, nargs="*", default=ELEMENTS)
    options = parser.parse_args()
    compare(30)  # imports, first uses
    rows = [compare(elements) for elements in options.elements]
    head = [
        "coordinates", "kept", "by hand", "us a line", "by hand", "exact", "over by hand", "error / noise",
        "by hand", "stated by the fit", "reducing, s", "fit, s", "by hand",
    ]  # fmt: skip
    cells = [
        [
            str(r.coordinates), str(r.kept), str(r.by_hand), f"{r.reduced:.1f}", f"{r.hand:.1f}", f"{r.exact:.0f}",
            f"{r.reduced / r.hand:.2f}", f"{r.error_reduced:.0e}", f"{r.error_hand:.0e}", r.stated, f"{r.build:.2f}",
            f"{r.fit:.2f}", f"{r.fit_hand:.2f}",
        ]
        for r in rows
    ]  # fmt: skip
    words = str(__doc__).partition("\n\n")[2].partition("\n\n    python")[0]
    text = [
        "# Known structure with a fitted factor", "",
        f"Made by `python benchmarks/known_structure_speed.py` on {environment('numpy')}.", "", words, "",
        *table(head, cells),
    ]  # fmt: skip
    print("\n".join(text[6:]))
    if tuple(options.elements) == ELEMENTS:
        (RESULTS / "known_structure_speed.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
