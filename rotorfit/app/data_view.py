"""The data of a session: what was recognised, forms that correct it, signals to look through, readings to brush."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.app.parts import (
    WIDE,
    button,
    colour_key,
    figures_beside,
    finding_words,
    heading,
    in_a_row,
    markup,
    message,
)
from rotorfit.app.read_form import read_form
from rotorfit.app.readings_figure import colours_of_runs, readings_figures
from rotorfit.app.session import entry_table
from rotorfit.app.setup_form import SetupForm
from rotorfit.app.signals import SignalsView
from rotorfit.app.work import read
from rotorfit.recordings.summary import summary
from rotorfit.report.html import element
from rotorfit.studies.text import describe_test
from rotorfit.studies.wording import sentence

if TYPE_CHECKING:
    from rotorfit.app.front import Front
    from rotorfit.recordings.recording import Recording


class DataView:
    """Parts of the page that show the data."""

    def __init__(self, page: Front) -> None:
        self._page, self._session = page, page.session
        self._signals: SignalsView | None = None
        self._looked = pn.Column(**WIDE)
        self._shown = pn.Column(**WIDE)
        self.parts = [heading("What was recognised"), *self._tests(), *self._forms(), *self._recorded()]

    # ---- tests ----------------------------------------------------------------------------------------------------

    def _tests(self) -> list[Any]:
        parts: list[Any] = []
        for number, (test, findings) in enumerate(zip(self._session.experiments, self._session.findings, strict=True)):
            words = [line for line in describe_test(test, ()).splitlines() if "check: " not in line]
            parts.append(markup(element("pre", "\n".join(words))))
            parts += [markup(finding_words(found)) for found in findings]
            if not findings:
                parts.append(message("The check of the data found nothing.", "good"))
            parts.append(self._readings(number))
        undone = self._session.content.get("undo", ())
        if undone:
            back = button("Take the data as they were given", lambda: self._page.change(self._session.with_all_errors))
            parts += [message(f"Undone in the data: {', '.join(undone)}.", "warning"), back]
        return parts

    def _readings(self, number: int) -> Any:
        """The readings of a test to be brushed, and what can be done with those that are."""
        brushed: set[int] = set()
        skipped = self._session.skipped(number)
        change, session = self._page.change, self._session
        leave, back = (
            button(
                "Leave out what is brushed", lambda: change(lambda: session.with_skipped(number, skipped | brushed))
            ),
            button("Take it again", lambda: change(lambda: session.with_skipped(number, skipped - brushed))),
        )
        leave.disabled = back.disabled = True

        def on_brush(rows: set[int]) -> None:
            brushed.clear()
            brushed.update(rows)
            leave.disabled, back.disabled = not rows - skipped, not rows & skipped

        data = self._session.data
        figures = [] if data is None else readings_figures(data.experiments[number], skipped, on_brush)
        if data is None or not figures:
            return pn.Column()
        out = [markup(element("p", f"{len(skipped)} readings are left out, drawn as crosses."))] if skipped else []
        colours = colours_of_runs(data.experiments[number])
        key = colour_key("Draw a box or a lasso around readings to leave them out.", colours)
        return pn.Column(key, figures_beside(figures), in_a_row(leave, back), *out, **WIDE)

    def _forms(self) -> list[Any]:
        """A form for each test file; it is open where the files could not be read as they are."""
        entries = enumerate(self._session.content["files"])
        return [read_form(self._page, number) for number, entry in entries if "path" in entry_table(entry)]

    # ---- recordings -----------------------------------------------------------------------------------------------

    def _recorded(self) -> list[Any]:
        records, raw = self._session.records, self._session.recorded
        if not raw:
            return []
        try:
            setup = [SetupForm(self._page, self._session.folder.path(raw[0])).card]
        except (ValueError, OSError):  # the file itself cannot be read, which has been said
            setup = []
        if not records:
            return setup
        known = {record.name: record for record in records}
        chosen = pn.widgets.Select(name="Recording", options=list(known), width=220)
        plane = pn.widgets.Select(name="Plane", options=list(records[0].planes), width=160)
        unread = self._session.data is None
        make = button("Make vectors of the recordings", lambda: self._page.start(read), main=unread)

        def choose(_: Any) -> None:
            plane.param.update(options=list(known[chosen.value].planes))
            self._look(known[chosen.value], plane.value)

        chosen.param.watch(choose, "value")
        plane.param.watch(lambda event: self._look(known[chosen.value], event.new), "value")
        return [self._looked, in_a_row(chosen, plane, make), self._shown, *setup]

    def complete(self) -> None:
        """Show the first recording, then what takes longer: what is linked to the cursor, and what is odd."""
        records = self._session.records
        if not records:
            return
        self._looked.objects = [markup(element("pre", "\n".join(map(repr, records))))]
        self._look(records[0], records[0].planes[0])
        parts: list[Any] = []
        for record in records:
            parts += self._summary(record)
            self._looked.objects = parts

    def _look(self, record: Recording, plane: str) -> None:
        """Show a plane of a recording."""
        at = None if self._signals is None or self._signals.record is not record else self._signals.at
        self._signals = shown = SignalsView(record, plane, at)
        self._shown.objects = [shown.view]
        shown.complete()

    def _summary(self, record: Recording) -> list[Any]:
        try:
            words = [line for line in summary(record).splitlines() if "[" not in line or "] " not in line]
            return [markup(element("pre", "\n".join(words))), *(markup(finding_words(f)) for f in record.findings)]
        except ValueError as problem:
            return [message(sentence(problem), "error")]
