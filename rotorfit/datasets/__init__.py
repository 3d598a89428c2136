"""Data sets that come with rotorfit: simulated rigs with their truth, and published numbers."""

from __future__ import annotations

import json
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, cast

import numpy as np

from rotorfit.base.names import unknown_name
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.kinds.coefficient_table import CoefficientTable

__all__ = [
    "names", "operation", "path", "published_two_disk", "rig_lumped", "rig_open", "rk4", "rk4_runup",
    "seal_muszynska_tum", "truth", "two_disk", "volts",
]  # fmt: skip


def names() -> tuple[str, ...]:
    """Names of the data files."""
    return tuple(sorted(p.name for p in files(__name__).iterdir() if p.name.endswith((".csv", ".json", ".h5"))))


def path(name: str) -> Path:
    """Path of a data file."""
    if name not in names():
        raise FileNotFoundError(unknown_name("data set", name, names()))
    with as_file(files(__name__) / name) as found:
        return found


def truth(name: str) -> dict[str, Any]:
    """True values of a simulated rig, for instance ``truth("rig_open")``."""
    loaded: dict[str, Any] = json.loads(path(f"{name}.truth.json").read_text())
    return loaded


def _read(file: Path) -> PerturbationTest:
    from rotorfit.lab.io.files import read

    return cast("PerturbationTest", read(file, kind=PerturbationTest))


def __dir__() -> list[str]:
    return __all__


def rig_open() -> PerturbationTest:
    """Disk/journal rig in a fluid-lubricated bearing, 56-degree-of-freedom finite-element rotor, 1 % noise."""
    return _read(path("rig_open.csv"))


def rig_lumped() -> PerturbationTest:
    """Disk/journal rig in a fluid-lubricated bearing, two masses as in eq. (18), 1 % noise."""
    return _read(path("rig_lumped.csv"))


def two_disk() -> PerturbationTest:
    """Two-disk rotor, synchronous start-ups with a calibration weight at 0 and 180 degrees in each plane."""
    return _read(path("two_disk.csv"))


def published_two_disk() -> dict[str, float]:
    """Printed results of the paper's two-disk rotor: masses, springs, and mass, stiffness, damping and shape of modes.
    The rig of :func:`two_disk` was simulated with these masses and springs."""
    rows = path("base_paper_two_disk.csv").read_text().splitlines()[2:]
    return {name: float(value) for name, value, _ in (row.split(",") for row in rows)}


def rk4() -> PerturbationTest:
    """Measured 1x vectors of a Bently Nevada RK-4 rotor kit: known weights on two disks, mounted again and again.
    Source and licence: ``rk4_LICENSE.txt`` beside the file."""
    return _read(path("rk4_sync.csv"))


def rk4_runup() -> PerturbationTest:
    """Measured run-up of the same kit through its first critical speed: one probe, unbalance unknown (1 g mm)."""
    return _read(path("rk4_runup.csv"))


def volts() -> list[Path]:
    """Files of raw signals: sweeps of 10 s of a perturbator at disk and journal, both ways, with probes and Keyphasors.
    They were made as ``truth("volts")`` says; :func:`rotorfit.read_recording` opens one."""
    return [path(f"volts_{plane}-{way}.h5") for plane in ("disk", "journal") for way in ("fwd", "bwd")]


def operation() -> Path:
    """File of raw signals of a rotor in operation: 90 s at 2400 rpm, two planes, shaken by its turbulent flow. It was
    made as ``truth("operation")`` says; :func:`rotorfit.read_recording` opens it."""
    return path("operation.h5")


def seal_muszynska_tum() -> CoefficientTable:
    """Computed coefficients of two seals over speed and eccentricity, six digits, of Muszynska's form. A run is one
    seal at one speed."""
    file = path("seal_muszynska_tum_computed.csv")
    seal, eps, rpm, kxx, kxy, cxx, cxy, mxx = np.loadtxt(file, delimiter=",", skiprows=3).T
    run = np.array([f"seal {s:g} at {n:g} rpm" for s, n in zip(seal.tolist(), rpm.tolist(), strict=True)])
    half_digit = 0.5e-5 / np.sqrt(3)  # rounding to six digits: uniform, at most half of the last one
    return CoefficientTable(
        run=run,
        speed=rpm * RAD_S_PER_RPM,
        eccentricity=eps,
        kxx=kxx,
        kxy=kxy,
        cxx=cxx,
        cxy=cxy,
        mxx=mxx,
        sigma=np.full(eps.size, half_digit),
        attributes={"seal": seal},
        source=file.name,
    )
