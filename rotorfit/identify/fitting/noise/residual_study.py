"""The record of a study of residuals: numbers, and on request its sentences; all sentences about noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.significance import P_WARNING
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.noise.run_effects import FEWEST_RUNS
from rotorfit.identify.fitting.noise.record import RUN_KINDS, FoundNoise, Miss, NoiseVerdict, ResponseNoise, RunEffect
from rotorfit.lab.data.findings import Finding

MODEL_LIMITED_REDCHI = 2.0
"""redchi above which a result that has nothing else to go by says that the model, not the noise, limits the fit."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualStudy:
    """Study of the residuals of a fit, and the basis of its error bars."""

    verdict: NoiseVerdict  # what the residuals are
    correlation: float = 0.0  # of residuals at neighbouring lines of a sweep: near zero for noise, whatever its shape
    lags: tuple[float, ...] = ()  # the same at distances 1, 2, ... as far as it is more than chance
    # noise of the responses by restricted likelihood, where it replaced that of the data alone
    response_noise: tuple[ResponseNoise, ...] = ()
    # for each block, size of the residuals over the noise given, or found in the data alone, where a misfit may
    # as well be noise behind overlapping filters
    noise_ratio: tuple[Float, ...] = ()
    # what the fit was repeated with: other noise, differences from run to run; ``None`` for neither
    found: FoundNoise | None = None
    # differences of runs that chance explains as well: the errors allow for them, the estimate does without
    possible_effects: tuple[RunEffect, ...] = ()
    run_count: int = 0  # runs that were compared, zero where they could not be
    misses: tuple[Miss, ...] = ()  # responses and frequencies where the model misses most
    # name of the one run without which the misfit would be a third or less, and redchi without it
    run_left_out: tuple[str, float] | None = None
    robust: bool = False  # whether standard errors follow the scatter of the residuals line by line (HC3)
    scatter_freedom: float = float("inf")  # degrees of freedom of the noise within runs, infinite where it was given
    runs: tuple[tuple[str, float, float], ...] = ()  # name, estimate and standard error of each effect of a run
    # shares, freedom: parts of ``covar`` and the degrees of freedom of each part's variance
    shares: tuple[Float, ...] = ()
    freedom: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "verdict", NoiseVerdict(self.verdict))  # files hold its value

    @property
    def effects(self) -> tuple[RunEffect, ...]:
        """Differences from run to run."""
        return () if self.found is None else self.found.effects

    @property
    def between(self) -> tuple[tuple[str, float], ...]:
        """Kind and standard deviation of each difference from run to run."""
        return tuple((effect.kind, effect.sd) for effect in self.effects)

    @property
    def perhaps_filtered(self) -> bool:
        """True if what a fit misses looks like noise behind overlapping filters."""
        return bool(self.noise_ratio)

    @property
    def correlated(self) -> bool:
        """True if standard errors include that the noise is, or may be, correlated along the sweeps."""
        return self.verdict is NoiseVerdict.CORRELATED or self.perhaps_filtered

    def degrees(self, gradient: Float) -> float:
        """Degrees of freedom of the variance of a derived quantity (Satterthwaite), infinite for a known one."""
        return _satterthwaite([float(gradient @ share @ gradient) for share in self.shares], self.freedom)

    def own_degrees(self) -> tuple[float, ...]:
        """The same of each entry of the fitted vector."""
        variances = (np.diag(share).tolist() for share in self.shares)
        return tuple(_satterthwaite(parts, self.freedom) for parts in zip(*variances, strict=True))

    # ---- sentences -----------------------------------------------------------------------------------------------

    @property
    def sentences(self) -> tuple[str, ...]:
        """Fixed causes, differences of runs and uneven scatter in words."""
        return (*self.notable, *(note.message for note in self.notes))

    @property
    def notable(self) -> tuple[str, ...]:
        """Those of them that are warnings."""
        return differences(self.effects)

    @property
    def places(self) -> tuple[str, ...]:
        """``misses`` in words."""
        return tuple(map(place, self.misses))

    @property
    def odd_run(self) -> str:
        """``run_left_out`` in words; empty where there is none."""
        return "" if self.run_left_out is None else odd_run(*self.run_left_out)

    def warnings(self, redchi: float, cause: str) -> Iterator[Finding]:
        """Warnings about the noise of a fit with such a redchi, by the noise of the data; ``cause``: what readings may
        scatter for."""
        for text in self.notable:
            yield Finding("warning", "runs-differ", text, origin="noise")
        large = redchi > MODEL_LIMITED_REDCHI
        for text in verdict_warning(self.verdict, redchi, self.correlation, cause, large=large):
            yield Finding("warning", f"noise-{self.verdict.value}", text, origin="noise")

    @property
    def notes(self) -> Iterator[Finding]:
        """What else is worth knowing of differences of runs, and of residuals that scatter unevenly."""
        possible = self.possible_effects
        if possible:
            sizes = " or ".join(f"in {_kind(effect)} by {_amount(effect, effect.sd)}" for effect in possible)
            runs = f"the {len(possible[0].runs)} runs may differ {sizes} (standard deviation), or by chance alone"
            yield Finding("note", "runs-may-differ", f"{runs}; standard errors allow for it", origin="noise")
        if self.run_count == 2:
            yield Finding("note", "two-runs", _TWO_RUNS, origin="noise")
        if self.robust:
            yield Finding("note", "uneven-scatter", _SCATTER, origin="noise")

    def __str__(self) -> str:
        return "; ".join([VERDICTS[self.verdict], *self.sentences])


