"""What notebooks show: results as tables, figures as pictures, formats of the figures' files."""

from __future__ import annotations

from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest

import rotorfit as rf


class Cells(HTMLParser):
    """Text of the cells of a table."""

    def __init__(self) -> None:
        super().__init__()
        self.cells: list[str] = []
        self._open = False

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self._open = tag in ("td", "th")
        if self._open:
            self.cells.append("")

    def handle_data(self, data: str) -> None:
        if self._open:
            self.cells[-1] += data

    def handle_endtag(self, tag: str) -> None:
        self._open = False


@pytest.fixture(scope="module")
def fit() -> rf.FitResult:
    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open())


def test_a_result_shows_its_parameters(fit: rf.FitResult) -> None:
    reader = Cells()
    reader.feed(fit._repr_html_())
    head = ["parameter", "value", "stderr", "noise", "bounded", "trust", "low", "high", "largest on trust", "plain"]
    width = len(head) + 2
    rows = [reader.cells[i : i + width] for i in range(0, len(reader.cells), width)]
    assert rows[0] == [*head, "unit", "meaning"]
    assert [row[0] for row in rows[1:]] == list(fit.params)
    by_name = {row[0]: row for row in rows}
    assert by_name["K0"][1] == "not determined"
    D = fit.params["D"]
    assert D.error is not None
    low, high = D.interval(0.95)
    # two digits of the error
    shown = [D.value, D.stderr, D.noise, D.bounded, D.trust, low, high, D.error.largest_on_trust, D.plain]
    for cell, number in zip(by_name["D"][1:], shown, strict=False):
        assert cell == number if isinstance(number, str) else float(cell) == pytest.approx(number, abs=0.06 * D.stderr)
    assert by_name["D"][-2] == "N s/m"
    assert "threshold speed" in fit._repr_html_()


def test_tables_of_a_print_are_tables_of_notebooks_papers_and_pages(fit: rf.FitResult) -> None:
    """Each with the cells that are printed; what stands around a table is text."""
    prediction = fit.predict([100.0, 200.0], 150.0, force_plane="disk")
    results = (fit.model, fit.params, fit.modes(150.0), fit.natural_frequencies(150.0), prediction, fit.budget())
    for result in (*results, fit.stability_report(max_speed_rpm=2000), fit.causes, rf.compare([fit])):
        tables = [part for part in result.parts() if not isinstance(part, str)]
        reader = Cells()
        reader.feed(result._repr_html_())
        words = " ".join(reader.cells).split()
        cells = [cell for table in tables for row in (table.frame.columns, *table.frame.values) for cell in row]
        assert words == " ".join(cells).split()
        assert set(words) <= set(str(result).split())
        assert result.to_latex().count("\\begin{tabular}") == len(tables)
        assert result.to_markdown().count("|:-") >= len(tables)
    latex = fit.params.to_latex()
    assert " $\\pm$ " in latex
    assert "N s/m" in latex
    assert f"| {fit.params['D']} " in " ".join(fit.params.to_markdown().split())


def test_natural_frequencies_are_tuples_and_a_table_with_intervals(fit: rf.FitResult) -> None:
    found = fit.natural_frequencies(speed_rpm=1500)
    table = found.to_dataframe()
    for (frequency, damping, sense), row in zip(found, table.to_dict("records"), strict=True):
        assert (row["frequency_rad_s_low"], row["frequency_rad_s_high"]) == frequency.interval()
        assert row["damping_ratio"] == damping.value
        assert row["sense"] == sense == ("backward" if frequency.value < 0 else "forward")
    assert len(str(found).splitlines()) == len(found) + 1
    modes = rf.fit(rf.models.TwoDisk(), rf.datasets.two_disk()).modes()
    assert modes.to_dataframe()["mass_kg_low"][0] == modes[0].mass.interval()[0]


def test_responses_as_xarray(fit: rf.FitResult) -> None:
    rig = rf.datasets.rig_open()
    data = rig.to_xarray()
    journal = data.response[((data.plane == "journal") & (data.speed < 150)).values]
    assert np.array_equal(journal, rig.response[(rig.plane == "journal") & (rig.speed < 150)])
    assert data.response.units == "m or rad, 0-peak"
    prediction = fit.predict([100.0, 200.0], 150.0, force_plane="disk", plane="journal")
    found = prediction.to_xarray()
    assert np.array_equal(found.response, prediction.response)
    assert np.array_equal(found.amplitude.sel(limit="low"), prediction.band.amplitude[:, 0])


def test_text_from_files_is_escaped() -> None:
    """Names of groups come from the data."""
    test = rf.datasets.rig_open()
    from dataclasses import replace

    named = replace(test, attributes={"oil": np.full(len(test), "<b>32</b>")})
    html = rf.fit(rf.models.WhirlWhip(), named, known={"K3": 6000.0}, per={"D": "oil"})._repr_html_()
    assert "<b>" not in html
    assert "&lt;b&gt;32" in html


def test_figures_show_without_pyplot(fit: rf.FitResult) -> None:
    picture = fit.plot.stability()._repr_png_()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 5000


def test_results_are_a_line_in_a_session_and_their_text_in_a_notebook() -> None:
    rig = rf.datasets.rig_lumped()
    fit = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    design = rf.Design(speed_rpm=1000, frequency_rpm=range(300, 2001, 300), force_N=5.0)
    results = (
        fit.predict([100.0, 200.0], 150.0, force_plane="disk"),
        fit.stability_report(),
        fit.profile("lam", points=3),
        fit.causes,
        fit.budget(),
        fit.sample(seed=1, walkers=32, ess=100),
        rf.compare([fit]),
        rf.plan(fit.model, fit, design, noise_um=0.5, quantity="lam"),
    )
    for result in results:
        assert "\n" not in repr(result)
        assert len(repr(result)) < 200
        assert str(result).splitlines()[-1].split()[0] in unescape(result._repr_html_())
    assert repr(fit.params["lam"]).startswith("<lam: 0.4758 +- 0.00")
    assert repr(fit.params["K3"]) == "<K3: 6000 +- 60 N/m, known>"
    assert str(fit.threshold_speed()) in repr(fit.threshold_speed())
    assert len(repr(rf.Finding("error", "code", "message", rows=tuple(range(1000))))) < 200
    assert rf.read(rig.to_dataframe()).planes == rig.planes
