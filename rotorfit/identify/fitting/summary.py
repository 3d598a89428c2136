"""Results as text tables, and in a notebook as HTML, made of escaped text."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from operator import add, mul, sub, truediv
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.digits import significant, two_digits, with_error
from rotorfit.base.text_table import Wide, text_html, text_table
from rotorfit.base.units import RPM_PER_RAD_S, shown_units
from rotorfit.base.version import __version__
from rotorfit.estimators.misfit.parameter_space import DATUM
from rotorfit.estimators.starting.start_points import EARLIER_FIT, GIVEN
from rotorfit.identify.fitting.anisotropy import lines_cut_off, unstable_speeds
from rotorfit.identify.fitting.causes.table import size_of
from rotorfit.identify.fitting.headline import (
    Headline,
    decrement_of,
    headline,
    largest_on_trust,
    leads_of,
    modes_at,
    named_modes,
    rig_name,
    task_of,
    top_speed,
)
from rotorfit.identify.fitting.noise.record import NoiseVerdict, is_run_effect
from rotorfit.identify.fitting.noise.residual_study import VERDICTS
from rotorfit.identify.fitting.notices import notices_of
from rotorfit.identify.fitting.onset import onset_note
from rotorfit.identify.fitting.quantities import FittedParameter, Number, Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import lines_by_condition
from rotorfit.lab.data.findings import Finding, errors_in, of_the_fit
from rotorfit.models import RotorModel, eigenvalues
from rotorfit.models.motion.modes import OVERDAMPED
from rotorfit.models.parameters import bare_name
from rotorfit.models.shafts.angular_rates import HIGHEST_RATE
from rotorfit.models.structure import block_parameters, block_symbols

if TYPE_CHECKING:
    from rotorfit.estimators.inference.identifiability import Combination
    from rotorfit.identify.fitting.noise.residual_study import ResidualStudy
    from rotorfit.identify.fitting.quantities import FittedParameter

WIDTH = 88
"""Letters of the longest line."""

_FEW = 15  # degrees of freedom below which 1.96 standard errors are well short of a 95 % interval


_MEANT: dict[str, tuple[str, Callable[[Number, Number], Quantity]]] = {
    "sum": ("+", add),
    "difference": ("-", sub),
    "product": ("*", mul),
    "ratio": ("/", truediv),
}
"""Sign of what is determined of two parameters, and how it is made of them."""


def combined(fit: FitResult, combination: Combination) -> str:
    """The combination of two undetermined parameters that the data do determine, with its error; else empty."""
    if combination.kind not in _MEANT:
        return ""
    first, second = (fit.params[name] for name in combination.names)
    sign, of = _MEANT[combination.kind]
    found = of(first, second)
    unit = f" {first.unit}" if combination.kind in ("sum", "difference") and first.unit != "1" else ""
    return f"{first.name} {sign} {second.name} = {found.shown().number}{unit}"


def fit_summary(fit: FitResult) -> str:
    """Errors of the data, then :func:`fit_table`, and what the diagnosis found of the fit itself."""
    more = [line for one in of_the_fit(fit.findings) for line in _wrapped(f"warning: {one.words}")]
    return "\n".join([*error_lines(fit.findings), fit_table(fit), *more])


def fit_head(fit: FitResult) -> str:
    """The first lines of :func:`fit_summary`: verdict and five numbers."""
    return "\n".join([*error_lines(fit.findings), *_head(headline(fit))])


def error_lines(findings: Iterable[Finding]) -> list[str]:
    """Errors of the data, which void all that follows."""
    errors = (f"ERROR in the data, no number below can be relied on: {words}" for words in errors_in(findings))
    return [line for words in errors for line in _wrapped(words)]


def _wrapped(line: str, indent: str = "  ") -> list[str]:
    """A line that may be longer than the page, in lines that are not."""
    return textwrap.wrap(line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _head(head: Headline) -> list[str]:
    """Rig, model and version; the verdict; five numbers with their errors and what most of these rests on."""
    fit = head.fit
    title, version = f"{rig_name(fit)}: {task_of(fit)}, {fit.model.name}", f"rotorfit {__version__}"
    lines = [f"{title:{WIDTH - len(version) - 1}} {version}", *_wrapped(head.verdict, "")]
    if not head.numbers:
        return lines
    rows: list[list[str | Wide]] = [["", "value", "+-", "95 % interval", "unit"]]
    rests = ["largest on trust"]
    for number in head.numbers:
        shown, meaning = number.shown, number.meaning
        if len(meaning) > 21:  # letters that there is room for
            meaning = textwrap.shorten(_noun(meaning), 21, placeholder="")
        named = number.name if number.is_named else f"{number.name:<4} {meaning}"
        ends = f"{shown.low} to {shown.high}" if shown.low else ""
        rows.append([named, shown.value, shown.error, ends, shown.unit] if number.known else [named, shown.value])
        rests.append(largest_on_trust(fit, number.error))
    table = text_table(rows, "<24 >8 >7 >17 <1")
    room = WIDTH - max(map(len, table)) - 2
    beside = [f"{line:{WIDTH - room}}{_within(rest, room)}".rstrip() for line, rest in zip(table, rests, strict=True)]
    return [*lines, "", *beside]


def _within(cause: str, room: int) -> str:
    """A cause and its size, or as much of both as there is room for."""
    noun, _, size = cause.rpartition(", ")
    shorter = (f"{noun} {size}".strip(), noun, _noun(noun), "")
    return next(words for words in shorter if len(words) <= room or not words)


def _noun(words: str) -> str:
    """Words without where, of what and by what."""
    return re.split(r",| (?:of|at|in|by|over|that|to|between) ", words)[0]


def fit_table(fit: FitResult, findings: Sequence[Finding] | None = None) -> str:
    """Verdict and five numbers, what to do next, the fit in a line each, parameters, modes, causes, notes.

    ``findings`` are those of the data, by default what the fit itself found.
    """
    head = headline(fit, findings)
    blocks = getattr(fit.model, "blocks", ())
    words = ", ".join(f"{block.replace('_', ' ')} ({block_symbols([block])})" for block in blocks)
    folded = [f"corrected for {words}: {len(correction_names(fit.model))} values, listed last"] if blocks else []
    # ``known`` values and shares of errors stand in the table; below it is what a reader looks up.
    conditions = lines_by_condition(fit)
    below = [] if conditions and not fit.identifiability.unresolved else _verdict_lines(fit)
    below += [
        f"  - determined: {words}" for words in (combined(fit, c) for c in fit.identifiability.combinations) if words
    ]
    pairs = [] if conditions else notable_correlations(fit)
    if pairs:
        below.append("correlations: " + ", ".join(f"{a}-{b} {r:+.2f}" for a, b, r in pairs))
    below += _stability_lines(fit) if fit.success else ["threshold speed: not given, because the fit did not converge"]
    below += interval_lines(fit)
    below += _cause_lines(fit)
    below += [f"start: {start_words(fit)}"] if fit.nfev and not conditions else []
    own = [one for one in notices_of(fit) if one.origin != "noise" or one.severity != "note"]
    below += [f"note: {one.message}" for one in own if one.severity == "note"]
    below += [f"warning: {one.message}" for one in own if one.severity != "note"]
    corrections = _parameter_lines(fit, folded=True)
    parts = [
        _head(head),
        _wrapped(f"To do next: {head.limit.remedy}; {head.limit.effect}.") if head.limit else [],
        [line for name, said in _about(fit) for line in _wrapped(f"{name:<9}{said}", " " * 9)] + _noise_lines(fit),
        [*(conditions or _parameter_lines(fit)), *folded],
        _mode_lines(fit),
        [line for words in below for line in _wrapped(words, " " * (len(words) - len(words.lstrip()) + 2))],
        ["structural corrections", *corrections] if corrections else [],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _verdict_lines(fit: FitResult) -> list[str]:
    return f"identifiability: {fit.identifiability}".splitlines()


def _about(fit: FitResult) -> Iterator[tuple[str, str]]:
    """The fit and its data in a line each."""
    limit = f" (noise alone: at most {significant(fit.largest_redchi, 3)})" if fit.problem.loss == "linear" else ""
    misfit = f"redchi {significant(fit.redchi, 4)}{limit}"
    yield "FIT", f"{fit.method}, {fit.ndata} real data, {fit.nvarys} fitted values, {misfit}; {fit.message}"
    tests = fit.experiments
    w = np.concatenate([np.zeros(0), *(test.frequencies for test in tests)])
    runs = sum(len(test.runs) for test in tests)
    said = [f"{runs} {'run' if runs == 1 else 'runs'}"]
    for what, names in (
        ("forced at", dict.fromkeys(name for test in tests for name in test.forces)),
        ("read at", dict.fromkeys(name for test in tests for name in test.planes)),
    ):
        said += [f"{what} {', '.join(names)}"] * bool(names)
    if w.size:
        said.append(shown_units().rates(w.min(), w.max()))
    yield "DATA", ", ".join(said)


def _mode_lines(fit: FitResult) -> list[str]:
    """Modes at the highest tested speed, of a rotor that is judged by its modes."""
    if not fit.success or fit.model.turns or "least damping" not in leads_of(fit):
        return []
    speed = top_speed(fit)
    where = f"MODES at {significant(speed * RPM_PER_RAD_S, 4)} rpm" if speed else "MODES"
    unit = shown_units().rate_name
    rows = [[where, f"frequency, {unit}", "damping ratio", "log. decrement"]]
    for name, frequency, ratio in named_modes(modes_at(fit, speed), sensed=speed > 0):
        way = {"F": "forward", "B": "backward"}.get(name[-1], "")
        swings = abs(ratio.value) < OVERDAMPED
        cells = [abs(frequency).to(unit).shown().number, ratio.shown().number] if swings else ["overdamped", ""]
        rows.append([f"{name}  {way}".rstrip(), *cells, decrement_of(ratio).shown().number if swings else ""])
    return text_table(rows, "<22 >18 >22 >20") if rows[1:] else []


def _cause_lines(fit: FitResult) -> list[str]:
    """Causes that the data show, and those on trust that the errors mostly rest on."""
    rows = fit.causes
    lines: list[str] = []
    shares: dict[str, list[str]] = {}
    for p in fit.params.values():
        if p.vary and p.error is not None and p.error.trust > p.error.noise:
            shares.setdefault(p.error.largest_on_trust, []).append(p.name)
    onset = _shown_onset(fit) if fit.success else None
    if onset is not None and onset.error is not None and onset.error.trust > onset.error.noise:
        shares.setdefault(onset.error.largest_on_trust, []).append("threshold speed")
    if shares:
        lines.append("errors rest on these sizes, which the data cannot check (fit.causes has all):")
    for name, moved in shares.items():
        row = rows[name]
        named = ", ".join(_of_all_groups(fit, moved))
        lines.append(f"  - {name} {size_of(row)} ({row.meaning}): {named}; to bound it, {row.remedy}")
    return lines


def _of_all_groups(fit: FitResult, names: Iterable[str]) -> Iterable[str]:
    """Names of parameters, once where all groups of one are among them."""
    own, every = (Counter(map(bare_name, some)) for some in (names, fit.params))
    return dict.fromkeys(bare_name(n) if own[bare_name(n)] == every[bare_name(n)] else n for n in names)


def _shown_onset(fit: FitResult) -> Quantity | None:
    """The threshold speed, where the summary prints one."""
    if not fit.model.speed_dependent or fit.problem.space.index.shape[0] > 1:
        return None
    found = fit.threshold_speed()
    return found if np.isfinite(found.stderr) and np.isfinite(found.value) and found.value else None


def start_words(fit: FitResult) -> str:
    """Where the search began, with the names of the values that the user gave."""
    some = ", ".join(fit.settings.start) if fit.start not in (GIVEN, EARLIER_FIT) else ""
    return f"{fit.start}, with {some} given" if some else fit.start


def _noise_lines(fit: FitResult) -> list[str]:
    """The verdict on the residuals, where they are not the noise as expected; warnings say the rest."""
    noise = fit.noise
    if noise is None or (noise.verdict is NoiseVerdict.AS_FOUND and not noise.sentences):
        return []
    words = f"NOISE    {VERDICTS[noise.verdict]} (neighbouring lines correlate by {noise.correlation:+.2f})"
    lines = _wrapped(words, " " * 9)
    lines += _levels(noise)
    for note in noise.notes:
        lines += _wrapped(f"  - {note.message}", "    ")
    if noise.effects and fit.success and np.unique(fit.problem.run).size > 2:  # beside the random effect
        left_out = fit.jackknife()
        names = [name for name in fit.problem.space.names if fit.params[name].resolved]
        errors = {name: left_out.parameter(name).stderr for name in names}
        shown = [f"{name} {two_digits(error)}" for name, error in errors.items() if np.isfinite(error)]
        lines += [f"  - standard errors from leaving out runs one by one: {', '.join(shown)}"] * bool(shown)
    few = [p for p in fit.params.values() if p.vary and p.resolved and p.freedom < _FEW]
    for p in few:
        low, high = p.interval(0.95, share="noise")
        how = f"(Student's t, {significant(p.freedom, 2)} degrees of freedom)"
        lines.append(f"  - {p.name}: 95 % interval {low:.6g} to {high:.6g} {p.unit} {how}")
    return lines


def _levels(noise: ResidualStudy) -> list[str]:
    """Noise of each response, or of many the range by plane."""
    few_responses = 6  # whose noise is listed one by one
    if len(noise.response_noise) > few_responses:
        by_plane: dict[tuple[str, str], list[float]] = {}
        for level in noise.response_noise:
            for response in level.responses:
                by_plane.setdefault((response.rpartition(" / ")[2], level.unit), []).append(level.constant)
        return [
            f"  - {where}: {_small(min(sizes), unit)} to {_small(max(sizes), unit)} (rms), {len(sizes)} responses"
            for (where, unit), sizes in by_plane.items()
        ]
    lines = []
    for level in noise.response_noise:
        more = f" and {len(level.responses) - 3} more" if level.responses[3:] else ""
        where = ", ".join(level.responses[:3]) + more
        share = f", and {significant(100 * level.share, 2)} % {level.along}" if level.share else ""
        lines.append(f"  - {where}: {_small(level.constant, level.unit)} (rms){share}")
    return lines


def _small(value: float, unit: str) -> str:
    """A noise level: motion in millionths, as probes are read."""
    return f"{two_digits(1e6 * value)} u{unit}" if unit in ("m", "rad") else f"{two_digits(value)} {unit}".rstrip()


def correction_names(model: RotorModel) -> set[str]:
    """Names of the parameters of structural blocks, which correct a lumped model."""
    blocks = getattr(model, "blocks", ())
    return {own.name for own in block_parameters(blocks, len(model.planes))} if blocks else set()


def _parameter_lines(fit: FitResult, *, folded: bool = False) -> list[str]:
    """Lines of the parameter table; a parameter that the data do not determine shows no number."""
    more = bool(fit.causes.rows)
    errors = ["stderr", *(["noise", "bounded", "on trust"] * more)]
    rows: list[list[str | Wide]] = [["parameter", "value", *errors, "unit", ""]]
    corrections = correction_names(fit.model)
    shown = [p for p in in_order(fit.params.values()) if (bare_name(p.name) in corrections) == folded]
    rows += [_row(p, more) for p in shown]
    table = text_table(rows, "<10 >12 " + " ".join([">11"] * len(errors)) + " <1 <1")
    return [line[:WIDTH].rstrip() for line in table] if shown else []


def in_order(params: Iterable[FittedParameter]) -> list[FittedParameter]:
    """Parameters as they come, but those of one name by the numbers of their groups: 500 rpm before 1000 rpm."""
    every = list(params)
    place = {bare_name(p.name): -i for i, p in reversed(list(enumerate(every)))}
    return sorted(every, key=lambda p: (-place[bare_name(p.name)], natural(p.name)))


def natural(text: str) -> tuple[tuple[int, float, str], ...]:
    """Key that sorts words by the numbers in them: 500 before 1000."""
    parts = re.split(r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)", text)
    return tuple((0, float(p), "") if i % 2 else (1, 0.0, p) for i, p in enumerate(parts) if p)


def _row(p: FittedParameter, more: bool) -> list[str | Wide]:
    shown, room = p.shown(), 1 + 3 * more
    if not p.determined:
        return [p.name, Wide(f"{shown.value} by the data", 1 + room), p.unit]
    errors = p.shares()[:room]
    if not p.vary:
        return [p.name, shown.value, *(errors or [Wide("known", room)]), p.unit, "known" if errors else ""]
    return [p.name, shown.value, *errors, p.unit, "at its bound" if p.at_bound else ""]


def interval_lines(fit: FitResult) -> list[str]:
    """Natural frequencies of modes in rpm and the common datum angle in degrees, with 95 % intervals."""
    shown = [(name, "rpm", RPM_PER_RAD_S) for name in fit.params if fit.model.name == "modal" and name.startswith("wn")]
    shown += [(name, "deg", 180 / np.pi) for name in fit.params if name == DATUM]
    tail = f" (Student's t, {fit.freedom:.0f} degrees of freedom)" if np.isfinite(fit.freedom) else ""
    lines = []
    for name, unit, scale in shown:
        p = fit.params[name]
        words = "common datum angle, by which responses lead forces" if name == DATUM else f"natural frequency {name}"
        if not p.resolved:
            lines.append(f"{words}: not determined by these data")
            continue
        low, high = (scale * end for end in fit.interval(name))
        lines.append(
            f"{words}: {significant(scale * p.value, 5)} {unit}, 95 % interval {significant(low, 5)} to "
            f"{significant(high, 5)} {unit}{tail}"
        )
    return lines


def notable_correlations(fit: FitResult) -> list[tuple[str, str, float]]:
    """Pairs of resolved parameters with a correlation beyond 0.9 in size, strongest first, at most eight."""
    error = np.sqrt(np.maximum(np.diag(fit.covar), 0.0))
    found = []
    notable_correlation = 0.9
    for i, a in enumerate(fit.var_names):
        for j, b in enumerate(fit.var_names[:i]):
            if is_run_effect(a) or is_run_effect(b):
                continue
            if error[i] > 0 and error[j] > 0 and fit.params[a].resolved and fit.params[b].resolved:
                r = float(fit.covar[i, j] / (error[i] * error[j]))
                if abs(r) > notable_correlation:
                    found.append((b, a, r))
    return sorted(found, key=lambda pair: -abs(pair[2]))[:8]


def _turning_lines(fit: FitResult) -> list[str]:
    """The turning anisotropy and the speeds at which it makes the shaft run away."""
    found = [f"turning anisotropy: {fit.turning_anisotropy()}"]
    theta = fit.theta()
    top = min(3 * float(np.abs(eigenvalues(fit.model, theta, 0.0)).max()), HIGHEST_RATE)
    bands = RPM_PER_RAD_S * np.asarray(unstable_speeds(fit.model, theta, top)).reshape(-1, 2)
    shown = [f"{low:.1f} to {high:.1f} rpm" for low, high in bands.tolist()]
    if terms := fit.model.line_count // 2 - 1:
        size, share = lines_cut_off(fit)
        found.append(
            f"lines left out change those fitted by {significant(size, 1)} of the largest at most, "
            f"{significant(share, 1)} of a standard deviation (terms={terms})"
        )
    return [*found, "unstable by turning anisotropy: " + (", ".join(shown) or "at no speed, it is damped")]


def _stability_lines(fit: FitResult) -> list[str]:
    if "dK_cos" in fit.model.parameter_names and fit.problem.space.index.shape[0] == 1:
        return _turning_lines(fit)
    if not fit.model.speed_dependent or fit.problem.space.index.shape[0] > 1:
        return []
    onset = fit.threshold_speed()
    note = onset_note(fit, 0)
    if np.isinf(onset.stderr):
        return [f"threshold speed: not determined by these data{': ' + note if note else ''}"]
    if np.isnan(onset.value):
        return ["threshold speed: none found, stable at every speed searched"]
    if onset.value == 0:
        return ["threshold speed: 0, the fitted rotor is unstable from standstill on"]
    line = f"threshold speed: {onset.to('rpm')}, whirl ratio at onset {fit.whirl_ratio():.3f}"
    highest = float(fit.speeds.max(initial=0.0))
    if highest > 0:
        percent = 100 * (onset.value / highest - 1)
        line += f"; {significant(abs(percent), 3)} % {'above' if percent >= 0 else 'below'} the highest tested speed"
        line += f" ({highest * RPM_PER_RAD_S:.0f} rpm)" + (": extrapolated" if percent > 0 else "")
    return [line] + [f"  - {note}"] * bool(note)


def fit_html(fit: FitResult) -> str:
    """Parameters as a table, the rest of the summary below it."""
    rows = ""
    shares = ("stderr", "noise", "bounded", "trust", "low", "high", "largest on trust", "plain")
    for p in in_order(fit.params.values()):
        shown, errors = p.shown(), [""] * len(shares)
        if own := p.shares():
            largest = p.error.largest_on_trust if p.error else ""
            errors = [*own, shown.low, shown.high, largest, with_error(p.plain, p.stderr)[0] if p.vary else "known"]
        elif not p.vary:
            errors[0] = "known"
        cells = (p.name, shown.value, *errors, "" if p.unit == "1" else p.unit, p.meaning)
        rows += "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
    head = "".join(f"<th>{name}</th>" for name in ("parameter", "value", *shares, "unit", "meaning"))
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    first, text = fit_head(fit), fit.summary()
    rest = text.removeprefix(first).replace("\n".join(_parameter_lines(fit)), "", 1)
    return f"{text_html(first)}{table}{text_html(rest.strip(chr(10)))}"