def is_misfit(study: ResidualStudy | None, widening: float) -> bool:
    """True if the model limits a fit, not the noise: by the memory of residuals or their size."""
    if study is None:
        return widening > MODEL_LIMITED_REDCHI
    return study.verdict is NoiseVerdict.MISFIT


def largest_redchi(study: ResidualStudy | None, nfree: int, known_from: float) -> float:
    """redchi that noise alone exceeds once in a thousand tests: a quantile of the F distribution. ``nfree`` readings
    tell it, fewer where neighbours correlate; its own noise is known from ``known_from`` readings, infinite for noise
    that was given. Of many of both the sampling error of redchi is ``sqrt(2/nfree + 2/known_from)``."""
    from scipy.special import fdtri  # late: loading it takes longer than a fit

    lags = () if study is None else study.lags
    independent = nfree / (1 + 2 * sum(lag * lag for lag in lags))  # squares of normal errors correlate by lag^2
    known_well = 1e9  # readings from which a noise is as good as known
    return float(fdtri(independent, min(known_from, known_well), 1 - P_WARNING)) if nfree > 0 else float("nan")


def _satterthwaite(parts: Sequence[float], freedom: Sequence[float]) -> float:
    """Degrees of freedom of a sum of variances, which are known with so many each."""
    parts = [max(part, 0.0) for part in parts]
    total = sum(parts)
    if not 0 < total < float("inf"):
        return float("inf")
    uncertain = sum((part / total) ** 2 / own for part, own in zip(parts, freedom, strict=True))
    return 1 / uncertain if uncertain > 0 else float("inf")


# ---- sentences -------------------------------------------------------------------------------------------------------


VERDICTS = {
    NoiseVerdict.AS_FOUND: "the residuals are noise of the size that was given, or estimated from the data alone",
    NoiseVerdict.SHAPED: (
        "it was re-estimated from the residuals, because the estimate from sweep to sweep did not match"
    ),
    NoiseVerdict.LARGER: "the residuals are larger than the sigma of the readings, and not correlated along the sweeps",
    NoiseVerdict.CORRELATED: (
        "the residuals have the noise's size but are correlated along the sweeps, as behind overlapping filters"
    ),
    NoiseVerdict.MISFIT: (
        "the residuals are correlated along the sweeps and larger than the noise: the model does not fit"
    ),
}

