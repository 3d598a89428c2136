"""What a fit asks a reader to know beside its numbers: of itself, its noise, its causes and its model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.blocks.set_speeds import ONLY_1X
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import perturbations
from rotorfit.lab.data.findings import Finding
from rotorfit.models.shafts.shaft import Shaft

_WIDE = 0.5
"""Standard error over the value from which a value is called wide."""
_TOGETHER = 0.98
"""Correlation from which four fifths of an error are another value's."""


@dataclass(frozen=True, kw_only=True)
class StructureError:
    """Reduction of a known structure in a fit."""

    coordinates: int  # of the structure
    kept: int  # of the reduced structures, the largest
    estimate: float
    over_noise: float
    checked: int  # these lines

    def __str__(self) -> str:
        return (
            f"the structure's {self.coordinates} coordinates were reduced to {self.kept}; estimated error of the "
            f"stiffness at the planes {self.estimate:.1e} of it; against exact condensation, predictions at "
            f"{self.checked} lines change by at most {self.over_noise:.1e} of the noise"
        )


def notices_of(fit: FitResult) -> list[Finding]:
    """What a fit, its noise and its model ask a reader to know, without a look at the data: warnings, then notes."""
    return [*fit.notices, *_notes(fit)]


def _notes(fit: FitResult) -> Iterator[Finding]:
    """What belongs beside the numbers of a fit."""
    for remark in dict.fromkeys(remark for block in fit.problem.blocks for remark in block.remarks):
        yield Finding("note", "errors", remark)
    if fit.model_uncertainty is not None and any(block.force_spectra for block in fit.problem.blocks):
        text = "another spectrum of the force fits as well, by AIC: how far it moves the rotor counts in the errors"
        yield Finding("note", "errors", text)
    if fit.noise is not None:
        yield from fit.noise.notes
    for row in fit.causes.found:
        text = f"the data show {row.words}; {row.way_out}"
        yield Finding("note", "cause", text, remedy=row.way_out, origin="fit")
    if words := _only_together(fit):
        yield Finding("note", "only-together", words, remedy=words.rpartition("; ")[2], origin="fit")
    for text in _of_one_probe(fit):
        yield Finding("note", "one-probe", text)
    if fit.model.of_modes and all(test.synchronous for test in fit.experiments):
        yield Finding("note", "only-1x", f"no threshold speed: {ONLY_1X}")
    for caveat in fit.model.caveats:
        yield Finding("note", "model", caveat, origin="model")
    for other in fit.other_solutions:
        choice = "choose by start=, bounds= or known="
        yield Finding("note", "other solution", f"{other}; {choice}", remedy=choice, origin="fit")
    reduced = structure_error(fit)
    if reduced is not None:
        yield Finding("note", "reduced", str(reduced), origin="model")


def _only_together(fit: FitResult) -> str:
    """Dampers, of those beside a fluid, whose value would narrow others that are wide for want of it."""
    names = [name for name in fit.var_names if name in fit.params and fit.params[name].determined]
    entries = [fit.var_names.index(name) for name in names]
    error = np.sqrt(np.diag(fit.covar)[entries])
    value = np.abs([fit.params[name].value for name in names])
    wide = np.flatnonzero(error > _WIDE * value)
    within = {q.name for own in fit.model.fluids for q in own.parameters}
    for a in wide.tolist():
        if names[a] in within or fit.params[names[a]].unit != "N s/m":
            continue
        r = fit.covar[entries, entries[a]] / (error * error[a])
        others = [names[b] for b in wide.tolist() if b != a and abs(r[b]) > _TOGETHER]
        if len(others) > 1:
            given = f"{{{names[a]!r}: 0.0}}"
            return (
                f"{', '.join(others)} are wide because {names[a]} may be anything; if nothing else damps there, say so "
                f"(known={given}, --known {names[a]}=0), or measure it without fluid"
            )
    return ""


def _of_one_probe(fit: FitResult) -> Iterator[str]:
    """What planes that one probe reads do not tell, under forces that turn."""
    axes: dict[str, set[str]] = {}
    for test in (test.select(~test.linear) for test in perturbations(fit.experiments)):
        for row in test.alike("plane", "direction")[0].tolist():
            axes.setdefault(str(test.plane[row]), set()).add(str(test.direction[row]))
    taken = "the orbit is taken for a circle" if fit.model.frame == "z" else "motion across is not known"
    for axis in ("x", "y"):
        if alone := [plane for plane, own in axes.items() if own == {axis}]:
            unseen = "that x and y differ there, or a backward part, cannot show"
            yield f"one probe, along {axis}, at {', '.join(alone)}: {taken}; {unseen}"


def structure_error(fit: FitResult) -> StructureError | None:
    """Error of the reduced structure in a fit; None where there is no structure, or none was reduced."""
    model = fit.model
    while hasattr(model, "base"):  # the same structure on other supports, or on a shaft that is not round
        model = model.base
    shaft = model.shaft
    if not isinstance(shaft, Shaft) or not shaft.parts:
        return None
    worst, checked, theta = 0.0, 0, fit.thetas
    lines = 8  # lines of each experiment: few enough to be condensed exactly
    for block in fit.problem.blocks:
        base = block.responses
        if base is None:
            continue
        some = np.unique(np.linspace(0, base.frequency.size - 1, lines).astype(int))
        keep = np.zeros(base.frequency.size, dtype=bool)
        keep[some] = True
        rows, few = keep[base.line], block.lines(keep)
        if few is None:
            continue
        change = block.predict(theta)[rows] - few.predict(theta)
        worst, checked = max(worst, float(np.abs(change / base.sigma[rows]).max())), checked + some.size
    used = shaft.reductions
    if not used:
        return None
    return StructureError(
        coordinates=shaft.terms.size,
        kept=max(r.size for r in used),
        estimate=max(r.error for r in used),
        over_noise=worst,
        checked=checked,
    )
