"""Downloads of a fit: the study that repeats it, its numbers, data and report."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import panel as pn

from rotorfit.app.parts import WIDE, button, download, heading, in_a_row, markup, message
from rotorfit.app.session import Session, toml_of
from rotorfit.fitting.fit_file import fit_to_json
from rotorfit.io.files import to_dataframe
from rotorfit.io.tables.result_tables import frame_csv
from rotorfit.report.html import element
from rotorfit.studies.wording import sentence

if TYPE_CHECKING:
    from rotorfit.data.experiments import Experiment
    from rotorfit.studies.study import Outcome


class Takeaway:
    """Downloads of an outcome, and a file in the folder."""

    def __init__(self, session: Session, outcome: Outcome) -> None:
        self._session = session
        files = [
            download("study.toml", partial(toml_of, session, absolute=True)),
            download("fit.json", partial(fit_to_json, outcome.best)),
        ]
        for number, test in enumerate(outcome.experiments, 1):
            name = "data.csv" if len(outcome.experiments) == 1 else f"data-{number}.csv"
            files.append(download(name, partial(_as_csv, test)))
        self._report = pn.Column(message("drawing the report ..."), width=220)
        free = session.folder.free_name("study.toml")
        name = pn.widgets.TextInput(name="Or keep the study in the folder, as", value=free, width=220)
        keep, self._kept = button("Keep", lambda: self._keep(name.value), width=90), pn.Column(**WIDE)
        self.parts = [
            heading("Take away"),
            markup(element("p", "rotorfit run study.toml gives the same numbers again, to the last digit.")),
            in_a_row(*files, self._report),
            in_a_row(name, keep),
            self._kept,
        ]

    def add_report(self, text: str) -> None:
        """Offer the report, which is drawn after the fit."""
        self._report.objects = [download("report.html", partial(str, text))]

    def _keep(self, name: str) -> None:
        try:
            self._session.folder.write_new(name, toml_of(self._session, absolute=False))
        except (ValueError, OSError) as problem:
            self._kept.objects = [message(sentence(problem), "error")]
        else:
            self._kept.objects = [message(f"{name} is written; rotorfit run {name} repeats the fit.", "good")]


def _as_csv(test: Experiment) -> str:
    return frame_csv(to_dataframe(test))
