"""Coverage over families of rotors that no model of rotorfit is: is the answer right, or is what is missing named?

    python benchmarks/rotor_families.py --rigs 40 --seed 20

writes results/rotor_families.md. Every rig is a finite-element shaft (tests/rigs/fe_rigs.py) with one thing changed;
every fit is that of a user: eq. (18), then rf.refine, then fit.causes. A term that every summary names as not
told by the data (external damping at the journal) counts as named in the family that has it only, and only where the
truth lies within the errors once that damping is given as an uncertainty.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import rotorfit as rf
from rotorfit.models import WhirlWhip

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the finite-element rigs live with the tests

from fe_rigs import JOURNAL, K3, RPM, Rig, random_rig  # noqa: E402

NORMAL = 1.96
ASKED = 0.85  # share of rigs
HIGHEST = 5000.0  # frequency, rad/s, up to which modes count for the true threshold
DAMPER, DAMPED = 20.0, "damper at the journal"
BELOW = 0.9  # end of the band over the whirl frequency at onset, in the family whose band falls short of it


def add_mass(rig: Rig, node: int, mass: float) -> None:
    """A disk at another node."""
    rig.M[2 * node, 2 * node] += mass
    rig.M[2 * node + 1, 2 * node + 1] += mass * 4e-4
    rig.G[2 * node + 1, 2 * node + 1] += mass * 8e-4


def second_disk(rig: Rig) -> None:
    """A disk of 0.4 kg between disk and journal."""
    add_mass(rig, 10, 0.4)


def offset_disk(rig: Rig) -> None:
    """A disk of 0.5 kg near the rigid bearing."""
    add_mass(rig, 4, 0.5)


def overhang(rig: Rig) -> None:
    """Transverse and polar inertia at the journal's end, as of an overhung wheel."""
    at = 2 * JOURNAL
    rig.M[at, at] += 0.15
    rig.M[at + 1, at + 1] += 3e-4
    rig.G[at + 1, at + 1] += 6e-4


def damped_support(rig: Rig) -> None:
    """The rigid bearing becomes a spring of 2e5 N/m with a damper of 60 N s/m."""
    rig.K[0, 0] += 2e5 - 5e7
    rig.C[0, 0] += 60.0


def pedestal(rig: Rig) -> None:
    """The rigid bearing becomes a spring of 3e5 N/m, hardly damped."""
    rig.K[0, 0] += 3e5 - 5e7
    rig.C[0, 0] += 2.0


