"""What a reader wants to know of a fit before all else: a verdict, checks, at most five numbers, and what limits them.

The model says which numbers it is asked for (:attr:`~rotorfit.models.RotorModel.leads`); a rig whose own stiffness was
taken out asks for coefficients. ``print``, the report and the front show these, with the same digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.anisotropy import searched_speed, unstable_speeds
from rotorfit.identify.fitting.causes.table import noun_of
from rotorfit.identify.fitting.noise.record import NoiseVerdict
from rotorfit.identify.fitting.noise.residual_study import VERDICTS
from rotorfit.identify.fitting.quantities import ErrorBar, Quantity, Shown
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import Coefficients
from rotorfit.lab.data.findings import Finding, errors_in
from rotorfit.lab.data.rows import short_source
from rotorfit.models.motion.modes import OVERDAMPED
from rotorfit.models.motion.stability import growing
from rotorfit.models.parameters import bare_name

MOST = 5
"""Numbers on a first screen."""


@dataclass(frozen=True, eq=False, kw_only=True)
class KeyNumber:
    """One of the numbers of a first screen."""

    name: str  # short: "D", "threshold speed"
    meaning: str  # a few words, empty where the name says all
    quantity: Quantity
    unit: str = ""  # in words, of a number without dimension
    instead: str = ""  # words in place of a number that is not there

    @property
    def error(self) -> ErrorBar | None:
        """The error share by share, of a number that has one."""
        return self.quantity.error if not self.instead and self.quantity.determined else None

    @cached_property
    def shown(self) -> Shown:
        """The number as it is printed, or the words in its place."""
        if self.instead:
            return Shown(value=self.instead)
        own = self.quantity.shown()
        return replace(own, unit=self.unit) if self.unit else own

    @property
    def is_named(self) -> bool:
        """True if the name alone says what it is."""
        return " " in self.name

    @property
    def known(self) -> bool:
        """True if there is a number."""
        return not self.instead and self.quantity.determined

    @property
    def shares(self) -> tuple[float, float, float]:
        """Shares of the variance by noise, bounded and on trust; nothing where they are not known."""
        bar = self.error
        if bar is None or not bar.stderr > 0:
            return 0.0, 0.0, 0.0
        return tuple(share**2 / bar.stderr**2 for share in (bar.noise, bar.bounded, bar.trust))  # type: ignore[return-value]


@dataclass(frozen=True, kw_only=True)
class Check:
    """One of the checks below a verdict."""

    good: bool
    words: str
    more: str = ""  # numbers behind it, or what it costs
    spoils: bool = True  # a fit that fails it is not good


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The cause on trust that the numbers rest on most."""

    cause: str  # with its size
    remedy: str  # what would bound it
    effect: str  # what that would bring


@dataclass(frozen=True, eq=False, kw_only=True)
class Headline:
    """First screen of a fit."""

    fit: FitResult
    findings: tuple[Finding, ...]  # errors of the data among them make every number void

    @property
    def errors(self) -> tuple[str, ...]:
        """Errors of the data, in words."""
        return errors_in(self.findings)

    @property
    def good(self) -> bool:
        """True if nothing speaks against relying on the numbers."""
        return all(check.good or not check.spoils for check in self.checks)

    @cached_property
    def numbers(self) -> tuple[KeyNumber, ...]:
        """At most five, those first that the model is asked for."""
        fit = self.fit
        found: list[KeyNumber] = []
        endings = dict.fromkeys(["", *(fluid.ending for fluid in fit.model.fluids)])
        for name in leads_of(fit):
            own = (number for ending in endings for number in _parameter(fit, name + ending))
            found += _LEADS[name](fit) if name in _LEADS else own
        shown = {number.name for number in found}
        of_groups = bool(found) and len(fit.thetas) > 1  # one group's value says little beside what leads
        for p in fit.params.values() if not of_groups else ():
            told = p.name in shown or (fit.model.of_modes and not bare_name(p.name).startswith("M"))
            if len(found) < MOST and p.vary and p.name in fit.problem.space.names and not told:
                found += _parameter(fit, p.name)
        return tuple(found[:MOST])

    @cached_property
    def verdict(self) -> str:
        """One or two sentences."""
        if self.errors:
            return "The data have an error, which is named below: no number here can be relied on."
        if not self.fit.success:
            return "The fit did not converge: no number here can be relied on."
        return " ".join(filter(None, (self.meaning, *_agreement(self.fit))))

    @cached_property
    def meaning(self) -> str:
        """Of the verdict what the numbers mean; how model and data agree is the first of the checks."""
        return " ".join(_said_of(self.fit, self.numbers))

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """Fit against noise, the data, what they determine."""
        return tuple(_checks(self.fit, self.findings))

    @cached_property
    def limit(self) -> Limit | None:
        """What limits the numbers most; None where nothing on trust does."""
        return _limit(self.fit, self.numbers)


