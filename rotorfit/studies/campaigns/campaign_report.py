"""The report of a campaign: how the runs went, how the parameters change with the conditions, and every run."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.digits import counted, significant
from rotorfit.identify.fitting.headline import MOST, Check, both
from rotorfit.identify.fitting.noise.residual_study import MODEL_LIMITED_REDCHI
from rotorfit.identify.fitting.quantities import FittedParameter, Quantity
from rotorfit.lab.data.findings import listed
from rotorfit.show.report.html import Html, bullets, element, picture, table
from rotorfit.show.report.numbers import plain, with_error
from rotorfit.show.report.page import page, write_whole
from rotorfit.show.report.parts import note, section, sentence, symbol, unit_shown
from rotorfit.show.report.verdict import card, check_of, join_spaced
from rotorfit.studies.campaigns.campaign import Campaign
from rotorfit.studies.campaigns.trends import LARGEST_SCATTER, Trend, common_middle


def write_campaign_report(
    campaign: Campaign,
    path: str | os.PathLike[str],
    *,
    against: str | Sequence[str] | None = None,
    by: str | None = None,
    parameters: str | Sequence[str] | None = None,
    degree: int = 1,
    title: str | None = None,
) -> Path:
    """Write the report of a campaign as one self-contained HTML file, whole or not at all.

    Args:
        campaign: the fits of all runs.
        path: file to write; one that is there is replaced.
        against, by, parameters, degree: trends to show, as for :meth:`Campaign.trends`; ``against`` is by default the
            condition of three and more values, if there is one such.
        title: heading.

    Raises:
        KeyError, ValueError: as :meth:`Campaign.trends`.
        OSError: the file cannot be written.

    Example:
        >>> found = rf.campaign(rf.models.WhirlWhip(), rig, split="speed_rpm", known={"K3": 6000.0})
        >>> rf.write_campaign_report(found, folder / "campaign.html").name
        'campaign.html'
    """
    trends: Sequence[Trend] = ()
    figure, table_of_trends = Html(""), []
    against = _varied(campaign) if against is None else against
    if against is not None:
        trends = campaign.trends(parameters, against=against, by=by, degree=degree)
    if trends and against is not None:
        from rotorfit.show.plots.style import HALF, ShownFigure, picture_of

        lines = "straight lines" if degree == 1 else f"polynomials of degree {degree}"
        caption = f"Runs and weighted {lines}, each with one standard error."
        names = list(dict.fromkeys(t.parameter for t in trends))
        halves = [ShownFigure(figsize=(HALF[0], HALF[1] + 0.5), layout="constrained") for _ in names[:2]]
        places: list[Any] = [*zip(names, halves, strict=False), (names, None)]
        drawn = [campaign.plot.trends(n, against=against, by=by, degree=degree, ax=ax) for n, ax in places]
        *first, whole = (picture(picture_of(one), caption, one.get_figwidth()) for one in drawn)
        figure = element("div", *first, class_="pair")
        words = "Scatter: chi-squared per degree of freedom about the line; far above 1, other causes matter too."
        table_of_trends = [
            section(
                "Trends",
                _trend_table(campaign, trends),
                *([whole] if names[2:] else []),
                *(note(t.words.replace("+-", "±")) for t in trends if t.degree > 1),
                *(note(sentence(remark)) for remark in campaign.condition_remarks(against)),
                note(f"{caption} {words}"),
            )
        ]
    sections = [_verdict(campaign, trends, figure), *table_of_trends, _runs(campaign)]
    text = page(title or f"{campaign.rig}: campaign", " · ".join(_byline(campaign)), sections)
    return write_whole(Path(path), text.encode())


def _varied(campaign: Campaign) -> str | None:
    """The one condition that takes three and more values, numbers known of every run."""
    few = 3
    every = {name: [run.attributes.get(name) for run in campaign.runs] for name in campaign.attributes}
    numbers = [name for name, values in every.items() if all(isinstance(value, float | int) for value in values)]
    varied = [name for name in numbers if len(set(every[name])) >= few]
    return varied[0] if len(varied) == 1 else None


def _byline(campaign: Campaign) -> Iterator[str]:
    """Model, runs and conditions."""
    yield campaign.model.name
    yield counted(len(campaign.runs), "run")
    for name in campaign.attributes:
        values = list(dict.fromkeys(run.attributes[name] for run in campaign.runs if name in run.attributes))
        texts = [value for value in values if isinstance(value, str)]
        numbers = [significant(end, 4) for end in (np.min(values), np.max(values))] if not texts else []
        yield f"{name} {listed(texts) if texts else ' to '.join(dict.fromkeys(numbers))}"


def _verdict(campaign: Campaign, trends: Sequence[Trend], figure: Html) -> Html:
    """What changes with the conditions, checks, values, the figure; then what is wrong with single runs."""
    said = _changes(trends) if trends else "Values run by run; no condition was chosen to follow them against."
    content: list[Html] = [element("h2", "Verdict", class_="unseen"), element("p", said, class_="headline")]
    checks = list(_checks(campaign, trends))
    content.append(element("p", *join_spaced(map(check_of, checks)), class_="checks"))
    cards = [*_first_cards(trends), *map(_shared_card, campaign.shared.values())]
    content += [element("div", *cards[:MOST], class_="cards")] if cards else []
    content.append(figure)
    flagged = [f"{run.name}: {run.remark}" for run in campaign.runs if run.remark]
    if flagged:
        content.append(bullets((sentence(text) for text in flagged), class_="warnings"))
    good = all(check.good for check in checks)
    return element("section", *content, id="verdict", class_="first" if good else "first not-good")


def _checks(campaign: Campaign, trends: Sequence[Trend]) -> Iterator[Check]:
    done = [run for run in campaign.runs if run.params and not run.silent]
    answer = f"{len(done)} of {len(campaign.runs)} runs give an answer"
    yield Check(good=len(done) == len(campaign.runs), words=answer)
    redchi = [run.redchi for run in done]
    if redchi:
        missed = sum(one > MODEL_LIMITED_REDCHI for one in redchi)
        more = f"misfit over noise {plain(min(redchi), 3)} to {plain(max(redchi), 3)}"
        words = f"more than noise in {counted(missed, 'run')}" if missed else "runs agree with their noise"
        yield Check(good=not missed, words=words, more=more)
    scatter = [t.scatter for t in trends if np.isfinite(t.scatter)]
    if scatter:
        good, worst = max(scatter) <= LARGEST_SCATTER, plain(max(scatter), 3)
        words = "lines explain the runs" if good else "runs scatter about the lines"
        yield Check(good=good, words=words, more=f"scatter at most {worst}, 1 by noise")


def _changes(trends: Sequence[Trend]) -> str:
    """What each parameter does as each condition grows: a change of three standard errors and more counts."""
    said = []
    for against in dict.fromkeys(t.against for t in trends):
        does: dict[str, list[str]] = {}
        for name in dict.fromkeys(t.parameter for t in trends):
            mine = [t for t in trends if (t.parameter, t.against) == (name, against)]
            ways = {t.group: _way(t.slope) for t in mine}
            for way in dict.fromkeys(ways.values()):
                groups = [group for group, other in ways.items() if other == way]
                which = f" ({' and '.join(groups)})" if len(set(ways.values())) > 1 else ""
                does.setdefault(way, []).append(f"{name}{which}")
        words = [f"{both(names)} {way if names[1:] else _SINGULAR[way]}" for way, names in does.items()]
        said.append(f"As {against} grows, {'; '.join(words)}.")
    return " ".join(said)


_SINGULAR = {"rise": "rises", "fall": "falls", "stay": "stays", "are open": "is open"}


def _way(slope: Quantity) -> str:
    """What a slope says."""
    if not np.isfinite(slope.value):
        return "are open"
    return "stay" if abs(slope.value) < 3 * slope.stderr else "rise" if slope.value > 0 else "fall"


def _first_cards(trends: Sequence[Trend]) -> list[Html]:
    """Values at the middle of the first condition, of as many whole parameters as a first screen has room for."""
    cards: list[Html] = []
    for name in dict.fromkeys(t.parameter for t in trends):
        mine = [t for t in trends if (t.parameter, t.against) == (name, trends[0].against)]
        if len(cards) + len(mine) <= MOST or not cards:
            cards += [_card(t, common_middle(mine)) for t in mine]
    return cards


def _card(trend: Trend, middle: float) -> Html:
    """A parameter at the middle of the tests, and its slope."""
    of = ", ".join(part for part in (trend.parameter, trend.group) if part)
    where = f"at {trend.against} {significant(middle, 4)}"
    slope = f"{_slope(trend)} per {trend.against}"
    more = [element("div", slope if np.isfinite(trend.slope.value) else "one condition", class_="more")]
    return card(f"{of}, {where}", trend.at(middle).shown(), more)


def _slope(trend: Trend) -> str:
    return " ± ".join(with_error(trend.slope.value, trend.slope.stderr))


def _shared_card(parameter: FittedParameter) -> Html:
    """A parameter with one value for all runs."""
    own = Quantity(parameter.value, parameter.stderr, parameter.unit)
    return card(f"{parameter.name}, shared by all runs", own.shown(), [])


def _trend_table(campaign: Campaign, trends: Sequence[Trend]) -> Html:
    rows = [
        [
            symbol(t.parameter, campaign.model),
            t.against,
            t.group,
            str(t.x.size),
            _slope(t) if np.isfinite(t.slope.value) else "–",
            t.slope.unit.replace("1 per", "per"),
            f"{t.scatter:.2f}" if np.isfinite(t.scatter) else "–",
        ]
        for t in trends
    ]
    return table(["parameter", "against", "group", "runs", "slope", "unit", "scatter"], rows, numeric=(3, 4, 6))


def _runs(campaign: Campaign) -> Html:
    head = ["run", *campaign.attributes, *campaign.fitted, "redchi", ""]
    rows = []
    for run in campaign.runs:
        conditions = [run.attributes.get(name, "") for name in campaign.attributes]
        cells = [value if isinstance(value, str) else f"{value:.6g}" for value in conditions]
        for name in campaign.fitted:
            p = run.params.get(name)
            shown = "" if p is None else p.shown().number.replace("+-", "±")
            cells.append(shown)
        rows.append([run.name, *cells, plain(run.redchi, 3) if run.params else "", run.remark])
    numbers = range(1 + len(campaign.attributes), len(head) - 1)
    units = ", ".join(f"{name} in {unit_shown(campaign.unit(name))}" for name in campaign.fitted)
    return section("Runs", table(head, rows, numeric=numbers), note(f"Errors are one standard deviation; {units}."))
