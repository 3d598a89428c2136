"""The settings of an identification, each described once: the command line, studies and the report all read this table.

A new setting is a line here, an attribute of :class:`rotorfit.studies.study.Study`, and its use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rotorfit.fitting.option_kinds import (
    COUNT,
    FLAG,
    KNOWN,
    NUMBERS_BY_NAME,
    PHASES,
    POSITIVE,
    PRIORS,
    RANGES,
    TEXT,
    TEXT_BY_NAME,
    TEXTS,
    UNCERTAINTIES,
    WHOLE,
    Kind,
    is_set,
    written,
)


@dataclass(frozen=True, kw_only=True)
class Option:
    """One setting."""

    name: str  # attribute of a study and key of its TOML file
    kind: Kind  # what its value must be
    help: str  # what it does, for ``--help``
    metavar: str | None = None  # what stands behind it on the command line
    flag: str = ""  # its name there, by default the name with hyphens

    @property
    def word(self) -> str:
        """Name of the option on the command line."""
        return self.flag or "--" + self.name.replace("_", "-")


MODEL = (
    Option(name="planes", kind=TEXTS, metavar="A,B", help="the data's plane names, in the model's order"),
    Option(name="blocks", kind=TEXTS, metavar="A,B", help="structural blocks to include"),
    Option(name="two_lam", kind=FLAG, help="lam_D and lam_M of their own in place of one lam"),
    Option(name="orthotropic", kind=TEXTS, metavar="A,B", help="planes whose supports differ in two directions"),
)
LAW = (
    Option(name="law", kind=TEXT, metavar="NAME", help="law of eccentricity: muszynska, even-polynomial, ..."),
    Option(name="clearance_um", kind=POSITIVE, metavar="UM", help="radial clearance at the fluid, for a law"),
)
MODAL = (
    Option(name="modes", kind=COUNT, metavar="N", help="modes of the model modal"),
    Option(name="gains", kind=TEXT, metavar="KIND", help="modal: a complex gain for each probe, or for each plane"),
    Option(name="apart", kind=FLAG, help="modal: x and y have natural frequencies and damping ratios of their own"),
)
PARAMETERS = (
    Option(
        name="known",
        kind=KNOWN,
        metavar="NAME=VALUE",
        help="not fitted, SI units; NAME=free fits what the model fixes by default",
    ),
    Option(name="bounds", kind=RANGES, metavar="NAME=LO:HI", help="limits of a parameter, either may be left out"),
    Option(
        name="priors",
        flag="--prior",
        kind=PRIORS,
        metavar="NAME=MEAN:SD",
        help="Gaussian prior of a parameter (other distributions: `rotorfit run`)",
    ),
    Option(name="start", kind=NUMBERS_BY_NAME, metavar="NAME=VALUE", help="start value in place of what the data give"),
)
PER = Option(
    name="per",
    kind=TEXT_BY_NAME,
    metavar="NAME=ATTRIBUTE",
    help="one value for each value of a test attribute: D=speed_rpm",
)
RUNOUT = Option(
    name="runout_um",
    kind=POSITIVE,
    metavar="UM",
    help="plausible run-out; 1x and 2x of recordings then tell unbalance and side load (anisotropic-shaft)",
)
LOSS = Option(name="loss", kind=TEXT, metavar="NAME", help="linear, or soft_l1, huber, cauchy against outliers")
PHASE_OFFSETS = Option(
    name="phase_offsets",
    kind=PHASES,
    metavar="common",
    help="fit a phase reference offset for every run but the first; common: one angle between forces and responses",
)
MAX_ITERATIONS = Option(
    name="max_iterations", kind=COUNT, metavar="N", help="limit on the iterations of the search; 200 unless given"
)
REFINE = Option(name="refine", kind=FLAG, help="add structural blocks while the data ask for them (AIC)")
UNCERTAINTY = (
    Option(
        name="calibration",
        kind=UNCERTAINTIES,
        metavar="NAME=VALUE",
        help="systematic uncertainty: probe_gain=0.01, probe_phase_deg=0.5, mr=0.005, keyphasor_deg=1",
    ),
    Option(
        name="assumptions",
        flag="--assumption",
        kind=NUMBERS_BY_NAME,
        metavar="NAME=SD",
        help="standard uncertainty of what the model leaves out or takes as known, Ds[journal]=2: a systematic share",
    ),
    Option(name="profile", kind=TEXTS, metavar="A,B", help="profile likelihoods: lam,D,threshold_speed"),
    Option(name="bootstrap", kind=COUNT, metavar="N", help="simulate and fit N tests"),
    Option(name="sample", kind=FLAG, help="draw from the posterior with emcee; needs some seconds"),
    Option(name="seed", kind=WHOLE, metavar="N", help="of random numbers, for the same draws again"),
    Option(name="ess", kind=POSITIVE, metavar="ESS", help="effective samples to reach"),
    Option(name="max_steps", kind=COUNT, metavar="N", help="steps to stop at in any case"),
)

FIT = (*MODEL, *LAW, *MODAL, *PARAMETERS, PER, RUNOUT, LOSS, PHASE_OFFSETS, MAX_ITERATIONS, REFINE, *UNCERTAINTY)
"""Settings of ``rotorfit fit`` and of a study."""
CAMPAIGN = (*MODEL, *PARAMETERS, LOSS)
"""Settings of ``rotorfit campaign``: what is neither known nor shared has a value of its own for each run."""
LAW_RANKING = (*MODEL, *PARAMETERS, PER, LOSS, PHASE_OFFSETS)
"""Settings of ``rotorfit compare-laws``, which goes through the laws itself."""


def command_words(settings: Mapping[str, Any]) -> list[str] | None:
    """Words of ``rotorfit fit`` that say some settings; ``None`` where the command line cannot."""
    found: list[str] = []
    for option in FIT:
        value = settings.get(option.name)
        if not is_set(value):
            continue
        said = written(option.kind, option.word, value)
        if said is None:
            return None
        found += said
    return found