def headline(fit: FitResult, findings: Sequence[Finding] | None = None) -> Headline:
    """The first screen of a fit; ``findings`` are those of the data, by default what the fit itself found."""
    return Headline(fit=fit, findings=tuple(fit.findings if findings is None else findings))


def rig_name(fit: FitResult) -> str:
    """What was tested, by the names of its files."""
    return named_by([test.source for test in fit.experiments])


def named_by(sources: Sequence[str]) -> str:
    """The first of some files by its name, and how many more there are."""
    names = list(dict.fromkeys(Path(short_source(source)).stem for source in sources if source))
    more = f" and {len(names) - 1} more" if names[1:] else ""
    return names[0] + more if names else "data in memory"


def task_of(fit: FitResult) -> str:
    """What was identified."""
    return "seal identification" if "coefficients" in leads_of(fit) else "rotor identification"


def leads_of(fit: FitResult) -> tuple[str, ...]:
    """Names of the numbers that a fit is asked for."""
    settings = fit.settings
    rig_taken_out = settings.baseline is not None or settings.stator_mass_kg is not None
    return ("coefficients",) if rig_taken_out else fit.model.leads


# ---- numbers -------------------------------------------------------------------------------------------------------


def _parameter(fit: FitResult, name: str) -> Iterator[KeyNumber]:
    """A fitted parameter; of one that was fitted in several conditions that of the last."""
    from rotorfit.identify.fitting.summary import in_order

    same = [p for p in in_order(fit.params.values()) if p.vary and name in (p.name, bare_name(p.name))]
    if same:
        own = same[-1]
        instead = "" if own.determined else own.shown().value
        yield KeyNumber(name=own.name, meaning=own.meaning, quantity=own._quantity, instead=instead)


def _threshold(fit: FitResult) -> Iterator[KeyNumber]:
    """The threshold speed, of several groups the lowest."""
    if not fit.model.speed_dependent or fit.model.turns:
        return
    if len(fit.thetas) == 1:
        onset, label = fit.threshold_speed(), ""
    else:
        each = [(fit.threshold_of(group), ", ".join(labels)) for group, labels in enumerate(fit.problem.space.labels)]
        onset, label = min(each, key=lambda one: (math.isnan(one[0].value), one[0].value))
    instead = ""
    if math.isinf(onset.stderr):
        instead = onset.shown().value
    elif math.isnan(onset.value):
        instead = "none found"
    elif onset.value == 0:
        instead = "0 rpm"
    elif not fit.success:
        instead = "not given"
    name = "threshold speed" + (f", {label}" if label else "")
    yield KeyNumber(name=name, meaning="of instability", quantity=onset.to("rpm"), instead=instead)


def _frequencies(fit: FitResult) -> Iterator[KeyNumber]:
    """Natural frequencies of the lowest modes of a rotor that no speed changes."""
    if not fit.success or fit.model.speed_dependent or fit.model.turns:
        return
    few = MOST - 1 if fit.model.of_modes else 3  # modes, beside which there is room for their damping
    swinging = [mode for mode in _standing_modes(fit) if abs(mode[2].value) < OVERDAMPED]
    for name, frequency, _ in swinging[:few]:
        yield KeyNumber(name=f"mode {name}", meaning="natural frequency", quantity=abs(frequency).to("rpm"))


