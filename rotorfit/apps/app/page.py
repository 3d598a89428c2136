"""The page of one tab: sections from files to results, and what happens when something is clicked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from threading import RLock
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.apps.app.data_view import DataView
from rotorfit.apps.app.folder import Folder
from rotorfit.apps.app.forms import model_form
from rotorfit.apps.app.parts import (
    WIDE,
    bar,
    button,
    document,
    heading,
    in_a_row,
    markup,
    message,
    scrolled,
    window,
)
from rotorfit.apps.app.results import Takeaway, result_parts
from rotorfit.apps.app.session import Session, chosen_entries
from rotorfit.apps.app.words import on_the_page
from rotorfit.apps.app.work import Data, End, News, Refusal, Report, Stage, Task, Work, fit, read
from rotorfit.apps.study_files.wording import sentence
from rotorfit.show.report.html import element

if TYPE_CHECKING:
    from rotorfit.lab.data.findings import Finding

_TEMPLATE = """{% extends base %}
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body { margin: 0 !important; background: white; }</style>
{% endblock %}
{% block contents %}{{ embed(roots.page) }}{% endblock %}"""
_DONE = "The fit is done."


def page(folder: Folder, names: Sequence[str]) -> Any:
    """A new page with a session of its own."""
    template = pn.Template(_TEMPLATE)
    template.add_panel("page", Page(folder, names).view)
    return template


class Page:
    """The parts of the page and the session that they show."""

    def __init__(self, folder: Folder, names: Sequence[str]) -> None:
        self.session = Session(folder=folder)
        self._work: Work | None = None
        self._takeaway: Takeaway | None = None
        self._data, self._model, self._result = (pn.Column(**WIDE) for _ in range(3))
        self._said = pn.Column(styles={"max-height": "30dvh", "overflow-y": "auto"}, **WIDE)
        self._at_work = markup(styles={"flex": "1 1 160px"})
        self._take_in: Callable[[], bool] = lambda: True
        self._fit_button = button("Fit", self._fit, main=True, width=90, visible=False)
        self._stop_button = button(
            "Stop", lambda: self.stop("It was stopped; nothing was written."), width=90, visible=False
        )
        self._lock = RLock()
        title = markup(element("h1", "rotorfit"), sizing_mode=None)
        self._body = scrolled(self._file_section(names), self._data, self._model, self._result)
        self.view = window(
            bar(in_a_row(title, self._fit_button, self._stop_button, self._at_work), self._said), self._body
        )
        if names:
            pn.state.onload(partial(self.open, names, None), threaded=True)

    # ---- files ----------------------------------------------------------------------------------------------------

    def _file_section(self, names: Sequence[str]) -> Any:
        folder = self.session.folder
        found = folder.data_files()
        files = pn.widgets.MultiSelect(
            name="Test files and recordings, several with Ctrl",
            options=found,
            value=list(names),
            size=min(max(len(found), 3), 10),
            min_width=260,
            styles={"flex": "1 1 300px"},
        )
        setups = ["", *folder.setups()]
        self._setup = pn.widgets.Select(name="Setup of the rig, for recordings", options=setups, width=260)
        opened = button("Open", lambda: self.open(files.value, self._setup.value or None), main=True, width=90)
        chosen = in_a_row(files, self._setup, opened)
        where = markup(element("p", str(folder.root), class_="faint"))
        return pn.Column(heading("Data"), where, chosen, *self._history_section(folder.histories()), **WIDE)

    def _history_section(self, names: Sequence[str]) -> list[Any]:
        """A list of the pages that watches keep, and the one that is chosen."""
        if not names:
            return []
        shown = pn.Column(**WIDE)
        listed = pn.widgets.Select(name="Or look at the history of a machine", options=["", *names], width=260)

        def show(event: Any) -> None:
            try:
                shown.objects = [document(self.session.folder.path(event.new))] if event.new else []
            except (ValueError, OSError) as problem:
                self.say(sentence(problem))

        listed.param.watch(show, "value")
        return [listed, shown]

    def open(self, names: Sequence[str], setup: str | None) -> None:
        """Open files of the folder."""
        self.change(lambda: self.session.with_files(chosen_entries(self.session.folder, names, setup)))

    def opened_with(self, setup: str) -> None:
        """Open the same recordings with another setup, which has just been written."""
        self._setup.options = ["", *self.session.folder.setups()]
        self._setup.value = setup
        self.open(self.session.recorded, setup)

    # ---- what a click changes -------------------------------------------------------------------------------------

    def change(self, asked: Callable[[], Session]) -> None:
        """Put other data in the place of the session's, or say why not."""
        with self._lock:
            if not self._changed(asked):
                return
            if self.session.recorded and not self.session.records:
                try:
                    self.session = self.session.with_records()
                except (ValueError, OSError) as problem:
                    self.say(sentence(problem))
            view = DataView(self)
            self._data.objects = view.parts
            self._show_model()
            if self.session.data is None and not self.session.recorded:
                self.start(read)
        view.complete()

    def change_model(self, asked: Callable[[], Session]) -> None:
        """Give the session another model, or other options of the fit."""
        with self._lock:
            if self._changed(asked):
                self._show_model()

    def _changed(self, asked: Callable[[], Session]) -> bool:
        self.stop()
        try:
            self.session = asked()
        except (ValueError, KeyError, OSError) as problem:
            self.say(sentence(problem))
            return False
        self.say("")
        self._clear_result()
        return True

    def _clear_result(self) -> None:
        self._result.objects, self._takeaway = [], None
        self._result.styles = {}

    def _show_model(self) -> None:
        self._fit_button.visible = self.session.data is not None
        if self.session.data is None:
            self._model.objects = []
            return
        parts, self._take_in = model_form(self)
        self._model.objects = [heading("Model"), *parts]

    def _fit(self) -> None:
        """Fit with what is entered."""
        if self._take_in():
            self.start(fit)

    def undo(self, finding: Finding) -> None:
        """Undo an error of the data and fit again."""
        self.undo_in_data(finding)
        if not self._said.objects:
            self.start(fit)

    def undo_in_data(self, finding: Finding) -> None:
        """Undo an error of the data."""
        self.change(lambda: self.session.with_undone(finding))

    def say(self, words: str) -> None:
        """Say what is wrong with something that was entered."""
        self._said.objects = [message(words, "error")] if words else []

    # ---- long work ------------------------------------------------------------------------------------------------

    def start(self, task: Task) -> None:
        """Begin long work on the study, in place of what is going on."""
        with self._lock:
            self.stop()
            self._clear_result()
            self._work = Work(task, self.session.study, self.session.folder.root)
            self._stage("starting")
            poll_ms = 200  # milliseconds after which work is asked for news
            self._poll = pn.state.add_periodic_callback(self._look, poll_ms)

    def _look(self) -> None:
        with self._lock:
            for news in self._work.news() if self._work is not None else ():
                self._take(news)

    def _stage(self, words: str) -> None:
        """Say what the work is at."""
        self._tell(f"{words} ...", at_work=True)

    def _tell(self, words: str, *, at_work: bool = False) -> None:
        self._at_work.object = element("p", on_the_page(words), class_="faint")
        self._stop_button.visible = at_work

    def _take(self, news: News) -> None:
        """Take in what the work sent."""
        match news:
            case Stage():
                self._stage(news.words if news.done is None else f"{news.words}, {100 * news.done:.0f} %")
            case Refusal():
                self.stop()
                self.say(news.words)
            case Data():
                self.stop()
                self.change(lambda: self.session.with_data(news))
            case Report():
                if self._takeaway is not None:
                    self._takeaway.add_report(news.text)
            case End():
                self.stop(_DONE)
            case _:
                self._takeaway = Takeaway(self.session, news)
                shown = [*result_parts(news, self.session, self.undo), *self._takeaway.parts]
                self._result.styles = {"min-height": "95dvh"}  # so that it can stand at the top before all is drawn
                self._result.objects = shown
                self._tell(f"{_DONE} Its report is being drawn ...", at_work=True)
                self._body.scroll_to(self._body.objects.index(self._result))

    def stop(self, words: str = "") -> None:
        """End the work that is going on."""
        with self._lock:
            if self._work is not None:
                self._poll.stop()
                self._work.stop()
                self._work = None
                self._tell(words)
