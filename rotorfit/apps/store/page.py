"""The page beside a store: one HTML file without script or network, with alarms, history and what was refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rotorfit.apps.store.records import StoredValue
from rotorfit.apps.store.store import Store
from rotorfit.apps.store.watch import MachineState
from rotorfit.base.atomic_file import joined
from rotorfit.base.digits import plus_minus
from rotorfit.base.file_reading import beginning
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.show.plots.style import picture_of
from rotorfit.show.report.html import Html, bullets, paragraph, picture, table
from rotorfit.show.report.page import page, write_whole
from rotorfit.show.report.parts import note, section, sentence
from rotorfit.studies.monitoring.history_figure import plot_rules

_TITLE = "History of "
"""Beginning of the title of every page."""
_SHOWN = 200
"""Latest tests in the table of a machine. Chosen."""


def page_of(store: Store) -> Path:
    """Where the page of a store is: beside it, ``machine.html`` of ``machine.db``. Something else that is there is
    refused, and so is a link out of the folder."""
    folder = store.path.parent
    path = joined(folder, store.path.with_suffix(".html").name, limit=folder)
    head = 4096  # bytes in which the title stands
    if path.exists() and path.stat().st_size and f"<title>{_TITLE}".encode() not in beginning(path, head):
        raise FileExistsError(f"{path} is no page of a store, and would be replaced; move it, or rename the store")
    return path


def write_page(store: Store, states: Sequence[MachineState]) -> Path:
    """Write the page of a store beside it, whole or not at all."""
    none = section("No test yet", paragraph("Nothing has been fitted by this study."))
    sections = [part for state in states for part in _machine(state)] or [none]
    if refused := list(store.refused.items())[-_SHOWN:]:
        latest = [(Path(path).name, reason) for path, reason in refused]
        words = (reason if reason.startswith(name) else f"{name}: {reason}" for name, reason in latest)
        sections.append(section("Files that could not be read", bullets(words)))
    content = page(f"{_TITLE}{store.path.stem}", str(store.path), sections)
    return write_whole(page_of(store), content.encode("utf-8"))


def _machine(state: MachineState) -> list[Html]:
    name = state.machine or "The machine"
    verdict = "ALARM" if state.alarms else "no alarm"
    parts = [section(f"{name}: {verdict}", bullets(sentence(state.sentence(rule)) for rule in state.rules))]
    rules = [rule for rule in state.rules if len(rule.evidence)]
    if rules:
        dates = {test.number: test.date for test, _ in state.history}
        figure = plot_rules(rules, dates)
        caption = "Values by date with their standard errors, and the evidence after each test that they have changed."
        parts.append(section("History", picture(picture_of(figure, dpi=150), caption, figure.get_figwidth())))
    return [*parts, _tests(state)]


def _tests(state: MachineState) -> Html:
    names = [rule.name for rule in state.rules if rule.name in (state.history[-1][1].params if state.history else {})]
    rows = []
    for test, fit in sorted((*state.history, *state.left_out), key=lambda pair: pair[0].date, reverse=True)[:_SHOWN]:
        values = [fit.params.get(name) for name in names]
        cells = ["" if v is None or not math.isfinite(v.value) else _shown(v) for v in values]
        remark = fit.errors[0] if fit.errors else "" if fit.success else fit.message
        remark += f"{'; ' * bool(remark)}fitted by an earlier rotorfit" * fit.outdated
        rows.append([test.date, str(test.number), Path(test.sources[0]).name, *cells, remark])
    heads = [_head(name, state.history[-1][1].params[name].unit) for name in names]
    count = len(state.history) + len(state.left_out)
    more = f"The latest {_SHOWN} of {count} tests; all are in the store." if count > _SHOWN else ""
    return section(
        "Tests",
        table(["date", "test", "file", *heads, "remark"], rows),
        note("Errors are those of the noise.", more),
    )


def _head(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name}, {'rpm' if unit == 'rad/s' else unit}"


def _shown(value: StoredValue) -> str:
    factor = RPM_PER_RAD_S if value.unit == "rad/s" else 1.0
    return plus_minus(factor * value.value, factor * value.stderr)