def _standing_modes(fit: FitResult) -> list[tuple[str, Quantity, Quantity]]:
    """Name, natural frequency and damping ratio of the modes of a rotor that no speed changes."""
    if not fit.model.of_modes:
        speed = top_speed(fit)
        return named_modes(modes_at(fit, speed), sensed=speed > 0)
    p = fit.params
    names = [name.removeprefix("wn") for name in p if bare_name(name).startswith("wn")]
    return named_modes([(p[f"wn{n}"]._quantity, p[f"zeta{n}"]._quantity) for n in names], sensed=False)


def _anisotropy(fit: FitResult) -> Iterator[KeyNumber]:
    """How far a shaft is from round, and where it is stiff."""
    if "dK_cos" not in fit.model.parameter_names or len(fit.thetas) > 1 or not fit.success:
        return
    found = fit.turning_anisotropy()
    yield KeyNumber(name="dK", meaning="turning anisotropy", quantity=found.dK)
    if math.isfinite(found.ratio.value):
        yield KeyNumber(name="dK/K", meaning="share of the stiffness", quantity=100 * found.ratio, unit="%")
    instead = "" if math.isfinite(found.angle.stderr) else "not determined"
    angle = found.angle.to("deg")
    yield KeyNumber(name="stiff direction", meaning="angle on the shaft", quantity=angle, instead=instead)


def _law(fit: FitResult) -> Iterator[KeyNumber]:
    """What a law of eccentricity says of the fluid."""
    for fluid in fit.model.fluids:
        for parameter in fluid.law.parameters:
            yield from _parameter(fit, parameter.name + fluid.ending)


def _least_damping(fit: FitResult) -> Iterator[KeyNumber]:
    """Logarithmic decrement of the least damped mode at the highest tested speed; of two modes, or of a model without
    numbers of its own, those of all."""
    if not fit.success or fit.model.turns:
        return
    speed = top_speed(fit)
    of_modes = not fit.model.speed_dependent
    modes = _standing_modes(fit) if of_modes else named_modes(modes_at(fit, speed), sensed=speed > 0)
    swinging = [(mode, zeta) for mode, _, zeta in modes if abs(zeta.value) < OVERDAMPED]
    if not swinging:
        return
    # Forward of two that are damped alike but for round-off
    least = min(swinging, key=lambda one: (float(significant(one[1].value, 9)), not one[0].endswith("F")))
    where = f" at {significant(speed * RPM_PER_RAD_S, 4)} rpm" if fit.model.speed_dependent else ""
    every = fit.model.at_one_speed or (fit.model.of_modes and len(swinging) == 2)  # there is room for both dampings
    for mode, zeta in sorted(swinging, key=lambda one: one is not least) if every else [least]:
        name = f"{'' if every else 'least '}damping, {mode if speed > 0 else f'mode {mode}'}"
        yield KeyNumber(name=name, meaning=f"log. decrement{where}", quantity=decrement_of(zeta), unit="log dec")


def top_speed(fit: FitResult) -> float:
    """Highest tested speed, rad/s, zero of a rotor that no speed changes."""
    return float(fit.speeds.max(initial=0.0)) if fit.model.speed_dependent or fit.model.at_one_speed else 0.0


def modes_at(fit: FitResult, speed: float) -> list[tuple[Quantity, Quantity]]:
    """Natural frequencies and damping ratios at a speed, of modes in the tested band, in the last condition; at rest,
    where nothing tells forward from backward, each once."""
    modes = fit.natural_frequencies(speed, _at(fit, len(fit.thetas) - 1))
    seen = [(w, zeta) for w, zeta, _ in modes if abs(w.value) <= fit.band]
    if speed > 0:
        return seen
    ahead = [mode for mode in seen if fit.model.frame == "xy" or mode[0].value > -1e-9 * fit.band]
    each = {tuple(significant(abs(q.value), 9) for q in mode): mode for mode in ahead}  # but for round-off
    return list(each.values())


