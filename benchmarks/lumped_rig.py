"""The bundled rig of two masses, ``rig_lumped.csv``: real equations of x and y, none of the code of rotorfit.

    python benchmarks/lumped_rig.py

writes the data and their truth anew, to the last digit.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

DATASETS = Path(__file__).parent.parent / "rotorfit" / "datasets"
RIG = {
    "Md": 1.0, "Ds": 4.0, "K1": 16e3, "K2": 24e3, "Mb": 0.3, "K3": 6e3, "K0": 10e3, "D": 450.0, "lam": 0.475, "Mf": 0.35
}  # fmt: skip
SPEEDS_RPM, LINES, HIGHEST_RPM = (1000.0, 2000.0), 60, 3600.0
UNBALANCE_KG_M = {"disk": 1.5e-4, "journal": 1.5e-4}
NOISE = 0.01
"""Of each part of a reading, over the rms amplitude of its sweep."""


def matrices(p: dict[str, float], speed: float) -> tuple[NDArray[np.float64], ...]:
    """Mass, damping and stiffness of (x disk, y disk, x journal, y journal), N and m."""
    turn = p["lam"] * speed
    mass = np.diag([p["Md"], p["Md"], p["Mb"] + p["Mf"], p["Mb"] + p["Mf"]])
    damping = np.diag([p["Ds"], p["Ds"], p["D"], p["D"]])
    damping[2, 3], damping[3, 2] = 2 * p["Mf"] * turn, -2 * p["Mf"] * turn
    journal = p["K2"] + p["K3"] + p["K0"] - p["Mf"] * turn**2
    stiffness = np.diag([p["K1"] + p["K2"], p["K1"] + p["K2"], journal, journal])
    for i in (0, 1):
        stiffness[i, i + 2] = stiffness[i + 2, i] = -p["K2"]
    stiffness[2, 3], stiffness[3, 2] = p["D"] * turn, -p["D"] * turn
    return mass, damping, stiffness


def is_stable(p: dict[str, float], speed: float) -> bool:
    """True if free motion dies out."""
    mass, damping, stiffness = matrices(p, speed)
    inverse, nothing = np.linalg.inv(mass), np.zeros((4, 4))
    state = np.block([[nothing, np.eye(4)], [-inverse @ stiffness, -inverse @ damping]])
    return bool(np.linalg.eigvals(state).real.max() < 0)


def threshold(p: dict[str, float]) -> float:
    """Speed at which it no longer does, rad/s, by halving."""
    low, high = 0.0, 2000.0
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if is_stable(p, middle) else (low, middle)
    return low


def sweep(speed: float, frequency: NDArray[np.float64], plane: str, angle: float) -> tuple[NDArray[np.complex128], ...]:
    """Forces and phasors of the four probes, relative to exp(+j |w| t), of a force that turns with the sign of w."""
    mass, damping, stiffness = matrices(RIG, speed)
    size = np.abs(frequency)
    force = UNBALANCE_KG_M[plane] * size**2 * np.exp(1j * angle)
    at = 0 if plane == "disk" else 2
    drive = np.zeros((size.size, 4), dtype=complex)
    drive[:, at] = force
    drive[:, at + 1] = np.where(frequency > 0, -1j, 1j) * force
    s = 1j * size[:, None, None]
    return force, np.linalg.solve(mass * s**2 + damping * s + stiffness, drive[..., None])[..., 0]


def main() -> None:
    """Write both files."""
    rng = np.random.default_rng(2026)
    lines = [
        "# disk and journal as two masses, in a fluid-lubricated bearing; unbalance-type circular force m r w^2",
        "# amplitudes 0-peak; phases lead, relative to exp(+j|w|t); negative frequency = backward whirl",
        "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg",
    ]
    rpm = 30 / np.pi
    for rotative in SPEEDS_RPM:
        for plane in ("disk", "journal"):
            for way, sign in (("fwd", 1.0), ("bwd", -1.0)):
                frequency = sign * np.linspace(60.0, HIGHEST_RPM, LINES) / rpm
                force, phasors = sweep(rotative / rpm, frequency, plane, np.deg2rad(rng.uniform(-180, 180)))
                spread = NOISE * np.sqrt(np.mean(np.abs(phasors) ** 2, axis=0))
                phasors = phasors + spread * (rng.normal(size=phasors.shape) + 1j * rng.normal(size=phasors.shape))
                for w, f, row in zip(frequency * rpm, force, phasors, strict=True):
                    for probe, value in zip(("disk,x", "disk,y", "journal,x", "journal,y"), row, strict=True):
                        driven = f"{plane},{abs(f):.7g},{np.rad2deg(np.angle(f)):.4f}"
                        read = f"{probe},{1e6 * abs(value):.6g},{np.rad2deg(np.angle(value)):.4f}"
                        lines.append(f"{plane}-{way}-{rotative:.0f},{rotative:.0f},{w:.6f},{driven},{read}")
    (DATASETS / "rig_lumped.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    truth = {"params": {**RIG, "sigma": 1.0}, "threshold_rpm": threshold(RIG) * rpm, "noise": NOISE}
    (DATASETS / "rig_lumped.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
