"""From the search in the residuals to what the fit is repeated with, and to words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.noise.odd_run import odd_run
from rotorfit.fitting.noise.record import FoundNoise, Noise, NoiseVerdict, ResponseNoise, RunEffect
from rotorfit.fitting.noise.search import Search, offset_entries, residuals_of, search_noise, turn_of
from rotorfit.models.array_types import Float
from rotorfit.units import RPM_PER_RAD_S

_Number = TypeVar("_Number", np.float64, np.complex128)

_WINDOW = 5  # lines over which residuals are averaged to see where the model misses
_PLACES = 3
_FEW = 2  # other runs that one run's effect is compared with
_ALONE = 8.0  # times by which it must exceed theirs


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding:
    """What the residuals of a fit are."""

    record: Noise  # in numbers and words
    found: FoundNoise | None  # what the fit is to be repeated with, if anything
    start: dict[str, float]  # the fitted values by name that the linearised problem gives with it


def study_noise(problem: Problem, x: Float, *, singular: bool = False) -> Finding | None:
    """Tell noise, differences of runs and misfit apart at the optimum of a linear loss; nothing for other data."""
    data = residuals_of(problem, x)
    if data is None or not data.sweeps:
        return None
    offsets = bool(offset_entries(problem))
    forced = [data.kinds.index("run_phase")] if offsets and data.kinds else []
    search = search_noise(data, forced=forced)
    kinds = ["phase" if kind in forced else name for kind, name in enumerate(data.kinds)]

    def effects_of(variance: Float) -> tuple[RunEffect, ...]:
        """Those of some variance, the forced one first."""
        return tuple(
            RunEffect(
                kind=kinds[kind],
                sd=float(np.sqrt(variance[kind])),
                freedom=float(search.freedom[kind]),
                runs=data.runs,
                sensitivities=_by_block(problem, _relative(problem, search, kind)),
            )
            for kind in sorted(np.flatnonzero(variance).tolist(), key=lambda kind: kind not in forced)
        )

    effects, perhaps = effects_of(search.variance), effects_of(search.perhaps)
    changed = bool(effects) or search.verdict is NoiseVerdict.SHAPED
    found = None
    if changed:
        found = FoundNoise(factors=_by_block(problem, search.sigma / data.sigma), effects=effects, before=x)
    names = (*problem.space.names, *problem.space.nuisance)
    steps = np.zeros(data.kept.size) if singular else search.solved.step
    start = {names[entry]: float(x[entry] + step) for entry, step in zip(data.kept, steps, strict=True)}
    for effect in effects:
        own = search.solved.own[:, search.chosen.index(kinds.index(effect.kind))]
        start |= dict(zip(effect.names, own.tolist(), strict=True))
    return Finding(record=_record(problem, search, effects, perhaps), found=found, start=start)


def _relative(problem: Problem, search: Search, kind: int) -> NDArray[np.complex128]:
    """Change of the logarithm of the predictions by a unit of an effect."""
    data = search.data
    if data.kinds[kind] == "run_force":
        return np.ones(data.r.size, dtype=complex)
    if data.kinds[kind] == "run_phase":
        return turn_of(problem)
    return np.asarray(data.Z[:, kind] * data.sigma / data.y)


def _by_block(problem: Problem, values: NDArray[_Number]) -> tuple[NDArray[_Number], ...]:
    stops = np.cumsum([block.measured.size for block in problem.blocks])
    return tuple(np.split(values, stops[:-1]))


# ---- words ---------------------------------------------------------------------------------------


def _record(problem: Problem, search: Search, effects: tuple[RunEffect, ...], perhaps: tuple[RunEffect, ...]) -> Noise:
    data = search.data
    real = 2 * float(search.weight.sum())
    if search.verdict is NoiseVerdict.SHAPED:
        freedom = min(2 * float(search.weight[shape.rows].sum()) for shape in search.shapes)
    elif search.verdict is NoiseVerdict.FOLLOWING:
        freedom = real / (1 + 2 * sum(lag**2 for lag in search.memory.lags))
    else:
        freedom = float("inf") if data.sigma_given or search.verdict is NoiseVerdict.MISFIT else real
    misses = search.verdict is NoiseVerdict.MISFIT
    differing = tuple(
        f"{told}{alone}"
        for told, alone in zip(_differing(effects, len(data.runs)), _alone(search, effects), strict=False)
    )
    few = (_TWO_RUNS,) if len(data.runs) == 2 else ()
    return Noise(
        verdict=search.verdict,
        correlation=search.memory.first,
        lags=search.memory.lags,
        levels=_levels(problem, search) if search.verdict is NoiseVerdict.SHAPED else (),
        between=tuple((effect.kind, effect.sd) for effect in effects),
        perhaps=perhaps,
        places=_places(problem, search) if misses else (),
        odd_run=_odd_run(search),
        scatter_freedom=max(freedom, 1.0),
        sentences=(*differing, *_perhaps(perhaps, len(data.runs)), *few),
        notable=differing,
    )


def _differing(effects: Sequence[RunEffect], count: int) -> tuple[str, ...]:
    """What runs differ by; two runs do not tell which of several kinds it is."""
    hold = "Standard errors hold that, and intervals have the quantile of Student's t"
    if count == 2 and len(effects) > 1 and all(effect.kind in _WORDS for effect in effects):
        sizes = " or ".join(f"{_WORDS[effect.kind]} by {_size(effect)}" for effect in effects)
        return (f"runs differ in {sizes} (standard deviations, by how likely each is: two runs hardly tell). {hold}",)
    who = "the phase reference, that of the first run included, differs from run to run"
    return tuple(
        f"{who if effect.kind == 'phase' else f'runs differ in {_WORDS[effect.kind]}'} by {_size(effect)} (standard "
        f"deviation between {count} runs, {effect.freedom:.2g} degrees of freedom). {hold}"
        for effect in effects
    )


def _alone(search: Search, effects: Sequence[RunEffect]) -> list[str]:
    """For each effect, the one run that has nearly all of it; empty where several share it."""
    found = []
    for effect in effects:
        kind = search.data.kinds.index("run_phase" if effect.kind == "phase" else effect.kind)
        own = search.solved.own[:, search.chosen.index(kind)]
        own = np.abs(own - np.median(own))  # what one run alone has shifts the mean of all
        first = int(np.argmax(own))
        others = np.delete(own, first)
        odd = others.size >= _FEW and own[first] > _ALONE * np.sqrt(np.mean(others**2))
        found.append(
            f". Nearly all of it is in run {effect.runs[first]}, by {_amount(effect, own[first])}" if odd else ""
        )
    return found


def _perhaps(effects: Sequence[RunEffect], count: int) -> tuple[str, ...]:
    """What runs may differ by without it being more than chance."""
    sizes = " or ".join(f"in {_WORDS[effect.kind]} by {_size(effect)}" for effect in effects)
    told = f"the {count} runs may differ {sizes} (standard deviation), or by chance alone; standard errors allow for it"
    return (told,) if effects else ()


def _size(effect: RunEffect) -> str:
    return _amount(effect, effect.sd)


def _amount(effect: RunEffect, value: float) -> str:
    return f"{np.degrees(value):.2g} degrees" if "phase" in effect.kind else f"{100 * value:.2g} %"


_TWO_RUNS = (
    "two runs: what differs from run to run can hardly be known from them, and what shifts both alike not at all; the "
    "errors hold what was found of it only"
)

_WORDS = {
    "run_force": "force or gain",
    "run_phase": "their phase reference",
    "run_K0": "K0",
    "run_D": "D",
    "run_lam": "speed label or lam",
    "run_fluid": "viscosity (K0 and D together)",
}


def _levels(problem: Problem, search: Search) -> tuple[ResponseNoise, ...]:
    labels = np.concatenate([np.array(block.labels)[block.label] for block in problem.blocks])
    units = np.concatenate([_units(block) for block in problem.blocks])
    return tuple(
        ResponseNoise(
            responses=tuple(dict.fromkeys(labels[shape.rows].tolist())),
            constant=shape.a,
            share=shape.b,
            along=shape.along,
            unit=str(units[shape.rows[0]]) if np.unique(units[shape.rows]).size == 1 else "",
        )
        for shape in search.shapes
    )


def _units(block: Block) -> NDArray[np.str_]:
    """Unit of each reading of a block."""
    responses = responses_of(block)
    if responses is None:
        return np.full(block.label.size, "")
    of = [
        ("N m" if c.axis == "r" else "N") if responses.imposed else ("rad" if c.axis == "r" else "m")
        for c in responses.model.coordinates
    ]
    return np.array(of)[responses.coordinate]


def _odd_run(search: Search) -> str:
    """Sentence on the one run without which the fit would be another; empty where there is none."""
    data = search.data
    found = odd_run(data.r, data.J, data.prior, data.rows, data.sweeps)
    if found is None:
        return ""
    return (
        f"run {data.runs[found[0]]} does not go with the others: without it redchi would be about {found[1]:.2g}. "
        f"Look at its speed, direction, force and probes first"
    )


def _places(problem: Problem, search: Search) -> tuple[str, ...]:
    """Where residuals, averaged over neighbouring lines, are largest."""
    labels = np.concatenate([np.array(block.labels)[block.label] for block in problem.blocks])
    blocks = [block for block in map(responses_of, problem.blocks) if block is not None]
    w = np.concatenate([block.frequency[block.line] for block in blocks])
    found = []
    for sweep in search.data.sweeps:
        width = min(_WINDOW, sweep.size)
        mean = np.convolve(search.data.r[sweep], np.full(width, 1 / width), mode="valid")
        at = int(np.argmax(np.abs(mean)))
        rows = sweep[at : at + width]
        low, high = sorted(np.abs(w[rows[[0, -1]]]) * RPM_PER_RAD_S)
        found.append((float(np.abs(mean[at])), f"{labels[sweep[0]]} at {low:.0f} to {high:.0f} rpm"))
    return tuple(place for _, place in sorted(found, reverse=True)[:_PLACES])
