"""The page of one tab: sections from files to results, and what happens when something is clicked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import panel as pn

from rotorfit.app.folder import Folder
from rotorfit.app.parts import (
    WIDE,
    button,
    download,
    figures_beside,
    finding_words,
    heading,
    in_a_row,
    markup,
    message,
    side_by_side,
)
from rotorfit.app.readings_figure import readings_figures
from rotorfit.app.results import result_parts
from rotorfit.app.session import Session, attempted, chosen, toml_of
from rotorfit.app.work import Refusal, Report, Stage, Work
from rotorfit.fitting.fit_file import fit_to_json
from rotorfit.io.files import to_dataframe
from rotorfit.models import MODELS
from rotorfit.report.html import element
from rotorfit.studies.text import describe_test

if TYPE_CHECKING:
    from rotorfit.data.experiments import Experiment
    from rotorfit.studies.study import Outcome

_TEMPLATE = """{% extends base %}
{% block preamble %}<meta name="viewport" content="width=device-width, initial-scale=1">
<style>body { margin: 0 auto !important; max-width: 1180px; background: white; }</style>{% endblock %}
{% block contents %}{{ embed(roots.page) }}{% endblock %}"""
_POLL_MS = 200
"""Milliseconds after which a fit is asked for news."""


def page(folder: Folder, names: Sequence[str]) -> Any:
    """A new page with a session of its own."""
    template = pn.Template(_TEMPLATE)
    template.add_panel("page", Page(folder, names).view)
    return template


class Page:
    """The parts of the page and the session that they show."""

    def __init__(self, folder: Folder, names: Sequence[str]) -> None:
        self.session = Session(folder=folder)
        self._data, self._model, self._result = (pn.Column(**WIDE) for _ in range(3))
        self._said = pn.Column(**WIDE)
        self._work: Work | None = None
        self.view = pn.Column(
            markup(element("h1", "rotorfit"), element("p", str(folder.root), class_="faint")),
            self._file_section(names),
            self._said,
            self._data,
            self._model,
            self._result,
            **WIDE,
        )
        if names:
            self._open(names, None)

    # ---- files ----------------------------------------------------------------------------------------------------

    def _file_section(self, names: Sequence[str]) -> Any:
        folder = self.session.folder
        files = pn.widgets.MultiSelect(
            name="Test files and recordings",
            options=folder.data_files(),
            value=list(names),
            size=5,
            min_width=260,
            styles={"flex": "1 1 300px"},
        )
        setup = pn.widgets.Select(name="Setup of the rig, for recordings", options=["", *folder.setups()], width=260)
        opened = button("Open", main=True, width=90)
        opened.on_click(lambda _: self._open(files.value, setup.value or None))
        return pn.Column(heading("Data"), in_a_row(files, setup, opened), **WIDE)

    def _open(self, names: Sequence[str], setup: str | None) -> None:
        self._change(lambda: self.session.with_files(chosen(self.session.folder, names, setup)))

    def _change(self, work: Callable[[], Session]) -> None:
        """Put what a click asks for in the place of the session, or say why not."""
        self._stop()
        self.session, refusal = attempted(work, self.session)
        self._said.objects = [message(refusal, "error")] if refusal else []
        if not refusal:
            self._show_data()
            self._show_model()
            self._result.objects = []

    # ---- data -----------------------------------------------------------------------------------------------------

    def _show_data(self) -> None:
        parts: list[Any] = [heading("What was recognised")]
        for number, (test, findings) in enumerate(zip(self.session.experiments, self.session.findings, strict=True)):
            words = [line for line in describe_test(test, ()).splitlines() if "check: " not in line]
            parts.append(markup(element("pre", "\n".join(words))))
            parts += [markup(finding_words(found)) for found in findings]
            if not findings:
                parts.append(message("The check of the data found nothing.", "good"))
            parts.append(self._readings(number))
        self._data.objects = parts

    def _readings(self, number: int) -> Any:
        """The readings of a test to be brushed, and what can be done with those that are."""
        brushed: set[int] = set()
        skipped = self.session.skipped(number)
        leave, back = (button(words, disabled=True) for words in ("Leave out what is brushed", "Take it again"))

        def on_brush(rows: set[int]) -> None:
            brushed.clear()
            brushed.update(rows)
            leave.disabled, back.disabled = not rows - skipped, not rows & skipped

        figures = readings_figures(self.session.whole[number], skipped, on_brush)
        if not figures:
            return pn.Column()
        leave.on_click(lambda _: self._change(lambda: self.session.with_skipped(number, skipped | brushed)))
        back.on_click(lambda _: self._change(lambda: self.session.with_skipped(number, skipped - brushed)))
        out = [markup(element("p", f"{len(skipped)} readings are left out, drawn as crosses."))] if skipped else []
        return pn.Column(figures_beside(figures), in_a_row(leave, back), *out, **WIDE)

    # ---- model ----------------------------------------------------------------------------------------------------

    def _show_model(self) -> None:
        labels = {f"{name}: {(kind.__doc__ or '').partition('.')[0]}": name for name, kind in MODELS.items()}
        model = pn.widgets.Select(name="Model", options=labels, value=self.session.content["model"], **WIDE)
        model.param.watch(lambda event: self._change(lambda: self.session.with_option("model", event.new)), "value")
        fit = button("Fit", main=True, width=90)
        fit.on_click(lambda _: self._fit())
        self._stop_button = button("Stop", width=90, disabled=True)
        self._stop_button.on_click(lambda _: self._stop("The fit was stopped; nothing was written."))
        self._progress = pn.Column(**WIDE)
        self._model.objects = [
            heading("Model"),
            model,
            self._known(),
            in_a_row(fit, self._stop_button),
            self._progress,
        ]

    def _known(self) -> Any:
        """A field for each parameter: a number where it is known."""
        session, refusal = attempted(lambda: (self.session.model, self.session)[1], self.session)
        if refusal:
            return message(refusal, "error")
        known = session.content.get("known", {})
        fields = []
        for p in session.model.parameters:
            usual = "fitted" if p.default is None else f"{p.default:g}"
            field = pn.widgets.TextInput(
                name=f"{p.name}{'' if p.unit == '1' else f', {p.unit}'}: {p.meaning}",
                value=str(known.get(p.name, "")),
                placeholder=usual,
                stylesheets=["label { white-space: normal; }"],
                **WIDE,
            )
            field.param.watch(lambda event, name=p.name: self._know(name, event.new), "value")
            fields.append(field)
        return pn.Column(
            markup(element("p", "Values that are known; what is left empty is fitted.", class_="faint")),
            side_by_side(fields, least=250),
            **WIDE,
        )

    def _know(self, name: str, word: str) -> None:
        known = {key: value for key, value in self.session.content.get("known", {}).items() if key != name}
        if word.strip():
            try:
                known[name] = float(word)
            except ValueError:
                self._said.objects = [message(f"{name}: {word!r} is not a number", "error")]
                return
        self._said.objects = []
        self.session = self.session.with_option("known", known)

    # ---- fit ------------------------------------------------------------------------------------------------------

    def _fit(self) -> None:
        self._stop()
        self._result.objects = []
        self._work = Work(self.session.content, self.session.folder.root)
        self._stop_button.disabled = False
        self._progress.objects = [message("starting ...")]
        self._poll = pn.state.add_periodic_callback(self._look, _POLL_MS)

    def _look(self) -> None:
        """Take in what the fit sent."""
        for news in self._work.news() if self._work is not None else ():
            match news:
                case Stage():
                    share = "" if news.done is None else f" {100 * news.done:.0f} %"
                    self._progress.objects = [message(f"{news.words} ...{share}")]
                case Refusal():
                    self._stop()
                    self._progress.objects = [message(news.words, "error")]
                case Report():
                    self._stop()
                    self._report.objects = [download("report.html", partial(str, news.text))]
                case _:
                    self._stop_button.disabled = True
                    self._progress.objects = []
                    self.session = replace(self.session, outcome=news)
                    self._result.objects = [*result_parts(news), self._downloads(news)]

    def _stop(self, words: str = "") -> None:
        if self._work is not None:
            self._poll.stop()
            self._work.stop()
            self._work = None
            self._stop_button.disabled = True
            self._progress.objects = [message(words)] if words else []

    # ---- downloads ------------------------------------------------------------------------------------------------

    def _downloads(self, outcome: Outcome) -> Any:
        session = self.session
        files = [
            download("study.toml", partial(toml_of, session, absolute=True)),
            download("fit.json", partial(fit_to_json, outcome.best)),
        ]
        for number, test in enumerate(outcome.experiments, 1):
            name = "data.csv" if len(outcome.experiments) == 1 else f"data-{number}.csv"
            files.append(download(name, partial(_as_csv, test)))
        self._report = pn.Column(message("drawing the report ..."), width=220)
        return pn.Column(
            heading("Take away"),
            markup(element("p", "rotorfit run study.toml gives the same numbers again, to the last digit.")),
            in_a_row(*files, self._report),
            **WIDE,
        )


def _as_csv(test: Experiment) -> str:
    return str(to_dataframe(test).to_csv(index=False))
