"""The data of a session: what was recognised, forms that correct it, signals to look through, readings to brush."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, HoverTool

from rotorfit.apps.app import parts
from rotorfit.apps.app.forms import SetupForm, read_form
from rotorfit.apps.app.results import finding_parts
from rotorfit.apps.app.session import entry_table
from rotorfit.apps.app.signals import SignalsView
from rotorfit.apps.app.work import read
from rotorfit.apps.study_files.text import describe_test
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.recordings.summary import summary
from rotorfit.show.plots.style import colour_of
from rotorfit.show.report.html import element

if TYPE_CHECKING:
    from rotorfit.apps.app.session import Front
    from rotorfit.lab.recordings.recording import Recording


class DataView:
    """Parts of the page that show the data."""

    def __init__(self, page: Front) -> None:
        self._page, self._session = page, page.session
        self._signals: SignalsView | None = None
        self._looked = pn.Column(**parts.WIDE)
        self._shown = pn.Column(**parts.WIDE)
        entries = enumerate(self._session.content["files"])
        forms = [read_form(page, number) for number, entry in entries if "path" in entry_table(entry)]
        self.parts = [parts.heading("What was recognised"), *self._tests(), *forms, *self._recorded()]

    # ---- tests ----------------------------------------------------------------------------------------------------

    def _tests(self) -> list[Any]:
        listed: list[Any] = []
        for number, (test, findings) in enumerate(zip(self._session.experiments, self._session.findings, strict=True)):
            words = [line for line in describe_test(test, ()).splitlines() if "check: " not in line]
            listed.append(parts.markup(element("pre", "\n".join(words))))
            undo = self._page.undo_in_data
            listed += [part for found in findings for part in finding_parts(found, undo, "Undo this in the data")]
            if not findings:
                listed.append(parts.message("The check of the data found nothing.", "good"))
            listed.append(self._readings(number))
        undone = self._session.content.get("undo", ())
        if undone:
            back = parts.button(
                "Take the data as they were given", lambda: self._page.change(self._session.with_all_errors)
            )
            listed += [parts.message(f"Undone in the data: {', '.join(undone)}.", "warning"), back]
        return listed

    def _readings(self, number: int) -> Any:
        """The readings of a test to be brushed, and what can be done with those that are."""
        brushed: set[int] = set()
        skipped = self._session.skipped(number)
        change, session = self._page.change, self._session

        def skip(rows: Callable[[], Set[int]]) -> None:
            change(lambda: session.with_skipped(number, rows()))

        leave = parts.button("Leave out what is brushed", lambda: skip(lambda: skipped | brushed))
        back = parts.button("Take it again", lambda: skip(lambda: skipped - brushed))
        leave.disabled = back.disabled = True

        def on_brush(rows: set[int]) -> None:
            brushed.clear()
            brushed.update(rows)
            leave.disabled, back.disabled = not rows - skipped, not rows & skipped

        data = self._session.data
        figures = [] if data is None else readings_figures(data.experiments[number], skipped, on_brush)
        if data is None or not figures:
            return pn.Column()
        out = (
            [parts.markup(element("p", f"{len(skipped)} readings are left out, drawn as crosses."))] if skipped else []
        )
        colours = colours_of_runs(data.experiments[number])
        key = parts.colour_key("Draw a box or a lasso around readings to leave them out.", colours)
        return pn.Column(key, parts.figures_beside(figures), parts.in_a_row(leave, back), *out, **parts.WIDE)

    # ---- recordings -----------------------------------------------------------------------------------------------

    def _recorded(self) -> list[Any]:
        records, raw = self._session.records, self._session.recorded
        if not raw:
            return []
        try:
            setup = [SetupForm(self._page, [self._session.folder.path(name) for name in raw]).card]
        except (ValueError, OSError):  # the file itself cannot be read, which has been said
            setup = []
        if not records:
            return setup
        known = {record.name: record for record in records}
        chosen = pn.widgets.Select(name="Recording", options=list(known), width=220)
        plane = pn.widgets.Select(name="Plane", options=list(records[0].planes), width=160)
        unread = self._session.data is None
        make = parts.button("Make vectors of the recordings", lambda: self._page.start(read), main=unread)

        def choose(_: Any) -> None:
            plane.param.update(options=list(known[chosen.value].planes))
            self._look(known[chosen.value], plane.value)

        chosen.param.watch(choose, "value")
        plane.param.watch(lambda event: self._look(known[chosen.value], event.new), "value")
        return [self._looked, parts.in_a_row(chosen, plane, make), self._shown, *setup]

    def complete(self) -> None:
        """Show the first recording, then what takes longer: what is linked to the cursor, and what is odd."""
        records = self._session.records
        if not records:
            return
        self._looked.objects = [parts.markup(element("pre", "\n".join(record.name for record in records)))]
        self._look(records[0], records[0].planes[0])
        listed: list[Any] = []
        for record in records:
            try:
                words = [line for line in summary(record).splitlines() if "[" not in line or "] " not in line]
                listed += [
                    parts.markup(element("pre", "\n".join(words))),
                    *map(parts.markup, map(parts.finding_words, record.findings)),
                ]
            except ValueError as problem:
                listed.append(parts.message(sentence(problem), "error"))
            self._looked.objects = listed

    def _look(self, record: Recording, plane: str) -> None:
        """Show a plane of a recording."""
        at = None if self._signals is None or self._signals.record is not record else self._signals.at
        self._signals = shown = SignalsView(record, plane, at)
        self._shown.objects = [shown.view]
        shown.complete()


_BRUSHED = "#b34700"
"""Colour of readings that are brushed."""


def readings_figures(test: Experiment, skipped: Set[int], on_brush: Callable[[set[int]], None]) -> list[Any]:
    """A figure of amplitude and phase for each channel of a perturbation test, brushed together.

    Rows that are left out are crosses; ``on_brush`` is called with the rows that are brushed.
    """
    if (responses := test.perturbation) is None:
        return []
    brushed: dict[str, Sequence[int]] = {}
    found = []
    channels = np.char.add(np.char.add(responses.plane, " "), responses.direction)
    for channel in dict.fromkeys(channels.tolist()):
        rows = np.flatnonzero(channels == channel)
        source = _source(responses, rows, skipped)

        def brush(_: str, __: Any, indices: list[int], channel: str = channel, rows: Any = rows) -> None:
            brushed[channel] = rows[indices].tolist()
            on_brush({row for own in brushed.values() for row in own})

        source.selected.on_change("indices", brush)
        found.append(_pair(channel, source, responses))
    return found


def colours_of_runs(test: Experiment) -> dict[str, str]:
    """Colour of each run of a perturbation test."""
    runs = () if test.perturbation is None else test.runs
    return {run: colour_of(number, len(runs)) for number, run in enumerate(runs)}


def _source(test: PerturbationTest, rows: Any, skipped: Set[int]) -> Any:
    colours = colours_of_runs(test)
    unit = 1e6  # micrometres, or microradians
    return ColumnDataSource(
        {
            "rpm": test.frequency[rows] * RPM_PER_RAD_S,
            "speed": test.speed[rows] * RPM_PER_RAD_S,
            "amplitude": np.abs(test.response[rows]) * unit,
            "phase": np.degrees(np.angle(test.response[rows])),
            "run": test.run[rows],
            "force": test.force_plane[rows],
            "number": rows + 1,
            "marker": ["x" if row in skipped else "circle" for row in rows.tolist()],
            "colour": [colours[run] for run in test.run[rows].tolist()],
        }
    )


def _pair(channel: str, source: Any, test: PerturbationTest) -> Any:
    unit = "µrad" if channel.rpartition(" ")[2].startswith("r") else "µm"
    tips = [
        ("reading", "@number"),
        ("run", "@run"),
        ("force at", "@force"),
        ("frequency", "@rpm{0.0} rpm"),
        ("speed", "@speed{0.0} rpm"),
        ("amplitude", f"@amplitude{{0.000}} {unit}"),
        ("phase lead", "@phase{0.0}°"),
    ]
    across = "speed, rpm" if test.synchronous else "frequency, rpm (backward < 0 < forward)"
    common: dict[str, Any] = {"tools": f"box_select,lasso_select,{parts.TOOLS}", "active_drag": "box_select"}
    top = parts.framed(channel, 220, "", f"{unit} 0-peak", y_axis_type="log", **common)
    bottom = parts.framed("", 190, across, "phase lead, °", x_range=top.x_range, **common)
    bottom.y_range.start, bottom.y_range.end = -190, 190
    for plot, values in ((top, "amplitude"), (bottom, "phase")):
        look = {"color": "colour", "nonselection_alpha": 0.25, "selection_color": _BRUSHED}
        plot.scatter("rpm", values, source=source, marker="marker", size=5, **look)
        plot.add_tools(HoverTool(tooltips=tips))
    bottom.toolbar_location = None
    return column(top, bottom, sizing_mode="stretch_width")
