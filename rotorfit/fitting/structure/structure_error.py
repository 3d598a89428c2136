"""Error of a fit by the reduction of a known structure with scale factors, against the noise of its readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.estimators.blocks.nonlinear import OrbitResponses, responses_of
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.models.shafts.shaft import Shaft

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult


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


def caveats_of(fit: FitResult) -> list[str]:
    """Sentences that belong beside the numbers of a fit: those of its model, and the error of a reduced structure."""
    tilts = [k for k, coordinate in enumerate(fit.model.coordinates) if coordinate.axis == "r"]
    read = any(np.isin(base.coordinate, tilts).any() for base in fit.problem.responses)
    caveats, reduced = [*fit.model.caveats, *(() if read else fit.model.caveats_without_tilts)], structure_error(fit)
    return [*caveats, str(reduced)] if reduced else caveats


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
        base = responses_of(block)
        if base is None or not isinstance(block, Responses | OrbitResponses):
            continue
        some = np.unique(np.linspace(0, base.frequency.size - 1, lines).astype(int))
        keep = np.zeros(base.frequency.size, dtype=bool)
        keep[some] = True
        rows = keep[base.line]
        change = block.predict(theta)[rows] - block.lines(keep).predict(theta)
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
