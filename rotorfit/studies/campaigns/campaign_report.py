"""The report of a campaign: how the runs went, how the parameters change with the conditions, and every run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rotorfit.base.digits import plus_minus
from rotorfit.show.report.html import Html, bullets, paragraph, picture, table
from rotorfit.show.report.numbers import plain, with_error
from rotorfit.show.report.page import page, write_whole
from rotorfit.show.report.parts import note, section, sentence, symbol, unit_shown
from rotorfit.studies.campaigns.campaign import Campaign
from rotorfit.studies.campaigns.trends import Trend


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
        against, by, parameters, degree: trends to show, as for :meth:`Campaign.trends`; none without ``against``.
        title: heading.

    Raises:
        KeyError, ValueError: as :meth:`Campaign.trends`.
        OSError: the file cannot be written.

    Example:
        >>> found = rf.campaign(rf.models.WhirlWhip(), rig, split="speed_rpm", known={"K3": 6000.0})
        >>> rf.write_campaign_report(found, folder / "campaign.html").name
        'campaign.html'
    """
    sections = [_verdict(campaign)]
    if against is not None:
        trends = campaign.trends(parameters, against=against, by=by, degree=degree)
        if trends:
            from rotorfit.show.plots.style import picture_of

            figure = campaign.plot.trends(parameters, against=against, by=by, degree=degree)
            lines = "straight lines" if degree == 1 else f"polynomials of degree {degree}"
            caption = f"Runs and weighted {lines}, each with one standard error."
            words = "Scatter: chi-squared per degree of freedom about the line; far above 1, other causes matter too."
            sections.append(
                section(
                    "Trends",
                    picture(picture_of(figure), caption, figure.get_figwidth()),
                    _trend_table(campaign, trends),
                    *(note(t.words.replace("+-", "±")) for t in trends if t.degree > 1),
                    *(note(sentence(remark)) for remark in campaign.condition_remarks(against)),
                    note(words),
                )
            )
    sections.append(_runs(campaign))
    text = page(title or f"Campaign: {campaign.model.name}", f"{len(campaign.runs)} runs", sections)
    return write_whole(Path(path), text.encode())


def _verdict(campaign: Campaign) -> Html:
    fitted = [run for run in campaign.runs if run.params]
    useful = [run for run in fitted if not run.silent]
    words = f"{len(useful)} of {len(campaign.runs)} runs give an answer"
    redchi = [run.redchi for run in useful]
    if redchi:
        words += f"; misfit over noise (redchi) {plain(min(redchi), 3)} to {plain(max(redchi), 3)}"
        words += f", median {plain(float(np.median(redchi)), 3)}"
    content: list[Html] = [paragraph(sentence(words))]
    flagged = [f"{run.name}: {run.remark}" for run in campaign.runs if run.remark]
    if flagged:
        content.append(bullets((sentence(text) for text in flagged), class_="warnings"))
    if campaign.shared:
        rows = [
            [symbol(p.name, campaign.model), *with_error(p.value, p.stderr), unit_shown(p.unit), p.meaning]
            for p in campaign.shared.values()
        ]
        head = ["shared by all runs", "value", "standard error", "unit", "meaning"]
        content.append(table(head, rows, numeric=(1, 2)))
    return section("Verdict", *content)


def _trend_table(campaign: Campaign, trends: Sequence[Trend]) -> Html:
    rows = [
        [
            symbol(t.parameter, campaign.model),
            t.against,
            t.group,
            str(t.x.size),
            plus_minus(t.slope.value, t.slope.stderr).replace("+-", "±") if np.isfinite(t.slope.value) else "–",
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
