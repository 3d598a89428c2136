"""Which figures show which kinds of data: those of a report, and a first look at a fit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rotorfit.estimators.blocks.observations import Block, Responses, read_at_the_force
from rotorfit.estimators.blocks.operating import OperatingSpectra
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.identify.fitting.headline import leads_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models.motion.journal import journals


class ReportFigure(NamedTuple):
    """A figure of the report and the kind of data that it shows."""

    title: str  # heading of its section
    name: str  # of the method of ``fit.plot`` that draws it, and of its file
    caption: str  # words below it
    kinds: set[str]  # of data that appear in it, as `_kinds` names them


def _kinds(block: Block) -> Iterator[str]:
    """Kinds of data that a block of observations holds, for the figures that show them."""
    responses = block.responses
    turning = responses is not None and bool(responses.frequency.any())
    if turning:  # circular forces, or forces under imposed orbits
        yield "responses"
        if responses is not None and _stiffness_measured(responses):
            yield "stiffness"
    if block.shows_eccentricity:
        yield "impulses" if responses is None else "orbits" if turning else "loads"
        if responses is not None and turning and len(journals(responses.model)) == 1:
            yield "orbits of one journal"
    if isinstance(block, OperatingSpectra):
        yield "spectra"
    if block.forced_lines:
        yield "spectral lines"
    if turning and responses is not None and responses.model.of_modes:
        yield "modes"
        fewest = 50  # frequencies at which poles of some orders beyond those of the model can be looked for
        if np.unique(responses.frequency).size >= fewest:
            yield "many frequencies of modes"


def _stiffness_measured(block: Responses) -> bool:
    """True if responses hold a drive point of the rotor alone, or can be inverted."""
    alone = block.beside is None and bool(read_at_the_force(block).any())
    return alone or (not block.imposed and bool(stiffness_matrices(block).frequency.size))


_TO_FORCE = "Responses to a unit force. Points: measured. Lines: fit, with its 95 % band."
_POLAR = "Responses to a unit force. Points: measured. Lines: fit; circles: frequencies in rpm."
_BAND = "Residuals over their noise; noise alone would leave 95 % of them between the dashed lines."

FIGURES: tuple[ReportFigure, ...] = (
    ReportFigure(
        "Dynamic stiffness",
        "dynamic_stiffness",
        "Points: measured ± σ. Lines: fit, with its 95 % band. Dotted: λΩ, where the fluid's part of the quadrature "
        "stiffness vanishes.",
        {"stiffness"},
    ),
    ReportFigure("Bode plots", "bode", _TO_FORCE, {"responses"}),
    ReportFigure("Polar plots", "polar", _POLAR, {"responses"}),
    ReportFigure("Residuals", "residuals", _BAND, {"responses"}),
    ReportFigure(
        "Mode shapes",
        "mode_shapes",
        "Gains of the probes in each mode, one where all are normalised, with 95 % errors.",
        {"modes"},
    ),
    ReportFigure(
        "Stabilisation",
        "stabilisation",
        "Natural frequencies of poles against how many are looked for, over the size of all responses. Poles of modes "
        "stay where they are, those of noise do not.",
        {"many frequencies of modes"},
    ),
    ReportFigure(
        "Operating vibration",
        "spectra",
        "Two-sided spectra of x + jy, forward right of zero, backward left. Points: measured. Lines: fit, in a band "
        "that 95 % of the points lie in. Grey: orders of the shaft and lines that are left out.",
        {"spectra"},
    ),
    ReportFigure(
        "Spectral lines",
        "lines",
        "Lines per unit of force. Points: measured, paler where less certain. Lines: fit. A line at w has its image at "
        "2 Om − w.",
        {"spectral lines"},
    ),
    ReportFigure(
        "Fluid against eccentricity",
        "law",
        "The law's K0, D and lam with their 95 % bands; ticks: eccentricities of the data, dotted: beyond them.",
        {"orbits", "loads", "impulses"},
    ),
    ReportFigure(
        "Nonlinear dynamic stiffness",
        "nonlinear_stiffness",
        "Nonlinear minus linear dynamic stiffness at the journal. Points: measured. Lines: fit.",
        {"orbits of one journal"},
    ),
    ReportFigure(
        "Static loads",
        "static_locus",
        "Positions of the journal under constant loads over the clearance. Points: measured. Lines: fitted locus.",
        {"loads"},
    ),
    ReportFigure(
        "Static stiffness",
        "static_stiffness",
        "Static load over displacement. Points: measured. Lines: fit, with its 95 % band.",
        {"loads"},
    ),
    ReportFigure(
        "Impulse tests",
        "velocity_ratio",
        "Damped frequency over rotative speed. Points: measured. Solid lines: fitted eigenvalues; dashed: lam itself.",
        {"impulses"},
    ),
)
"""Figures in their order; further kinds of experiments add theirs here."""


_MISFITS = {"spectral lines": "line_misfit", "responses": "misfit", "spectra": "spectrum_misfit"}
"""Half figures of residuals, by the kind of data that they are of."""


def figures_of(fit: FitResult) -> list[ReportFigure]:
    """Figures that show the data of a fit, in their order."""
    kinds = {kind for block in fit.problem.blocks for kind in _kinds(block)}
    return [figure for figure in FIGURES if figure.kinds & kinds]


def first_figures(fit: FitResult, *, good: bool) -> list[tuple[str, str]]:
    """The two half figures of a first screen, each the method of ``fit.plot`` and what it shows.

    What the numbers of a rotor stand on is its quadrature stiffness, or its law of eccentricity, and how far it is from
    unstable; of a seal the stiffness over whirl frequency and the whirl frequency ratio; of a rotor that no speed
    changes its largest response.
    Of a fit that is not good the second is its misfit, as it is where there is no other.
    """
    kinds = {kind for block in fit.problem.blocks for kind in _kinds(block)}
    of_seal, changes = "coefficients" in leads_of(fit), fit.model.speed_dependent and not fit.model.turns
    found = []
    if "spectral lines" in kinds:
        found.append(("line", "A line of the shaft's motion against frequency"))
        found.append(("growth", "Growth rate of the least damped mode against speed"))
    elif "responses" in kinds and not of_seal and not changes:
        found.append(("largest_response", "Amplitude of the largest response against frequency"))
    if kinds & {"orbits", "loads", "impulses"}:
        found.append(("relative_law", "Fluid over its value in the centre against eccentricity"))
    elif "stiffness" in kinds:
        found.append(("quadrature", "Quadrature stiffness against frequency"))
    if "spectra" in kinds:
        found.append(("spectrum", "Spectrum of the operating vibration, forward and backward"))
    if of_seal and fit.speeds.any():
        found.append(("whirl_ratio", "Whirl frequency ratio against speed"))
    elif changes and fit.success:
        found.append(("damping", "Damping ratio of the whirl modes against speed"))
    misfit = [(_MISFITS[kind], "Residuals over their noise against frequency") for kind in _MISFITS if kind in kinds]
    return [*found[: 2 if good or not misfit else 1], *misfit][:2]
