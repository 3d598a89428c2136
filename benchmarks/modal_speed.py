"""Modes of many channels: how long, in how much memory and how well, beside vector fitting and a fit by hand?

    python benchmarks/modal_speed.py [--rivals PYTHON]

Each way runs in a process of its own, on the same responses: ``rf.fit`` with its errors and its study of residuals,
scikit-rf's vector fitting (poles and residues, no errors; ``--rivals`` names a Python that has it), and a variable
projection by hand, SciPy's ``least_squares`` on frequencies and dampings with the gains of each channel solved inside,
from scikit-rf's way of starting: poles spread over the band. Times are processor times of the last of three fits. The
error is the rms of the estimates' over the standard errors that the noise allows (Cramer-Rao), one at best.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reporting import RESULTS, environment, table

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
CASES = ((12, 6, 400), (25, 6, 800))


def structure(channels: int, modes: int, lines: int, seed: int = 0, noise: float = 0.02) -> dict[str, Any]:
    """A random structure forced at its first channel: responses with noise of a share of each channel's rms."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.linspace(10.0, 200.0, lines)
    wn = 2 * np.pi * np.linspace(20.0, 190.0, modes) * (1 + rng.uniform(-0.1, 0.1, modes) / modes)
    zeta = rng.uniform(0.03, 0.12, modes) / modes
    gains = rng.normal(size=(channels, modes)) + 0.2j * rng.normal(size=(channels, modes))
    gains[0] = 1.0
    H = gains / rng.uniform(1.0, 3.0, modes) @ (1 / (wn[:, None] ** 2 - w**2 + 2j * zeta[:, None] * wn[:, None] * w))
    sigma = noise * np.sqrt(np.mean(np.abs(H) ** 2, axis=1, keepdims=True)) * np.ones(lines)
    measured = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return {"w": w, "H": measured, "exact": H, "sigma": sigma, "wn": wn, "zeta": zeta}


def bound(case: dict[str, Any]) -> Float:
    """Standard errors of frequencies and dampings that the noise allows, the gains of all channels free."""
    poles = np.concatenate([case["wn"], case["zeta"]])
    steps = 1e-6 * poles
    columns = []
    for i, step in enumerate(steps):
        ends = [_left(poles + sign * step * (np.arange(poles.size) == i), case, case["exact"]) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(np.array(columns) @ np.array(columns).T))))


def _left(poles: Float, case: dict[str, Any], H: Complex) -> Float:
    """What gains of each channel by linear least squares leave of responses, whitened, as real numbers."""
    wn, zeta = np.split(poles[:, None], 2)
    basis = (1 / (wn**2 - case["w"] ** 2 + 2j * zeta * wn * case["w"])).T
    parts = []
    for row, sigma in zip(H, case["sigma"], strict=True):
        own = basis / sigma[:, None]
        left = np.linalg.qr(own)[0]
        value = row / sigma
        parts.append((value - left @ (left.conj().T @ value)).view(float))
    return np.concatenate(parts)


def by_rotorfit(case: dict[str, Any]) -> Callable[[], Float]:
    """``rf.fit``."""
    import rotorfit as rf

    channels, lines = case["H"].shape
    names = [f"s{i}" for i in range(channels)]
    test = rf.perturbation_test(
        run="tap", speed=0.0, force_plane="s0", force=1.0, force_direction="x", direction="x",
        plane=np.repeat(names, lines), frequency=np.tile(case["w"], channels), response=case["H"].ravel(),
        sigma=case["sigma"].ravel(),
    )  # fmt: skip
    modes = case["wn"].size
    model = rf.models.Modal(names, modes=modes, gains="plane", force_planes=("s0",))

    def fit() -> Float:
        found = rf.fit(model, test)
        if not found.success:
            raise RuntimeError(found.message)
        return np.array([found.params[f"{name}{i + 1}"].value for name in ("wn", "zeta") for i in range(modes)])

    return fit


def by_scikit_rf(case: dict[str, Any]) -> Callable[[], Float]:
    """Vector fitting of a network of as many ports as hold the channels, the last ones repeated."""
    import skrf  # type: ignore[import-not-found]
    from skrf.vectorFitting import VectorFitting  # type: ignore[import-not-found]

    channels, lines = case["H"].shape
    ports = int(np.ceil(np.sqrt(channels)))
    cells = np.resize(np.arange(channels), ports**2)
    s = (case["H"][cells].T / np.abs(case["H"]).max()).reshape(lines, ports, ports)
    frequency = skrf.Frequency.from_f(case["w"] / (2 * np.pi), unit="hz")

    def fit() -> Float:
        found = VectorFitting(skrf.Network(frequency=frequency, s=s))
        found.vector_fit(
            n_poles_real=0, n_poles_cmplx=case["wn"].size, fit_constant=False, fit_proportional=False, enforce_dc=False
        )
        poles = found.poles[np.argsort(np.abs(found.poles))]
        return np.concatenate([np.abs(poles), -poles.real / np.abs(poles)])

    return fit


def by_hand(case: dict[str, Any]) -> Callable[[], Float]:
    """Variable projection by hand, from frequencies half a percent off and dampings a fifth off."""
    from scipy.optimize import least_squares

    start = np.concatenate([case["wn"] * 1.005, case["zeta"] * 1.2])

    def fit() -> Float:
        return np.asarray(least_squares(_left, start, x_scale=start, method="lm", args=(case, case["H"])).x)

    return fit


WAYS = {"rotorfit": by_rotorfit, "scikit-rf": by_scikit_rf, "by hand": by_hand}


def run(way: str, channels: int, modes: int, lines: int) -> dict[str, float]:
    """Time, memory and error of one way."""
    case = structure(channels, modes, lines)
    fit = WAYS[way](case)
    for _ in range(3):
        begin = time.process_time()
        found = fit()
        spent = time.process_time() - begin
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    off = np.full(1, np.nan)
    if found.size == 2 * modes:
        off = (found - np.concatenate([case["wn"], case["zeta"]])) / bound(case)
    return {"time": spent, "memory": memory, "error": float(np.sqrt(np.mean(off**2)))}


def main() -> None:
    """Make the table of results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rivals", default=sys.executable, help="Python that has scikit-rf")
    parser.add_argument("--run", nargs=4, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=RESULTS / "modal_speed.md")
    given = parser.parse_args()
    if given.run:
        print(json.dumps(run(given.run[0], *map(int, given.run[1:]))))
        return
    rows = []
    for case in CASES:
        for way in WAYS:
            python = given.rivals if way == "scikit-rf" else sys.executable
            command = [python, __file__, "--run", way, *map(str, case)]
            said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            own = json.loads(said.splitlines()[-1])
            size = " x ".join(map(str, case))
            rows.append(
                [
                    size,
                    way,
                    f"{own['time']:.3f}",
                    f"{own['memory']:.0f}",
                    f"{own['error']:.2f}".replace("nan", "other number of poles"),
                ]
            )
            print(*rows[-1], flush=True)
    head = ["channels x modes x lines", "way", "processor time, s", "most memory, MB", "rms error over its bound"]
    title = f"`benchmarks/modal_speed.py`: {environment('numpy', 'scipy')}; scikit-rf 2.2.0."
    text = "\n".join(["# Modes of many channels", "", title, "", *table(head, rows), ""])
    given.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