def decrement_of(ratio: Quantity) -> Quantity:
    """Logarithmic decrement of a damping ratio."""
    return 2 * math.pi * ratio / (1 - ratio**2).sqrt()


def named_modes(modes: Sequence[tuple[Quantity, Quantity]], *, sensed: bool) -> list[tuple[str, Quantity, Quantity]]:
    """Frequency and damping ratio of modes by name: forward ``1F``, ``2F``, ..., backward ``1B``, ..., by frequency;
    without the sense, ``1``, where it is none of theirs."""
    count = {"F": 0, "B": 0, "": 0}
    named = []
    for frequency, ratio in sorted(modes, key=lambda mode: abs(mode[0].value)):
        way = "" if not sensed else "F" if frequency.value > 0 else "B"
        count[way] += 1
        named.append((f"{count[way]}{way}", frequency, ratio))
    return named


def _at(fit: FitResult, group: int) -> dict[str, str] | None:
    """Argument that names a group."""
    parts = (label.partition("=") for label in fit.problem.space.labels[group])
    return {attribute: value for attribute, _, value in parts} or None


def middle_condition(fit: FitResult) -> Coefficients | None:
    """Coefficients at the middle of the tests, of which a first screen has its numbers."""
    if not fit.success:
        return None
    rows = fit.coefficient_table().rows
    return rows[len(rows) // 2] if rows else None


def _coefficients(fit: FitResult) -> Iterator[KeyNumber]:
    """Direct stiffness, damping and inertia, whirl frequency ratio and effective damping at one condition."""
    row = middle_condition(fit)
    if row is None:
        return
    where = row.condition
    direct = {kind: (row[f"{kind}xx"] + row[f"{kind}yy"]) / 2 for kind in "KCM"}
    meanings = {"K": "direct stiffness", "C": "direct damping", "M": "fluid inertia"}
    for kind, meaning in meanings.items():
        if direct[kind].value or direct[kind].stderr:
            yield KeyNumber(name=kind, meaning=f"{meaning}, {where}", quantity=_prefixed(direct[kind]))
    if row.speed:
        ratio = row.whirl_frequency_ratio
        instead = "no whirl" if math.isnan(ratio.value) else ""
        yield KeyNumber(name="WFR", meaning="whirl frequency ratio", quantity=ratio, instead=instead)
        damping = _prefixed(row.effective_damping(row.speed))
        yield KeyNumber(name="Ceff", meaning="effective damping at 1x", quantity=damping)


def _prefixed(quantity: Quantity) -> Quantity:
    """A stiffness or damping in the unit that brings it below a thousand."""
    size = abs(quantity.value)
    letter = "M" if size >= 1e6 else "k" if size >= 1e4 else ""
    return quantity.to(f"{letter}{quantity.unit}") if letter and quantity.unit.startswith("N") else quantity


_LEADS: dict[str, Callable[[FitResult], Iterator[KeyNumber]]] = {
    "threshold speed": _threshold,
    "frequencies": _frequencies,
    "anisotropy": _anisotropy,
    "law": _law,
    "least damping": _least_damping,
    "coefficients": _coefficients,
}
"""Numbers that are no parameters, by the names that models ask for them by."""


# ---- verdict -------------------------------------------------------------------------------------------------------


def _said_of(fit: FitResult, numbers: Sequence[KeyNumber]) -> Iterator[str]:
    """What the numbers mean for the machine."""
    by_name = {number.name: number for number in numbers}
    if "WFR" in by_name:
        row = middle_condition(fit)
        ratio = by_name["WFR"]
        if row is not None and ratio.known:
            rpm = significant(ratio.quantity.value * row.speed * RPM_PER_RAD_S, 3)
            yield f"The force feeds forward whirl slower than {ratio.shown.number} of shaft speed ({rpm} rpm)"
            yield f"and damps faster whirl, at {row.condition}."
        return
    first = numbers[0] if numbers else None
    if "dK" in by_name:
        yield from _uneven(fit, by_name.get("dK/K", by_name["dK"]))
    if first is not None and first.meaning == "natural frequency":
        told = [number.shown.value for number in numbers if number.meaning == first.meaning]
        yield f"Resonance at {both(told)} rpm."
    if first is None or not first.name.startswith("threshold speed"):
        return
    yield from _stability(fit, first)


def _uneven(fit: FitResult, share: KeyNumber) -> Iterator[str]:
    """Whether a shaft is round, and where it runs away if it is not."""
    if fit.turning_anisotropy().significant:
        yield f"The shaft is not round: its stiffness varies by {share.shown} either way as it turns."
    else:
        yield "A round shaft is not ruled out."
    top = searched_speed(fit)
    bands = [
        f"{significant(low * RPM_PER_RAD_S, 4)} to {significant(high * RPM_PER_RAD_S, 4)} rpm"
        for low, high in unstable_speeds(fit.model, fit.theta(), top)
    ]
    end = significant(top * RPM_PER_RAD_S, 3)
    yield f"Unstable at {both(bands)}." if bands else f"Stable up to {end} rpm."


def _stability(fit: FitResult, threshold: KeyNumber) -> Iterator[str]:
    onset, highest = threshold.quantity, float(fit.speeds.max(initial=0.0))
    if not _unstable_where_tested(fit):
        if fit.speeds.size:
            yield f"Stable at the tested {_speeds(fit)}."
    elif not (threshold.known and onset.value < highest * RPM_PER_RAD_S):  # else that is said of the threshold
        yield "Unstable at a speed that was tested."
    if math.isinf(onset.stderr):
        yield "These data do not determine whether or at which speed it becomes unstable."
    elif math.isnan(onset.value):
        yield "No threshold of instability at any speed searched."
    elif onset.value == 0:
        yield "Unstable from standstill on."
    elif threshold.known:
        yield f"Unstable above {threshold.shown}{_margin(fit, onset)}."


def _margin(fit: FitResult, onset: Quantity) -> str:
    """How far a threshold, rpm, is from the tests."""
    highest = float(fit.speeds.max(initial=0.0)) * RPM_PER_RAD_S
    if not highest:
        return ""
    percent = 100 * (onset.value / highest - 1)
    side = "above" if percent >= 0 else "below"
    more = " (extrapolated)" if percent > 0 else ""
    return f", {significant(abs(percent), 2)} % {side} the highest tested speed{more}"


def _speeds(fit: FitResult) -> str:
    few = 4  # speeds that are named one by one
    rpm = [significant(speed * RPM_PER_RAD_S, 4) for speed in fit.speeds.tolist()]
    if len(rpm) > few:
        return f"speeds, {rpm[0]} to {rpm[-1]} rpm"
    return f"speed{'s' if rpm[1:] else ''}, {both(rpm)} rpm"


def both(words: Sequence[str]) -> str:
    """Words with commas and an "and" between."""
    return " and ".join(part for part in (", ".join(words[:-1]), words[-1]) if part)


def _unstable_where_tested(fit: FitResult) -> bool:
    """True if the fitted rotor is unstable at a speed that was tested."""
    speeds = fit.speeds
    rotors = (np.broadcast_to(theta, (speeds.size, theta.size)) for theta in fit.thetas)
    return bool(speeds.size) and any(growing(fit.model, one, speeds, fit.stability_band)[1].any() for one in rotors)


def _agreement(fit: FitResult) -> Iterator[str]:
    """Model and data, in a sentence where they do not agree."""
    if fit.perhaps_local:
        yield "The search may have ended in a local minimum: other values may explain these data as well, or better."
    elif fit.model_limited:
        yield "The model explains the data only roughly: its own error, not the noise, limits the result."
    elif fit.problem.loss != "linear":
        yield f"Outliers were given less weight ({fit.problem.loss} loss)."
    elif fit.redchi <= fit.largest_redchi:
        yield "The fit agrees with the noise."
    else:
        yield f"The residuals are {significant(100 * (math.sqrt(fit.redchi) - 1), 2)} % larger than the noise."


def _checks(fit: FitResult, findings: Sequence[Finding]) -> Iterator[Check]:
    redchi = significant(fit.redchi, 3)
    at_most = f"misfit {redchi}, at most {significant(fit.largest_redchi, 3)} by noise"
    if not fit.success:
        yield Check(good=False, words="fit did not converge", more=fit.message)
    elif fit.perhaps_local:
        yield Check(good=False, words="perhaps a local minimum", more=f"misfit {redchi}")
    elif fit.model_limited:
        yield Check(good=False, words="model limits the fit", more=f"{at_most}; errors are widened for it")
    elif fit.problem.loss != "linear":
        yield Check(good=True, words="outliers weigh little", more=f"{fit.problem.loss} loss")
    elif fit.redchi <= fit.largest_redchi:
        yield Check(good=True, words="fit agrees with the noise", more=at_most)
    else:
        known = fit.noise is not None and fit.noise.verdict is not NoiseVerdict.AS_FOUND
        why = f"{at_most}; {VERDICTS[fit.noise.verdict]}" if fit.noise is not None and known else at_most
        yield Check(good=False, words="residuals exceed the noise", more=why)
    errors = errors_in(findings)
    warnings = [one for one in findings if one.severity == "warning" and one.origin in ("reading", "recording")]
    if errors:
        yield Check(good=False, words="error in the data", more=f"{len(errors)} found")
    elif warnings:
        yield Check(good=False, words="warning of the data", more=f"{len(warnings)} found", spoils=False)
    else:
        yield Check(good=True, words="no fault found in the data")
    open_values = fit.identifiability.unresolved
    if open_values:
        more = f"not determined: {', '.join(open_values)}"
        yield Check(good=False, words=f"{len(open_values)} of {fit.nvarys} values open", more=more)
    else:
        yield Check(good=True, words=f"all {fit.nvarys} values determined")


# ---- what limits them ----------------------------------------------------------------------------------------------


def largest_on_trust(fit: FitResult, bar: ErrorBar | None) -> str:
    """The cause that most of an error rests on, as a noun and its size; empty where the noise is more."""
    if bar is None or not bar.trust > bar.noise / 3:
        return ""
    name = bar.largest_on_trust
    return noun_of(fit.causes[name]) if name else ""


def _limit(fit: FitResult, numbers: Sequence[KeyNumber]) -> Limit | None:
    """The largest cause of the first number that is not well known and rests on causes more than on what was read."""
    bars = [(number, bar) for number in numbers if (bar := number.error) is not None and bar.stderr > 0]
    half, small = 0.5, 0.01  # share of a variance that is most of it; error over value that leaves nothing to wish
    number, bar = next(
        (
            (n, bar)
            for n, bar in bars
            if bar.trust**2 > half * bar.stderr**2 and bar.stderr > small * abs(n.quantity.value)
        ),
        (None, None),
    )
    if number is None or bar is None:
        return None
    name, weigh = bar.largest_on_trust, 0.1  # share of the variance from which another number depends on it
    moved = [n for n, other in bars if other.on_trust.get(name, 0.0) ** 2 > weigh * other.stderr**2]
    left = math.sqrt(max(bar.stderr**2 - bar.on_trust[name] ** 2, 0.0))
    effect = f"the error of {number.name} then falls from {number.shown.error} to {significant(left, 2)} at best"
    others = [other.name for other in moved if other is not number]
    return Limit(
        cause=noun_of(fit.causes[name]),
        remedy=fit.causes[name].remedy,
        effect=f"{effect}, that of {' and '.join(others)} too" if others else effect,
    )