def internal_damping(rig: Rig) -> None:
    """Damping that turns with the shaft, beta K with beta 4e-6 s: beta K (s - j Om)."""
    still, beta = rig.coefficients, 4e-6

    def turning(speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        K, C, M = still(speed)
        shaft = rig.K.copy()
        shaft[0, 0] -= 5e7
        shaft[2 * JOURNAL, 2 * JOURNAL] -= K3
        return K - 1j * speed * beta * shaft, C + beta * shaft, M

    rig.coefficients = turning  # type: ignore[method-assign]


def journal_damper(rig: Rig) -> None:
    """External damping of 20 N s/m at the journal, which the data cannot tell from the fluid's."""
    rig.C[2 * JOURNAL, 2 * JOURNAL] += DAMPER


def nothing(rig: Rig) -> None:
    """The rotor as it is."""


FAMILIES: dict[str, tuple[Callable[[Rig], None], dict[str, float]]] = {
    "as the bundled rig": (nothing, {}),
    "thick shaft, 20 mm": (nothing, {"diameter": 0.020}),
    "second disk": (second_disk, {}),
    "disk near the bearing": (offset_disk, {}),
    "overhung wheel": (overhang, {}),
    "damped flexible support": (damped_support, {}),
    "pedestal": (pedestal, {}),
    "internal damping": (internal_damping, {}),
    DAMPED: (journal_damper, {}),
    "one speed": (nothing, {"speeds": 1}),
    "low speeds": (nothing, {"low": 1}),
    "band short of the onset": (nothing, {"short": 1}),
}


def growth_below(rig: Rig, speed: float) -> float:
    """Growth rate of the modes that a bearing can drive; undamped ones far above only show round-off."""
    s = modes(rig, speed)
    return float(s[np.abs(s) < HIGHEST].real.max())


def modes(rig: Rig, speed: float) -> np.ndarray:
    """Eigenvalues of a rig, 1/s."""
    K, C, M = rig.coefficients(speed)
    upper = np.hstack([np.zeros_like(K), np.eye(len(K))])
    return np.linalg.eigvals(np.vstack([upper, np.hstack([-np.linalg.solve(M, K), -np.linalg.solve(M, C)])]))


def whirl_at(rig: Rig, speed: float) -> float:
    """Frequency of the least stable mode, rad/s."""
    s = modes(rig, speed)
    s = s[np.abs(s) < HIGHEST]
    return abs(float(s[np.argmax(s.real)].imag))


def case(name: str, rng: np.random.Generator, seed: Sequence[int]) -> dict[str, float | bool | str]:
    """One rig of a family: pulls of lam and threshold, and what the fit says of itself; its noise has a seed."""
    change, options = FAMILIES[name]
    while True:
        p, _, speeds, _ = random_rig(rng)
        p |= {key: value for key, value in options.items() if key == "diameter"}
        rig = Rig(**p)
        change(rig)
        rig.growth = lambda speed, rig=rig: growth_below(rig, speed)  # type: ignore[method-assign]
        speeds = RPM * np.array([300.0, 500.0]) if "low" in options else speeds[: 1 if "speeds" in options else 2]
        unstable = [rig.growth(speed) > 0 for speed in np.linspace(20, 1200, 80)]
        if rig.growth(speeds[-1]) < 0 and any(unstable) and not unstable[0]:
            break
    threshold = rig.threshold()
    top = BELOW * whirl_at(rig, threshold) if "short" in options else 520.0
    plain = rf.fit(WhirlWhip(), rig.campaign(speeds, seed, top=top), known={"K3": K3})
    if plain.identifiability.unresolved:
        return {"refused": True}
    refinement = rf.refine(plain)
    best, onset = refinement.best, refinement.best.threshold_speed()
    lam = best.params["lam"]
    covered = [
        abs(lam.value - p["lam"]) < NORMAL * lam.noise, abs(onset.value - threshold) < NORMAL * onset.stderr
    ]  # fmt: skip
    named = bool(best.causes.found or best.causes.warnings) or best.model_limited
    if name == DAMPED:
        told = rf.fit(best.model, best.experiments, known={"K3": K3}, causes={"damper[journal]": DAMPER}).params
        holds = all(abs(told[result].value - p[result]) < NORMAL * told[result].stderr for result in ("lam", "D"))
        named = holds and covered[1] and "damper[journal]" in best.summary()
    return {
        "refused": False,
        "lam": (lam.value - p["lam"]) / lam.noise,
        "printed lam": (lam.value - p["lam"]) / lam.stderr,
        "threshold": (onset.value - threshold) / onset.stderr,
        "relative": abs(onset.value / threshold - 1),
        "plain lam": (plain.params["lam"].value - p["lam"]) / plain.params["lam"].stderr,
        "named": named,
        "covered": all(covered),
        "false stable": bool(np.isnan(onset.value) and not np.isinf(onset.stderr)),
        "structure": "+".join(best.model.blocks),
    }


def main() -> None:
    """Run every family and tabulate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=9)
    options = parser.parse_args()
    lines = [
        "# Families of rotors", "",
        f"Made with `python benchmarks/rotor_families.py --rigs {options.rigs} --seed {options.seed}`: "
        f"{options.rigs} rigs a family.",
        "Covered: share of 95 % intervals that hold the truth, after rf.refine (lam of the plain fit first), by the "
        "noise alone; as printed, with causes. "
        "Named: share of fits whose causes or warnings say that structure is missing. A damper at the journal "
        "cannot be told from the fluid by any data of this kind: the summary says so beside lam and D, the threshold "
        "stays right, and D and lam are named where they hold with that damping given as an uncertainty.", "",
        "| family | lam plain | lam | lam, as printed | threshold | median threshold error | named | "
        "both covered, or named | false stable |",
        "|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    passed, hits, rigs = 0, 0, 0
    for number, name in enumerate(FAMILIES):
        rng = np.random.default_rng([options.seed, number])
        rows = [case(name, rng, (options.seed, number, rig)) for rig in range(options.rigs)]
        told = [row for row in rows if not row["refused"]]

        def share(hits: list[bool], told: list[dict[str, float | bool | str]] = told) -> str:
            return f"{sum(hits)} of {len(told)}"

        def within(key: str, row: dict[str, float | bool | str]) -> bool:
            return bool(abs(float(row[key])) < NORMAL)

        right = [bool(row["covered"] or row["named"]) for row in told]
        hits, rigs = hits + sum(right), rigs + len(told)
        passed += bool(told) and sum(right) >= ASKED * len(told)
        lines.append(
            f"| {name} | {share([within('plain lam', row) for row in told])} | "
            f"{share([within('lam', row) for row in told])} | {share([within('printed lam', row) for row in told])} | "
            f"{share([within('threshold', row) for row in told])} | "
            f"{100 * np.nanmedian([float(row['relative']) for row in told] or [np.nan]):.2g} % | "
            f"{share([bool(row['named']) for row in told])} | {share(right)} | "
            f"{share([bool(row['false stable']) for row in told])} |"
        )
        print(lines[-1], [row.get("structure") for row in told][:2], flush=True)
    lines += [
        "",
        f"Both covered or the missing structure named: {hits} of {rigs} rigs; in {100 * ASKED:.0f} % of a family's: "
        f"{passed} of {len(FAMILIES)} families.",
    ]
    (HERE / "results" / "rotor_families.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
