"""Model-form error: add structural blocks while the data ask for them, and test the single velocity ratio."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import plus_minus, significant
from rotorfit.base.equality import ByValue
from rotorfit.base.significance import OPEN_ERRORS
from rotorfit.base.text_table import Table, Tabled
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.estimators.inference.covariance import excess
from rotorfit.identify.fitting.causes.listing import probe_factors
from rotorfit.identify.fitting.causes.solution import UNLISTED
from rotorfit.identify.fitting.fit import fitted, solve_again
from rotorfit.identify.fitting.judge import why_not_refined, with_model_uncertainty
from rotorfit.identify.fitting.noise.residual_study import MODEL_LIMITED_REDCHI
from rotorfit.identify.fitting.noise.study import NOISE_LIKE_REDCHI
from rotorfit.identify.fitting.problem_setup import with_noise_scale
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import Onset
from rotorfit.lab.data.findings import Finding
from rotorfit.models import BLOCKS, RotorModel, threshold_speed
from rotorfit.models.parameters import bare_name
from rotorfit.models.structure import block_parameters, block_symbols, check_blocks

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, repr=False)
class Refinement(ByValue, Tabled):
    """Forward selection among nested models.

    Attributes:
        steps: results from the plainest model to the richest tried.
        best: the result chosen, the noise of each response rescaled to its residuals where the model does not limit
            the fit.
    """

    steps: tuple[FitResult, ...]
    best: FitResult

    @property
    def candidates(self) -> tuple[FitResult, ...]:
        """The steps, the chosen one as it was fitted at last, so that its numbers are those of ``best``."""
        own = self.best.model, self.best.var_names  # which factors of probes are freed, the model need not say
        return tuple(self.best if (step.model, step.var_names) == own else step for step in self.steps)

    def parts(self) -> list[str | Table]:
        """What is printed: the candidates, the chosen one marked, the block each tried, and the symbols of all its
        blocks."""
        rows, seen = [["tried", "structure", "fitted", "redchi", "AIC", ""]], set[str]()
        first = freed_factors(self.steps[0])
        for step in self.candidates:
            blocks, factors = getattr(step.model, "blocks", ()), freed_factors(step)
            new = [f"+ {block.replace('_', ' ')} ({block_symbols([block])})" for block in blocks if block not in seen]
            if not blocks:
                new = [
                    f"+ factor of the probe at {plane} ({factors[plane]})" for plane in factors if plane not in first
                ]
            *before, tried = new or ["all blocks" if blocks else "as printed"]
            seen |= set(blocks)
            mark = "<- chosen" if step is self.best else ""
            numbers = str(step.nvarys), significant(step.redchi, 4), f"{step.aic:.1f}"
            rows += [*([words] for words in before), [tried, block_symbols(blocks), *numbers, mark]]
        return [Table(rows, "<30 <18 >7 >10 >12 <1")]


def structure_name(model: RotorModel) -> str:
    """Structural blocks of a model in words."""
    blocks = getattr(model, "blocks", ())
    return "as printed" if not blocks else "+ " + " + ".join(block.replace("_", " ") for block in blocks)


def refine(fit: FitResult) -> Refinement:
    """Add structural blocks one at a time, and choose the simplest of the candidates with indistinguishable AIC.

    Factors of probes are tried first, as many as the data can tell: where they alone explain what the plain model
    misses, they stay in it. A block is kept where it lowers AIC by more than AIC scatters for nested models that
    are both right: the square root of twice the number of values added, 2 to 4 as a rule.

    No candidate is the rotor itself: BIC, which looks for the true one, ends the selection while neglected
    terms still move lam by more than its error; AIC (Akaike 1974) takes a block in while that pays.

    A candidate that leaves parameters open is taken only where the best of those that leave none misses the data by a
    fifth more, in redchi, than the best of all: parameters that one speed does not separate (the polar inertia and the
    fluid's) are then reported as open, instead of being estimated wrongly.

    The errors of parameters that all candidates share include the uncertainty of the choice among them.

    Where the chosen model does not limit the fit, what misfit is left is noise: it is fitted once more with the noise
    of each response rescaled to its residuals, so that one whose noise was estimated too small weighs less.
    Goodness of fit (redchi, AIC, BIC) still refers to the noise estimated from the data.

    Args:
        fit: result of a fit with a model of several planes.

    Raises:
        ValueError: the model has a single plane, so no structure between planes is missing, or the data leave
            parameters open, so that more of them would be open still.

    Example:
        >>> best = rf.refine(fit).best
        >>> round(best.params["lam"].value, 3)
        0.475
    """
    refusal = why_not_refined(fit.model, fit.identifiability)
    if refusal:
        raise ValueError(refusal)
    found, steps = _select(fit, may_leave_open=False)
    # Misfit over that of the best candidate, in power, beyond which one that leaves no parameter open is refused
    largest_misfit_ratio = 1.2
    if found.redchi > largest_misfit_ratio * min(step.redchi for step in steps if step.success or step is found):
        found, steps = _select(fit, may_leave_open=True)
    best = refit(replace(found, settings=replace(found.settings, causes=fit.settings.causes)), found.model, chosen=True)
    steps = [best if step is found else step for step in steps]
    chosen = with_model_uncertainty(rescale_noise(best), _model_uncertainty(best, steps))
    # Threshold speeds by group of the best candidate that holds beyond the tested band, and of its neighbours.
    onsets: list[Onset] = []
    whole = [step for step in steps if step.model.order <= 2 and (step.success or step is best)]
    if best.model.speed_dependent and whole:
        place = min(range(len(whole)), key=lambda number: whole[number].aic)
        mine, beside = whole[place], [*whole[max(place - 1, 0) : place], *whole[place + 1 : place + 2]]
        for group in range(len(best.thetas)):
            onset = mine.threshold_of(group)
            apart = max((abs(step.threshold_of(group).value - onset.value) for step in beside), default=0.0)
            whirl = threshold_speed(mine.model, mine.thetas[group])
            ratio = math.nan if whirl is None else whirl.whirl_ratio
            onsets.append(Onset(speed=onset.value, stderr=onset.stderr, difference=apart, whirl_ratio=ratio))
    notices = (*chosen.notices, *_probes_off(fit, chosen, steps), *_notices(fit, chosen))
    chosen = replace(chosen, settings=replace(chosen.settings, onsets=tuple(onsets)), notices=notices)
    refinement = Refinement(tuple(steps), chosen)
    _LOG.info("structure chosen by AIC:\n%s", refinement)
    return refinement


def _select(fit: FitResult, *, may_leave_open: bool) -> tuple[FitResult, list[FitResult]]:
    """The best candidate, and all that were tried."""
    best = fit if fit.settings.causes is None else refit(fit, fit.model, with_causes=False)
    steps = [best]

    def try_with(blocks: Iterable[str]) -> FitResult:
        step = refit(best, best.model.variant(blocks=check_blocks(tuple(blocks))), with_causes=False)
        hidden = _hidden(step)
        step = refit(best, step.model, priors=hidden, with_causes=False) if hidden else step
        steps.append(step)
        # AIC of nested models that are both right differs by chi-squared of the values added: that is its scatter.
        chance = math.sqrt(2 * max(step.nvarys - best.nvarys, 0))
        gains = step.aic < best.aic - chance
        pays = step.success and gains and (may_leave_open or not step.identifiability.unresolved)
        return step if pays else best

    for step in _with_probe_factors(best, steps):
        best = step
    for block in BLOCKS:
        # Every block is tried, also after one that brings nothing.
        if block not in best.model.blocks:  # type: ignore[attr-defined]
            best = try_with({*best.model.blocks, block})  # type: ignore[attr-defined]
    if not any(step.model.blocks == BLOCKS for step in steps):  # type: ignore[attr-defined]
        best = try_with(BLOCKS)  # and those that only pay together
    return best, steps


def freed_factors(fit: FitResult) -> dict[str, str]:
    """Names of the factors of probes that a fit has freed, by plane."""
    fitted_names = {bare_name(name) for name, p in fit.params.items() if p.vary}
    return {plane: name for plane, name in probe_factors(fit.model).items() if name in fitted_names}


def _with_probe_factors(plain: FitResult, steps: list[FitResult]) -> Iterator[FitResult]:
    """The fit with the factors of some probes, where these alone explain what it misses; all that were tried join the
    steps. Blocks of the structure would follow a probe that is off, and a factor a little of whatever is missing: it
    has to explain all."""
    best, read = plain, {plane for test in plain.experiments for plane in getattr(test, "planes", ())}
    while not _explained(best) and len(freed_factors(best)) + 1 < len(read):
        left = [name for plane, name in probe_factors(plain.model).items() if plane in read]
        tried = [_free(best, name) for name in left if name not in freed_factors(best).values()]
        steps += [step for step in tried if not step.identifiability.unresolved]
        least = min((step.aic for step in tried if step.success), default=math.nan)
        same = 1e-3  # difference of AIC within which two sets say the same but for round-off: the first of them
        best = next((step for step in tried if step.success and step.aic < least + same), plain)
        if best is plain:
            return
    if best is not plain and _explained(best) and not best.identifiability.unresolved:
        yield best


def _explained(fit: FitResult) -> bool:
    return fit.redchi <= max(fit.largest_redchi, UNLISTED)


def _free(fit: FitResult, name: str) -> FitResult:
    """The fit with a value freed that its model fixes by default."""
    freed = replace(fit.settings.asked, known={**fit.settings.known, name: None}, causes=None)
    return fitted(fit.model, fit.experiments, freed)


def _hidden(step: FitResult) -> dict[str, Any]:
    """Priors of gyroscopic effects that the data cannot tell from the fluid's inertia, ``2 Mf lam w Om``, by name.

    So it is at one speed. Left out, the whole block would be refused, and others would take its place and move lam.
    They are taken to be zero, give or take three of the largest that the data tell, for a disk that hardly tilts as it
    moves itself does so as the journal moves; K0, Mf and the threshold carry that.
    """
    if "gyroscopic" not in step.model.blocks:  # type: ignore[attr-defined]
        return {}
    own = [step.params[q.name] for q in block_parameters(("gyroscopic",), len(step.model.planes))]
    sizes = [math.hypot(p.value, p.stderr) for p in own if p.resolved]
    if len(sizes) in (0, len(own)) or not step.success:
        return {}
    from scipy.stats import norm  # late: loading it takes longer than a fit

    prior_deviations = 3.0  # gyroscopic effects of a plane over those of another
    return {p.name: norm(0.0, prior_deviations * max(sizes)) for p in own if not p.resolved}


def _probes_off(plain: FitResult, chosen: FitResult, steps: Sequence[FitResult]) -> Iterator[Finding]:
    """Factors of probes that explain what the plain model misses, and those that do so as well."""
    before = freed_factors(plain)
    new = {plane: factor for plane, factor in freed_factors(chosen).items() if plane not in before}
    sets = [(s.aic, set(freed_factors(s)) - set(before)) for s in steps if not getattr(s.model, "blocks", ())]
    least = min((aic for aic, planes in sets if planes == set(new)), default=math.nan)
    near = [planes for aic, planes in sets if len(planes) == len(new) and aic < least + OPEN_ERRORS**2]
    others = [" and ".join(sorted(planes)) for planes in near if planes != set(new)]
    for plane, factor in new.items():
        p = chosen.params[factor]
        beside = f", or that at {' or '.join(others)} as much the other way" if others else ""
        text = (
            f"the probe at {plane} reads {plus_minus(p.value, p.stderr)} of the motion ({factor}){beside}: that "
            "explains what the plain model missed. Factors of probes were tried before blocks of the structure"
        )
        yield Finding("warning", "probe-factor", text, origin="fit")


def _notices(plain: FitResult, chosen: FitResult) -> Iterator[Finding]:
    """Parameters that were taken to be about zero because the data do not determine them; and the odd run before,
    where no candidate explains the data: blocks taken in to follow it hide it."""
    names = sorted(set(chosen.settings.priors) - set(plain.settings.priors))
    if names:
        size = chosen.settings.priors[names[0]].std()
        data, more = "these data", "tests at speeds further apart would"
        if chosen.speeds.size == 1:
            data, more = "these data, as those at one speed,", "tests at another speed would"
        text = (
            f"{data} cannot separate {', '.join(names)} from the fluid's inertia: taken to be 0 +- "
            f"{significant(size, 2)} kg, which the errors of K0, Mf and the threshold speed include; {more} separate "
            "them"
        )
        yield Finding("warning", "not-separated", text, origin="fit")
    odd = "" if plain.noise is None else plain.noise.odd_run
    said = chosen.noise is not None and bool(chosen.noise.odd_run) and chosen.redchi > MODEL_LIMITED_REDCHI
    if odd and chosen.model_limited and not said:
        yield Finding("warning", "odd-run", f"before refinement, {odd}", origin="fit")


def _model_uncertainty(best: FitResult, steps: Sequence[FitResult]) -> Float:
    """Covariance of the choice among candidates by AIC weights (Burnham & Anderson 2002), ``(n, n)``: chance chooses
    blocks that came out large. Errors only grow, by differences of candidates and of their errors; a missing block is
    zero, a factor of a probe that was not freed one."""
    names = best.problem.space.names
    sure = [i for i, name in enumerate(names) if best.params[name].resolved]

    def tells(step: FitResult) -> bool:
        """True if a candidate determines what the best one does."""
        if step.identifiability.unresolved and not best.identifiability.unresolved:
            return False
        shared = [n for n, p in best.params.items() if p.vary and p.resolved and n in step.params]
        return step.success and all(step.params[n].resolved for n in shared)

    candidates = [step for step in steps if step is best or tells(step)]
    scatter = max(1.0, min(step.redchi for step in candidates))  # what every candidate misses counts as noise
    # The best AIC is the best of many that scatter: by itself it makes the choice look surer than it is
    selection_widening = 2.0
    weight = np.exp([(best.aic - step.aic) / (2 * selection_widening * scatter) for step in candidates])
    apart, mixed = np.zeros((2, len(sure), len(sure)))
    for share, step in zip((weight / weight.sum()).tolist(), candidates, strict=True):
        there = [k for k, i in enumerate(sure) if names[i] in step.var_names]
        own = [step.var_names.index(names[sure[k]]) for k in there]
        held = [step.params[names[i]].value if names[i] in step.params else 0.0 for i in sure]
        away = np.array(held) - best.x[sure]
        apart += share * np.outer(away, away)
        mixed[np.ix_(there, there)] += share * step.covar[np.ix_(own, own)]
    found = np.zeros((len(names), len(names)))
    found[np.ix_(sure, sure)] = apart + excess(mixed, best.covar[np.ix_(sure, sure)])
    return found


def rescale_noise(fit: FitResult) -> FitResult:
    """The fit with the noise of each response rescaled to its residuals, in turns with the fit, which raises their
    joint likelihood. Not robust fits, nor those that the model limits: what it misses is no noise. Responses of few
    readings keep theirs."""
    if fit.settings.loss != "linear" or fit.model_limited or (fit.noise is None and fit.redchi > NOISE_LIKE_REDCHI):
        return fit
    plain = with_noise_scale(fit.problem, fit.settings.noise_scale, -1)
    names, number = words(np.array(plain.channel_names)[plain.channel])
    counts, free = 2 * np.bincount(number), 1 - fit.x.size / plain.n_data
    fewest_readings = 30  # readings of a response from which their scatter gives their noise within 10 %
    enough = counts >= 2 * fewest_readings
    smallest_scale = 1e-3  # scale below which exact data, not noise, are in hand
    for _ in range(5):
        # Root mean square of the whitened residuals of each response, over the share that the fitted values leave.
        squares = np.bincount(number, np.abs(plain.residuals(fit.x)) ** 2)
        sizes = np.maximum(np.sqrt(squares / (counts * free)), smallest_scale).tolist()
        scale = {name: size for name, size, some in zip(names, sizes, enough, strict=True) if some}
        settled = all(abs(scale[name] / fit.settings.noise_scale.get(name, 1.0) - 1) < 1e-3 for name in scale)
        if settled:
            break
        rescaled = replace(fit, settings=replace(fit.settings, noise_scale=scale))
        fit = solve_again(rescaled, with_noise_scale(plain, scale))
    return fit


def refit(
    fit: FitResult,
    model: RotorModel,
    priors: Mapping[str, Any] | None = None,
    *,
    with_causes: bool = True,
    chosen: bool = False,
) -> FitResult:
    """Another model fitted with the same settings, new parameters from zero influence: a nested one can only gain.
    Candidates are compared ``with_causes`` false, since causes stand for what they add; ``chosen`` is the last."""
    settings = fit.settings
    start = {n: p.value for n, p in fit.params.items() if p.vary and bare_name(n) in model.parameter_names}
    start |= {q.name: 0.0 for q in model.parameters if q.name not in {bare_name(b) for b in fit.params}}
    known = {k: v for k, v in settings.known.items() if k in model.parameter_names}
    wanted = replace(
        settings.asked, known=known, priors={**settings.priors, **(priors or {})}, start=start, refined=chosen
    )
    if with_causes:
        return fitted(model, fit.experiments, wanted)
    # A candidate begins at the optimum of the model inside it, from where damped steps lead down.
    method = "gauss-newton" if settings.method == "auto" else settings.method
    found = fitted(model, fit.experiments, replace(wanted, causes=None, method=method))
    return replace(found, settings=replace(found.settings, method=settings.method))


@dataclass(frozen=True, kw_only=True)
class OneLamTest:
    """Test of eq. (13)'s single velocity ratio against lam_D and lam_M of their own."""

    lam_D: tuple[float, float]  # lam_D, lam_M: (estimate, standard error)
    lam_M: tuple[float, float]
    difference: tuple[float, float]  # lam_D - lam_M and its standard error
    statistic: float  # fall of chi-squared, over redchi of the wider model where that exceeds 1
    p_value: float  # probability of such a fall if one lam held, chi-squared with one degree of freedom
    rejected: bool  # whether one lam is refused at the level asked for
    message: str  # the verdict in words
    fit: FitResult  # the fit with both ratios


def one_lam_test(fit: FitResult, *, level: float = 0.01) -> OneLamTest:
    """Ask the data whether damping and inertia turn with one velocity ratio.

    Args:
        fit: result of a model with the single ratio ``lam``.
        level: probability of refusing one lam although it holds.

    Raises:
        ValueError: the model has no single lam, or the data do not determine both ratios.

    Example:
        >>> rotor, bench = rf.models.OneMode(), {"M": 2.0, "K": 1e5, "Ds": 50.0}
        >>> truth = {**bench, "K0": 2e4, "D": 800.0, "lam": 0.45, "Mf": 1.0}
        >>> rpm = [-4000, -3000, -2000, -1000, 1000, 2000, 3000, 4000]
        >>> test = rf.simulate(rotor, truth, speed_rpm=[1500, 3000], frequency_rpm=rpm, force=1.0, noise=0.01, seed=1)
        >>> rf.one_lam_test(rf.fit(rotor, test, known=bench)).rejected
        False
    """
    from scipy.stats import chi2

    if "lam" not in fit.model.parameter_names:
        raise ValueError(f"{fit.model.name} as used here has no single lam to test")
    # The same data fitted with a ratio each for damping and inertia; what was said of the single one is dropped.
    lam = fit.params["lam"].value if "lam" in fit.params else float("nan")
    start = {name: p.value for name, p in fit.params.items() if p.vary and name != "lam"}
    asked = fit.settings.asked
    said: dict[str, Any] = {field: dict(getattr(asked, field)) for field in ("known", "bounds", "priors")}
    for values in said.values():
        values.pop("lam", None)
    wanted = replace(asked, **said, start={**start, "lam_D": lam, "lam_M": lam})
    wide = fitted(fit.model.variant(two_lam=True), fit.experiments, wanted)
    d, m = wide.params["lam_D"], wide.params["lam_M"]
    if not (d.resolved and m.resolved):
        raise ValueError("these data do not determine lam_D and lam_M apart: " + str(wide.identifiability))
    i, j = wide.var_names.index("lam_D"), wide.var_names.index("lam_M")
    variance = wide.covar[i, i] + wide.covar[j, j] - 2 * wide.covar[i, j]
    statistic = max(0.0, (fit.aic - 2 * fit.nvarys) - (wide.aic - 2 * wide.nvarys)) / max(1.0, wide.redchi)
    p = float(chi2.sf(statistic, 1))
    rejected = p < level
    verdict = (
        f"one lam is refused (p = {significant(p, 2)}): lam_D = {d.shown()} from the damping force, "
        f"lam_M = {m.shown()} from the inertia force; use two_lam=True"
        if rejected
        else f"one lam agrees with the data (p = {significant(p, 2)})"
    )
    if wide.model_limited:
        verdict += (
            f"; but with both ratios the model still misses the data (redchi {significant(wide.redchi, 3)}), and what "
            "it leaves out can look like a second ratio: ask again of the structure that rf.refine finds"
        )
    return OneLamTest(
        lam_D=(d.value, d.stderr),
        lam_M=(m.value, m.stderr),
        difference=(d.value - m.value, float(np.sqrt(variance))),
        statistic=statistic,
        p_value=p,
        rejected=rejected,
        message=verdict,
        fit=wide,
    )
