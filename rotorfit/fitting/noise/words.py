"""All sentences about noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rotorfit.estimators.inference.smooth_causes import Cause, Kind
from rotorfit.estimators.noise.run_effects import FEWEST_RUNS
from rotorfit.fitting.noise.record import Miss, NoiseVerdict, RunEffect
from rotorfit.models.digits import significant
from rotorfit.units import RPM_PER_RAD_S

VERDICTS = {
    NoiseVerdict.AS_FOUND: "the residuals are noise of the size that was given, or estimated from the data alone",
    NoiseVerdict.SHAPED: (
        "the residuals are noise of another size or shape than estimated from the data alone; they were weighted by it"
    ),
    NoiseVerdict.LARGER: "the residuals are noise, but larger than the sigma of the readings",
    NoiseVerdict.CORRELATED: (
        "the residuals have the noise's size but are correlated along the sweeps, as behind overlapping filters"
    ),
    NoiseVerdict.MISFIT: (
        "the residuals are correlated along the sweeps and larger than the noise: the model does not fit"
    ),
}

_KINDS = {
    "run_force": "force or gain",
    "run_phase": "their phase reference",
    "run_K0": "K0",
    "run_D": "D",
    "run_lam": "speed label or lam",
    "run_fluid": "viscosity (K0 and D together)",
}

_REMEDY = {
    Kind.PROBE: "Check the probe's characteristic, or test with less motion",
    Kind.FLUID: "Fit a law of eccentricity (law=, --law), or test with less motion",
    Kind.DELAY: "Undo the delay or filter of the channels, or give phase_offsets where the reference drifted",
    Kind.CLOCK: (
        "Sample marks and probes by one clock, or say how fast that of the marks is: clock_ppm in [shaft] and "
        "[perturbator] of rig.toml, less the growth over the duration of the sweep"
    ),
    Kind.DRIFT: "Let temperatures settle, and repeat the sweep the other way",
    Kind.HYSTERESIS: "A model with viscous damping alone follows it at one frequency only",
    Kind.SUPPORT: "Read both probes, x and y, or fit the model Anisotropic",
    Kind.PAIR: "Fit the model Anisotropic",
    Kind.ELSEWHERE: "Fit a model that has a fluid there too",
    Kind.LOAD: "Take the load off, or fit small motion about the place that the journal has under it (x_um, y_um)",
    Kind.RESIDUAL: (
        "Remove it: start up once more with the weight moved by 180 degrees, or without it, and fit the differences "
        "(in Python, rf.difference_synchronous)"
    ),
}
"""Advice for each fixed cause."""

_IN_ERRORS = "Standard errors include that, and intervals have the quantile of Student's t"

_TWO_RUNS = (
    "there are only two runs: their difference is poorly estimated, and an effect that shifts both alike cannot be "
    "seen; the errors include only the difference that was found"
)

_SCATTER = "the residuals scatter unevenly between readings; standard errors follow them (HC3)"

_LARGEST_LABEL_ERROR = 0.05
"""Relative error of a speed label beyond which none is likely: a tachometer that slips is off by parts of a percent."""
_SINGLE_RUN_RATIO = 8.0
"""Times the rms effect of the other runs from which a difference is said to be of one run alone: of six runs with
normal effects one exceeds it once in eighty sets, of twelve once in four thousand."""


def sentences(
    effects: Sequence[RunEffect], possible: Sequence[RunEffect], run_count: int, *, robust: bool
) -> tuple[str, ...]:
    """All that is worth saying of differences of runs, and of residuals that scatter unevenly."""
    words = [*differences(effects)]
    if possible:
        sizes = " or ".join(f"in {_kind(effect)} by {_amount(effect, effect.sd)}" for effect in possible)
        runs = f"the {len(possible[0].runs)} runs may differ {sizes} (standard deviation), or by chance alone"
        words.append(f"{runs}; standard errors allow for it")
    return (*words, *[_TWO_RUNS] * (run_count == 2), *[_SCATTER] * robust)


def causes(found: Sequence[Cause], *, whole: bool) -> tuple[str, ...]:
    """Fixed causes that explain what a fit misses, each a warning."""
    share = "The results are those of the model without it; their systematic share includes the shift"
    begin = f"{'the misfit' if whole else 'most of the misfit'} is explained by"
    return tuple(f"{begin} {_cause(cause)}. {share}. {_remedy(cause)}" for cause in found)


def _cause(cause: Cause) -> str:
    """A cause and its size in words."""
    part, size = cause.parts[0], cause.size
    where = f" at {part.plane}" if part.plane else ""
    match cause.kind:
        case Kind.PROBE:
            words = (
                f"a probe{where} that is not linear, reading {significant(100 * size, 2, sign=True)} % at "
                "the largest amplitude"
            )
        case Kind.FLUID:
            K, D, cross = cause.sizes
            change = (
                f"K0 {significant(K, 2, sign=True)} N/m, D {significant(D, 2, sign=True)} N s/m, D lam "
                f"{significant(cross, 2, sign=True)} N s/m"
            )
            words = f"a fluid{where} that changes with amplitude, {change} at the largest"
        case Kind.DELAY:
            who = f"the channels{where}" if where else "all channels"
            words = f"a delay, filter or drifting phase reference of {who}, {significant(1e3 * size, 2, sign=True)} ms"
        case Kind.CLOCK:
            words = (
                f"a delay of all channels that grows along the sweep, by {significant(2e3 * size, 2, sign=True)} ms "
                "from end to end, as where the marks are sampled by a clock of their own"
            )
        case Kind.DRIFT:
            words = (
                f"a drift along the sweep, D by {significant(100 * size, 2, sign=True)} % from its middle to its end"
            )
        case Kind.HYSTERESIS:
            words = (
                f"damping that does not grow with frequency (hysteresis){where}, {significant(size, 2, sign=True)} N/m"
            )
        case Kind.SUPPORT | Kind.PAIR:
            dK = math.hypot(*cause.sizes) if cause.kind is Kind.SUPPORT else math.sqrt(abs(size))
            words = f"stiffness unequal in x and y{where}, by {significant(2 * dK, 2)} N/m"
        case Kind.LOAD:
            words = (
                f"a static load{where} of about {significant(math.sqrt(abs(size)), 2)} N, which moves the "
                "orbits off the centre"
            )
        case Kind.RESIDUAL:
            words = (
                f"residual unbalance{where} of {significant(size, 2)} kg m, which these start-ups hold "
                "beside their weight"
            )
        case Kind.ELSEWHERE:
            words = f"a fluid{where} too, D lam {significant(size, 2)} N s/m"
        case _:
            how = "changes with speed" if cause.kind is Kind.SPEED else "does not change in proportion to the speed"
            words = (
                f"{part.value} that {how}, by {significant(100 * size, 2, sign=True)} % when the mean "
                "tested speed doubles"
            )
    return words


def _remedy(cause: Cause) -> str:
    value = cause.parts[0].value
    each = f'with a value for each speed (per={{"{value}": "speed_rpm"}})'
    if cause.kind is Kind.SPEED:
        law = f'law=rf.models.LinearInSpeed(("{value}",)), --law linear-in-speed'
        return f"Fit it with the law of speed ({law}), which the threshold speed follows, or {each}"
    return f"Fit it {each}, or test nearer to the threshold" if cause.kind is Kind.BEND else _REMEDY[cause.kind]


def differences(effects: Sequence[RunEffect]) -> tuple[str, ...]:
    """Differences from run to run, each a warning; two runs do not say of which of several kinds theirs is."""
    if len(effects) > 1 and all(len(effect.runs) == 2 and effect.kind in _KINDS for effect in effects):
        sizes = " or ".join(f"{_kind(effect)} by {_amount(effect, effect.sd)}" for effect in effects)
        both = f"runs differ in {sizes} (standard deviations, by how likely each is: two runs hardly separate them)"
        return (f"{both}. {_IN_ERRORS}",)
    return tuple(f"{_difference(effect)}. {_IN_ERRORS}{_of_one_run(effect)}" for effect in effects)


def _kind(effect: RunEffect) -> str:
    """Quantity in which runs differ; no speed label is that far off."""
    return "lam" if effect.kind == "run_lam" and effect.sd > _LARGEST_LABEL_ERROR else _KINDS[effect.kind]


def _difference(effect: RunEffect) -> str:
    phase = "the phase reference, that of the first run included, differs from run to run"
    who = phase if effect.kind == "phase" else f"runs differ in {_kind(effect)}"
    between = f"standard deviation between {len(effect.runs)} runs, {significant(effect.freedom, 2)} degrees of freedom"
    return f"{who} by {_amount(effect, effect.sd)} ({between})"


def _of_one_run(effect: RunEffect) -> str:
    """The run that has nearly all of an effect; empty where several share it."""
    if len(effect.values) < FEWEST_RUNS:
        return ""
    size = np.abs(np.array(effect.values) - np.median(effect.values))  # an effect of one run shifts the mean of all
    first = int(np.argmax(size))
    if size[first] <= _SINGLE_RUN_RATIO * np.sqrt(np.mean(np.delete(size, first) ** 2)):
        return ""
    return f". Nearly all of it is in run {effect.runs[first]}, by {_amount(effect, size[first])}"


def _amount(effect: RunEffect, value: float) -> str:
    return (
        f"{significant(np.degrees(value), 2)} degrees" if "phase" in effect.kind else f"{significant(100 * value, 2)} %"
    )


def place(miss: Miss) -> str:
    """A response and the frequencies where the model misses it."""
    return f"{miss.response} at {miss.low * RPM_PER_RAD_S:.0f} to {miss.high * RPM_PER_RAD_S:.0f} rpm"


def odd_run(name: str, redchi_without: float) -> str:
    """The one run that does not agree with the others."""
    return (
        f"run {name} disagrees with the others: without it redchi would be about {significant(redchi_without, 2)}. "
        f"Check its speed, direction, force and probes first"
    )


def verdict_warning(verdict: NoiseVerdict, redchi: float, correlation: float, *, large: bool) -> list[str]:
    """The verdict as a warning, where it changes standard errors; ``large``: redchi is."""
    if verdict is NoiseVerdict.SHAPED and large:
        return [
            f"redchi is {significant(redchi, 3)}, yet neighbouring residuals are not correlated: readings scatter more "
            "than was estimated from the data alone, as where a force or a speed jitters. Weights and errors follow "
            "the scatter of the residuals"
        ]
    if verdict is NoiseVerdict.LARGER:
        return [
            f"redchi is {significant(redchi, 3)}, yet neighbouring residuals are not correlated: the noise is "
            "larger than given, "
            "and standard errors are widened accordingly. Without sigma_um or coherence the noise is estimated"
        ]
    if verdict is NoiseVerdict.CORRELATED:
        return [
            f"residuals at neighbouring lines correlate ({correlation:.2f}), as where filters overlap: there are "
            "fewer independent readings than lines, and standard errors are widened accordingly"
        ]
    return []
