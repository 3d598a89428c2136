"""The report of balancing: what to add where, what then remains, and what that rests on."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from rotorfit.base.digits import significant, with_error
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.headline import MOST, Check, named_by
from rotorfit.identify.fitting.quantities import Shown
from rotorfit.lab.data.balancing import Balance, told
from rotorfit.show.plots.run_up_figure import plot_balance, plot_levels, plot_weights
from rotorfit.show.plots.style import picture_of
from rotorfit.show.report.html import Html, bullets, element, picture, table
from rotorfit.show.report.page import page, write_whole
from rotorfit.show.report.parts import capital, section, sentence
from rotorfit.show.report.verdict import card, check_of, join_spaced


def write_balance_report(
    found: Balance,
    path: str | os.PathLike[str],
    *,
    curve: Balance | None = None,
    errors: Sequence[str] = (),
    source: str = "",
    title: str | None = None,
) -> Path:
    """Write the report of balancing as one self-contained HTML file, whole or not at all.

    Args:
        found: the weights, of :func:`rotorfit.balance`.
        path: file to write; one that is there is replaced.
        curve: vibration over the speeds of start-ups, of :func:`rotorfit.run_up`, drawn in place of that at dwells.
        errors: what the check of the readings found wrong.
        source: file of the readings.
        title: heading.

    Raises:
        OSError: the file cannot be written.

    Example:
        >>> weighed = rf.influence(rf.read(rf.datasets.path("rk4_sync.csv")))
        >>> rf.write_balance_report(rf.balance(weighed, planes=["disk2"]), folder / "balance.html").name
        'balance.html'
    """
    words = "Amplitude at each probe as it is (dashed) and with the weights, with its 95 % band."
    drawn = plot_balance(found if curve is None else curve)
    sections = [
        _verdict(found, errors),
        section("Weights", _weights(found), *_mounted(found)),
        section("Vibration", picture(picture_of(drawn), words, drawn.get_figwidth()), _readings(found), figure=True),
    ]
    speeds = np.unique(np.round(found.speed * RPM_PER_RAD_S)).astype(int).tolist()
    byline = [
        f"weights in {', '.join(found.planes)}",
        f"{len(found.readings)} readings",
        f"{_ends(speeds)} rpm",
        source,
    ]
    text = page(title or f"{named_by([source])}: balancing", " · ".join(filter(None, byline)), sections)
    return write_whole(Path(path), text.encode())


def _ends(speeds: Sequence[int]) -> str:
    few = 3  # speeds that are named each
    return ", ".join(map(str, speeds)) if len(speeds) <= few else f"{speeds[0]} to {speeds[-1]}"


def _verdict(found: Balance, errors: Sequence[str]) -> Html:
    said = (
        found.verdict.replace(" +- ", "\u00a0±\u00a0").replace(" um", "\u00a0µm")
        or "No run tells what weights do here."
    )
    checks = list(_checks(found, errors))
    content = [element("h2", "Verdict", class_="unseen"), element("p", said, class_="headline")]
    content.append(element("p", *join_spaced(map(check_of, checks)), class_="checks"))
    content += [bullets((sentence(words) for words in errors), class_="warnings")] if errors else []
    content.append(element("div", *list(_cards(found))[:MOST], class_="cards"))
    pair = [(plot_weights(found), "Weights by amount and angle"), (plot_levels(found), "Readings before and after")]
    drawn = (picture(picture_of(one), words, one.get_figwidth()) for one, words in pair)
    content.append(element("div", *drawn, class_="pair"))
    content += [bullets((sentence(words) for words in found.remarks), class_="note")] if found.remarks else []
    good = all(check.good for check in checks)
    return element("section", *content, id="verdict", class_="first" if good else "first not-good")


def _checks(found: Balance, errors: Sequence[str]) -> Iterator[Check]:
    yield Check(good=not errors, words="an error in the readings" if errors else "no error found in the readings")
    open_ones = int(np.isnan(found.expected).sum())
    words = f"{open_ones} of {len(found.readings)} readings not controlled" if open_ones else "every reading controlled"
    yield Check(good=not open_ones, words=words)
    told = bool(np.isfinite(found.stderr[np.isfinite(found.expected)]).all())
    yield Check(good=told, words="errors known" if told else "no error known: noise nor repeats were given")
    if found.at_limit:
        yield Check(good=False, words=f"at its limit: {', '.join(found.at_limit)}")


def _cards(found: Balance) -> Iterator[Html]:
    """Amount and angle in each plane, and the largest vibration that remains."""
    for plane, amount, angle in _shown(found):
        yield card(capital(f"{plane}, amount"), amount, [])
        lag = element("div", f"lag {_turned(-float(angle.value))}°", class_="more")
        yield card(capital(f"{plane}, angle (force_phase_deg)"), angle, [lag])
    if np.isfinite(found.expected).any():
        worst = int(np.nanargmax(np.abs(found.expected)))
        size, reach = (1e6 * one for one in (abs(found.expected[worst]), found.reaches[worst]))
        where = f"{' '.join(found.readings[worst])} at {found.speed[worst] * RPM_PER_RAD_S:.0f} rpm"
        shown = _within(size, max(size - reach, 0.0), size + reach, "µm 0-pk")
        yield card(f"Largest that remains, {where}", shown, [])


def _turned(degrees: float) -> str:
    return f"{degrees % 360:.1f}"


def _within(value: float, low: float, high: float, unit: str) -> Shown:
    """A value with its 95 % interval, all to the second digit of half of that; alone where there is none."""
    reach = high - value
    if not (np.isfinite(reach) and reach > 0):
        return Shown(value=significant(value, 4), unit=unit)
    ends = {name: with_error(end, reach)[0] for name, end in (("value", value), ("low", low), ("high", high))}
    return Shown(unit=unit, **ends)


def _shown(found: Balance) -> Iterator[tuple[str, Shown, Shown]]:
    """Each plane with its amount and angle and their 95 % intervals."""
    for plane, weight in zip(found.planes, found.weight.tolist(), strict=True):
        (low, high), (early, late) = found.interval(plane)
        exact = not np.isfinite(high) or high == low
        amount = _within(1e6 * abs(weight), 1e6 * low, 1e6 * high, "g mm")
        turned = {} if exact else {"low": _turned(np.degrees(early)), "high": _turned(np.degrees(late))}
        yield plane, amount, Shown(value=_turned(np.degrees(np.angle(weight))), unit="°", **turned)


def _weights(found: Balance) -> Html:
    rows = [
        [plane, amount.value, _interval(amount), angle.value, _interval(angle), _turned(-float(angle.value))]
        for plane, amount, angle in _shown(found)
    ]
    head = ["plane", "g mm", "95 %", "force_phase_deg", "95 %", "force_phase_lag_deg"]
    return table(head, rows, numeric=range(1, 6))


def _interval(shown: Shown) -> str:
    return f"{shown.low} to {shown.high}" if shown.low else ""


def _mounted(found: Balance) -> Iterator[Html]:
    rows = [
        [plane, significant(mr * 1e6, 4), f"{np.degrees(at) % 360:.1f}"]
        for plane, pair in found.holes.items()
        for at, mr in pair
    ]
    if rows:
        yield element("h3", "To mount")
        yield table(["plane", "g mm", "at degrees (force_phase_deg)"], rows, numeric=(1, 2))


def _readings(found: Balance) -> Html:
    rows = []
    for (plane, direction), speed, before, after, half in zip(
        found.readings, found.speed, found.before, found.expected, found.reaches.tolist(), strict=True
    ):
        left, reach = told(abs(after) * 1e6, half * 1e6)
        sizes = ((significant(abs(before) * 1e6, 3), before), (left, after))
        cells = (f"{s} @ {np.degrees(np.angle(v)):.0f}°" if np.isfinite(v) else "not known" for s, v in sizes)
        rows.append([f"{plane} {direction}", f"{speed * RPM_PER_RAD_S:.0f}", *cells, reach.strip("+-? ")])
    return table(["probe", "rpm", "as it is, µm 0-pk", "expected", "± 95 %"], rows, numeric=(1, 2, 3, 4))