_IN_ERRORS = "Standard errors include that, and intervals have the quantile of Student's t"

_TWO_RUNS = (
    "there are only two runs: their difference is poorly estimated, and an effect that shifts both alike cannot be "
    "seen; the errors include only the difference that was found"
)

_SCATTER = "the residuals scatter unevenly between readings; standard errors follow them (HC3)"


def differences(effects: Sequence[RunEffect]) -> tuple[str, ...]:
    """Differences from run to run, each a warning; two runs do not say of which of several kinds theirs is."""
    if len(effects) > 1 and all(len(effect.runs) == 2 and effect.kind in RUN_KINDS for effect in effects):
        sizes = " or ".join(f"{_kind(effect)} by {_amount(effect, effect.sd)}" for effect in effects)
        both = f"runs differ in {sizes} (standard deviations, by how likely each is: two runs hardly separate them)"
        return (f"{both}. {_IN_ERRORS}",)
    return tuple(map(_difference, effects))


def _kind(effect: RunEffect) -> str:
    """Quantity in which runs differ; no speed label is that far off."""
    # Relative error of a speed label beyond which none is likely: a tachometer that slips is off by parts of a percent
    largest_label_error = 0.05
    return "lam" if effect.kind == "run_lam" and effect.sd > largest_label_error else RUN_KINDS[effect.kind]


def _difference(effect: RunEffect) -> str:
    phase = "the phase reference, that of the first run included, differs from run to run"
    who = phase if effect.kind == "phase" else f"runs differ in {_kind(effect)}"
    between = f"standard deviation between {len(effect.runs)} runs, {significant(effect.freedom, 2)} degrees of freedom"
    found = f"{who} by {_amount(effect, effect.sd)} ({between}). {_IN_ERRORS}"
    if len(effect.values) < FEWEST_RUNS:
        return found
    size = np.abs(np.array(effect.values) - np.median(effect.values))  # an effect of one run shifts the mean of all
    first = int(np.argmax(size))
    # Times the rms effect of the other runs from which a difference is said to be of one run alone: of six runs with
    # normal effects one exceeds it once in eighty sets, of twelve once in four thousand
    single_run_ratio = 8.0
    if size[first] <= single_run_ratio * np.sqrt(np.mean(np.delete(size, first) ** 2)):
        return found
    return f"{found}. Nearly all of it is in run {effect.runs[first]}, by {_amount(effect, size[first])}"


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


def verdict_warning(verdict: NoiseVerdict, redchi: float, correlation: float, cause: str, *, large: bool) -> list[str]:
    """The verdict as a warning, where it changes standard errors; ``large``: redchi is."""
    yet = f"redchi is {significant(redchi, 3)}, yet neighbouring residuals are not correlated:"
    if verdict is NoiseVerdict.SHAPED and large:
        return [
            f"{yet} readings scatter more than was estimated from the data alone, {cause}. Weights and errors follow "
            "the scatter of the residuals"
        ]
    coarse_redchi = 0.01  # redchi below which what was taken for noise is the response between lines. Chosen
    if verdict is NoiseVerdict.SHAPED and redchi < coarse_redchi:
        return [
            f"redchi is {significant(redchi, 2)}: the lines are too few to tell noise from the response before a fit. "
            "Weights and errors follow the scatter of the residuals, which few lines hardly show; give the noise of "
            "the readings (sigma_um), or more lines"
        ]
    if verdict is NoiseVerdict.LARGER:
        return [
            f"{yet} the noise is larger than given, or readings scatter by more than noise, {cause}. Standard errors "
            "are widened accordingly; without sigma_um or coherence the noise is estimated"
        ]
    if verdict is NoiseVerdict.CORRELATED:
        return [
            f"residuals at neighbouring lines correlate ({correlation:.2f}), as where filters overlap: there are "
            "fewer independent readings than lines, and standard errors are widened accordingly"
        ]
    return []
