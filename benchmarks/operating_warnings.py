"""Is a reader warned of operating vibration that is not what a fit takes it for: random draws of five faults.

- hump: another structure's mode makes the force five times as strong within 4 Hz, at 0.6 of the whirl's frequency;
- low-pass: the force falls from a corner at 0.6 of the whirl's frequency, which no assumed spectrum has;
- anisotropy: stiffness in x and y differ by 1 %, of the compressor alone;
- whip: motion is mostly whirl on an orbit that stays, as beyond the threshold;
- order: 1x is left in, its peak 20 times the level about it.

Rows without a fault give false warnings. Rotors are those of ``operating_vibration.py``.

    python benchmarks/operating_warnings.py [--draws 12] [--minutes 5] [--seed 1] [fault ...]
"""

from __future__ import annotations

import argparse
from time import process_time

import numpy as np
from operating_coverage import normal
from operating_vibration import ROTORS, Rotor, modes
from reporting import table
from scipy.fft import ifft, next_fast_len

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray
from rotorfit.estimators.signals.cells import averaged
from rotorfit.lab.kinds.operating_test import OperatingTest, operating_test

FAULTS = {"none": ROTORS, "hump": ROTORS, "low-pass": ROTORS, "anisotropy": ROTORS[2:], "order": ROTORS}
TOP = {"one mode": 60.0, "whirl-whip": 60.0, "compressor": 180.0}  # Hz, of the band


def motion(rotor: Rotor, fault: str, minutes: float, rng: np.random.Generator) -> tuple[ComplexArray, float]:
    """Motion of the planes, shape ``(n, N)``, and its rate, Hz."""
    rate = 4 * TOP[rotor.name]
    count = int(60 * minutes * rate)
    size = next_fast_len(2 * count)
    f = np.fft.fftfreq(size, 1 / rate)
    planes = rotor.model.planes
    whirl = abs(modes(rotor)[0].imag) / (2 * np.pi)
    shape = np.ones(size)
    if fault == "hump":
        shape += 4 * (np.abs(np.abs(f) - 0.6 * whirl) < 2)
    if fault == "low-pass":
        shape /= 1 + (f / (0.6 * whirl)) ** 2
    force = normal(rng, size, len(planes)) * np.sqrt(shape * rotor.level**2)[:, None]
    h = rotor.model.receptance(rotor.model.vector(rotor.values), 2 * np.pi * f, rotor.speed)
    back = (-np.arange(size)) % size  # places of -f
    if fault == "anisotropy":  # kappa z(w) + dK conj z(-w) = F(w)
        kappa, dK = 1 / h[:, 0, 0], 0.005 * rotor.values["K"]
        other = kappa[back].conj()
        z = ((other * force[:, 0] - dK * force[back, 0].conj()) / (kappa * other - dK**2))[:, None]
    else:
        z = np.einsum("fij,fj->fi", h, force)
    if fault == "order":
        line = int(np.argmin(np.abs(f - rotor.speed / (2 * np.pi))))
        z[line] = 20 * np.sqrt(np.mean(np.abs(z[line - 50 : line + 50]) ** 2, axis=0)) * np.sqrt(size * 0.25 / rate)
    x = ifft(z, axis=0)[:count].T * np.sqrt(size * rate)
    clean = averaged(x, rate, band=(1.0, TOP[rotor.name]), width=0.5)
    peaks = np.einsum("cii->ci", clean.power).real.max(axis=0).reshape(2, -1).max(axis=0)
    return x + np.sqrt(1e-3 * peaks * rate)[:, None] * normal(rng, len(planes), count), rate


def made(rotor: Rotor, fault: str, minutes: float, rng: np.random.Generator) -> OperatingTest:
    """The test of a record."""
    z, rate = motion(rotor, fault, minutes, rng)
    cells = averaged(z, rate, band=(1.0, TOP[rotor.name]), width=0.25)
    return operating_test("run", rotor.speed, rotor.model.planes, cells, {}, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("faults", nargs="*", default=list(FAULTS))
    given = parser.parse_args()
    lines = []
    for fault in given.faults:
        warned, codes = 0, set()
        for draw in range(given.draws):
            rotor = FAULTS[fault][draw % len(FAULTS[fault])]
            test = made(rotor, fault, given.minutes, np.random.default_rng([given.seed, draw]))
            begin = process_time()
            fit = rf.fit(rotor.model, test, known={name: rotor.values[name] for name in rotor.known}, causes=None)
            own = {one.code for one in fit.findings if one.severity == "warning"}
            warned, codes = warned + bool(own), codes | own
            print(fault, draw, rotor.name, fit.settings.force_spectrum, f"{process_time() - begin:.1f} s", *sorted(own),
                  flush=True)  # fmt: skip
        lines.append([fault, str(given.draws), str(warned), ", ".join(sorted(codes))])
    print("\n".join(table(("fault", "draws", "warned of", "by"), lines)))


if __name__ == "__main__":
    main()
