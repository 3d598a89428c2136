"""All options of an identification: those of a fit, of the model, and of what follows the fit.

The command line, studies and the report's "To reproduce" read them from here. A new option of a fit is a field of
:class:`~rotorfit.identify.fitting.settings.FitOptions`, any other a field of :class:`StudyOptions`; its kind of value
follows from its type (:data:`rotorfit.identify.options.kinds.KINDS`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from rotorfit.identify.fitting.settings import FitOptions, option
from rotorfit.identify.options.kinds import KINDS, Kind, Planes, is_set, written


@dataclass(frozen=True, kw_only=True)
class StudyOptions(FitOptions):
    """Options of the model, of its fit, and of what follows; the names are those of the TOML keys."""

    structure: str = option(
        "", "matrices of a shaft (model known-structure): .mat, .npz, a folder of CSV, a rotor saved by ROSS", "FILE"
    )
    planes: Planes = option(
        (), "the data's plane names, in the model's order; with --structure the node of each, disk=7,journal=14", "A,B"
    )
    fluid: tuple[str, ...] = option((), "planes in the fluid (--structure, chain), or tags of a ROSS rotor", "A,B")
    supports: tuple[str, ...] = option(
        (), "planes on supports that are fitted (--structure), or tags of a ROSS rotor", "A,B"
    )
    magnetic: tuple[str, ...] = option(
        (), "planes in magnetic bearings whose gains and delay are fitted (--structure), or tags of a ROSS rotor", "A,B"
    )
    damping: tuple[str, ...] = option(
        (), "planes with a damper that is fitted (--structure), or tags of a ROSS rotor", "A,B"
    )
    dofs: tuple[str, ...] = option(
        (), "coordinates of a node, if the file of --structure does not give them", "x,y,..."
    )
    blocks: tuple[str, ...] = option((), "structural blocks to include", "A,B")
    two_lam: bool = option(False, "fit lam_D and lam_M instead of one lam")
    orthotropic: tuple[str, ...] = option((), "planes whose supports differ in two directions", "A,B")
    law: str = option("", "law of eccentricity: muszynska, even-polynomial, ...", "NAME")
    clearance_um: float | None = option(None, "radial clearance at the fluid, for a law", "UM")
    laws: tuple[str, ...] = option(
        (),
        "laws of eccentricity to rank by AIC and BIC, the best one is fitted: muszynska,collapse; or all",
        "A,B",
    )
    probes: Mapping[str, Mapping[str, float]] = option(
        {}, "probe between planes, as shares of their motion; its factor beta can be freed", "NAME=0.6*disk+0.4*journal"
    )
    modes: int = option(0, "modes of the model modal", "N")
    gains: str = option("", "modal: a complex gain for each probe, or for each plane", "KIND")
    apart: bool = option(False, "modal: x and y have natural frequencies and damping ratios of their own")
    residuals: bool | None = option(
        None, "modal: terms of modes outside the band, yes or no [where they lower BIC]", "yes|no"
    )
    runout_um: float | None = option(
        None,
        "plausible run-out; with it 1x and 2x of recordings give unbalance and side load (anisotropic-shaft)",
        "UM",
    )
    operating: bool = option(
        False, "recordings are of a machine in operation that turbulence shakes, without an exciter"
    )
    undo: tuple[str, ...] = option((), "errors of the data to correct, by the names in their findings", "A,B")
    refine: bool = option(False, "add structural blocks that the data support (AIC)")
    despite_errors: bool = option(False, "refine although the check finds an error of the data")
    baseline: str = option(
        "", "dry run of the rig, whose dynamic stiffness is taken out; it is read like the first test file", "FILE"
    )
    calibration: Mapping[str, float | Mapping[str, float]] = option(
        {}, "systematic uncertainty: probe_gain=0.01, probe_phase_deg=0.5, mr=0.005, keyphasor_deg=1", "NAME=VALUE"
    )
    profile: tuple[str, ...] = option((), "profile likelihoods: lam,D,threshold_speed", "A,B")
    bootstrap: int = option(0, "simulate and fit N tests", "N")
    sample: bool = option(False, "draw from the posterior with emcee; needs some seconds")
    seed: int | None = option(None, "seed of the random numbers; the same seed gives the same draws", "N")
    ess: float = option(4000.0, "effective samples to reach", "ESS")
    max_steps: int = option(20_000, "largest number of steps", "N")


@dataclass(frozen=True, kw_only=True)
class Option:
    """One option as the command line and TOML files have it."""

    name: str  # field of :class:`StudyOptions` and key of the TOML file
    kind: Kind  # how its value is read and written
    help: str  # what it does, for ``--help``
    metavar: str | None  # what stands behind it on the command line
    word: str  # its name there


FIT: Mapping[str, Option] = {
    f.name: Option(
        name=f.name,
        kind=KINDS[str(f.type)],
        help=f.metadata["help"],
        metavar=f.metadata["metavar"] or None,
        word=f.metadata["word"] or "--" + f.name.replace("_", "-"),
    )
    for f in fields(StudyOptions)
}
"""Options of ``rotorfit fit`` and of a study, by name."""
SHAFT = ("structure", "fluid", "supports", "magnetic", "damping", "dofs")
"""Options of a shaft from a file."""
MODEL = (*SHAFT, "planes", "blocks", "two_lam", "orthotropic", "probes")
LAW = ("law", "clearance_um")
PARAMETERS = ("known", "bounds", "priors", "start")
SEARCH = ("bounds", "priors", "start", "loss", "method", "max_iterations")
UNCERTAINTY = ("calibration", "causes", "profile", "bootstrap", "sample", "seed", "ess", "max_steps")


def command_words(settings: Mapping[str, Any]) -> list[str] | None:
    """Words of ``rotorfit fit`` that say some settings; ``None`` where the command line cannot."""
    found: list[str] = []
    for name, item in FIT.items():
        if name not in settings or not is_set(settings[name], item.kind):
            continue
        said = written(item.kind, item.word, settings[name])
        if said is None:
            return None
        found += said
    return found
