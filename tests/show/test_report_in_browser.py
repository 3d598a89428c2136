"""The report in a browser: nothing on the console, nothing cut, a few pages of paper.

Skipped on a machine without one, see the fixture ``chromium``.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import Browser
from report_pages import normal_draws

import rotorfit as rf
from rotorfit.base.units import RPM_PER_RAD_S

MEASURE = """<script>
window.onload = () => {
  const wide = [...document.querySelectorAll('.table, .equation, pre, .card, figure')]
    .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.className + ': ' + e.textContent.slice(0, 60));
  const images = [...document.images].filter(i => i.complete && i.naturalWidth > 300).length;
  const out = document.createElement('output');
  out.textContent = JSON.stringify({wide, images, page: document.documentElement.scrollWidth, window: innerWidth});
  document.body.append(out);
};
</script>"""


@pytest.fixture(scope="module")
def browsed(rig_refinement: rf.Refinement, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    return rf.write_report(
        rig_refinement.best,
        folder / "report.html",
        refinement=rig_refinement,
        posterior=normal_draws(rig_refinement.best),
    )


def test_renders_without_a_word_on_the_console(
    chromium: Callable[..., tuple[str, list[str]]], browsed: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "report.png"
    dom, console = chromium(browsed, "--window-size=1200,2000", f"--screenshot={picture}", "--dump-dom")
    assert console == []
    import matplotlib.image

    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape[:2] == (2000, 1200)
    inked = (pixels < 0.9).any(axis=(1, 2)).reshape(20, 100)
    assert inked.mean(axis=1).min() > 0.1  # text all the way down
    assert np.unique((pixels * 255).astype(int) @ [1, 256, 65536]).size > 50
    assert dom == "" or "Verdict</h2>" in dom
    # the check is able to fail: anything the page would load or run shows on the console
    spoilt = tmp_path / "spoilt.html"
    head, _, _ = browsed.read_text(encoding="utf-8").partition("<body")
    spoilt.write_text(f"{head}<body><script>1</script></body></html>", encoding="utf-8")
    assert len(chromium(spoilt, "--dump-dom")[1]) == 1


@pytest.mark.parametrize("width", [1200, 600])
def test_nothing_is_cut(
    chromium: Callable[..., tuple[str, list[str]]], browsed: Path, tmp_path: Path, width: int
) -> None:
    text = browsed.read_text(encoding="utf-8")
    measured = tmp_path / "measured.html"
    assert "default-src 'none'" in text or "default-src &#x27;none&#x27;" in text
    text = re.sub(r"<meta http-equiv[^>]*>", "", text).replace("</body>", MEASURE + "</body>")
    measured.write_text(text, encoding="utf-8")
    dom, console = chromium(measured, f"--window-size={width},900", "--dump-dom")
    assert console == []
    found = json.loads(re.findall(r"<output>(.*?)</output>", dom, re.DOTALL)[0])
    assert found["images"] == 10
    assert found["page"] <= found["window"]
    if width >= 1000:  # on a narrow screen wide tables scroll in their own box
        assert found["wide"] == []


@pytest.mark.parametrize(("width", "height"), [(1280, 900), (390, 844)])
def test_the_first_screen_holds_verdict_and_five_numbers(
    browser: Browser, browsed: Path, width: int, height: int
) -> None:
    """At the desk with the two figures, on a phone as rows; neither is scrolled sideways."""
    tab = browser.tab(browsed.as_uri(), width=width, height=height)
    tab.settle()
    assert tab.run("document.documentElement.scrollWidth <= innerWidth")
    ends = "[...document.querySelectorAll('{}')].map(e => e.getBoundingClientRect().bottom)"
    assert tab.run("document.querySelectorAll('.card').length") == 5
    for what in (".headline", ".checks", ".card"):
        assert max(json.loads(tab.run(f"JSON.stringify({ends.format(what)})"))) < height
    if width > 1000:
        assert max(json.loads(tab.run(f"JSON.stringify({ends.format('.pair img')})"))) < height
    assert tab.complaints == []


def test_first_screens_of_balancing_and_campaigns(browser: Browser, tmp_path: Path) -> None:
    """Verdict, checks and numbers above the fold at the desk and on a phone; neither is scrolled sideways."""
    test = rf.read(rf.datasets.path("field_balance.csv"), constants={"sigma_mil_pp": "0.02"})
    balanced = rf.balance(rf.influence(test), "trial 2", holes=24)
    runs = rf.campaign(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), split="speed_rpm", known={"K3": 6000.0})
    pages = [
        rf.write_balance_report(balanced, tmp_path / "balance.html", source="field_balance.csv"),
        rf.write_campaign_report(runs, tmp_path / "campaign.html", against="speed_rpm", parameters=["K0", "D", "lam"]),
    ]
    for page, (width, height) in itertools.product(pages, [(1280, 900), (390, 844)]):
        tab = browser.tab(page.as_uri(), width=width, height=height)
        tab.settle()
        assert tab.run("document.documentElement.scrollWidth <= innerWidth")
        shown = ".headline, .checks, .card" + (", .pair img" if width > 1000 else "")
        ends = f"[...document.querySelectorAll('{shown}')].map(e => e.getBoundingClientRect().bottom)"
        assert max(json.loads(tab.run(f"JSON.stringify({ends})"))) < height
        assert tab.complaints == []


@pytest.mark.slow
def test_prints_to_a_pdf_of_a_few_pages(
    chromium: Callable[..., tuple[str, list[str]]], browsed: Path, tmp_path: Path
) -> None:
    _, console = chromium(browsed, "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'report.pdf'}")
    assert console == []
    content = (tmp_path / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    pages = len(re.findall(rb"/Type\s*/Page\b", content))
    assert 5 <= pages <= 14
    sizes = {tuple(map(float, m.split())) for m in re.findall(rb"/MediaBox\s*\[([^\]]*)\]", content)}
    assert len(sizes) == 1
    *_, wide, high = sizes.pop()
    assert (wide, high) == pytest.approx((595.3, 841.9), abs=1)  # A4 in points


def test_interactive_panels_are_zoomed_together_and_a_click_shows_the_rows(
    browser: Browser, rig_refinement: rf.Refinement, tmp_path: Path
) -> None:
    fit = rig_refinement.best
    page = rf.write_report(fit, tmp_path / "report.html", findings=[[]], figure_format="none", interactive=True)
    tab = browser.tab(page.as_uri(), width=1200)
    tab.wait(lambda: tab.run("window.Bokeh && Bokeh.documents.length"), "the figure")
    tab.settle()
    figures = "[...Bokeh.documents[0]._all_models.values()].filter(one => one.type == 'Figure')"
    ranges = f"JSON.stringify([...new Set({figures}.map(one => [one.x_range.start, one.x_range.end].join()))])"
    assert len(json.loads(tab.run(ranges))) == 1
    before = tab.run(ranges)
    view = "Bokeh.index.find_one(Bokeh.documents[0].get_model_by_id(plots[0]))"
    frame = f"(b => [b.left, b.top, b.width, b.height])({view}.frame.bbox)"
    corner = f"placed({view}.el).slice(0, 2)"
    left, top, width, height = tab.run(frame)
    x, y = tab.run(corner)
    left, top = left + x, top + y
    tab.drag((left + 0.6 * width, top + 5), (left + 0.9 * width, top + height - 5))
    tab.wait(lambda: tab.run(ranges) != before, "the zoom")
    assert len(json.loads(tab.run(ranges))) == 1
    test = fit.experiments[0]
    tab.run("responses.dispatchEvent(new MouseEvent('dblclick')); 0")
    tab.wait(lambda: tab.run(ranges) == before, "the whole range again")
    x, y = tab.run(corner)
    point = "Bokeh.documents[0].get_model_by_id(sources[0]).data"
    x += tab.run(f"{view}.frame.x_scale.compute({point}.rpm[20])")
    y += tab.run(f"{view}.frame.y_scale.compute({point}.amplitude[20])")
    away = itertools.cycle((1.0, 0.0))  # a pointer that rests says nothing more to a page that was busy

    def pointed_at() -> bool:
        tab.mouse("mouseMoved", x + next(away), y)
        return "run " in tab.text()

    tab.wait(pointed_at, "words beside the pointer")
    for kind in ("mousePressed", "mouseReleased"):
        tab.mouse(kind, x, y)
    shown = tab.wait(lambda: "reading" in (text := tab.run("rows.textContent")) and text, "the rows")
    number, cells = re.findall(r"reading (\d+): (.*)", shown)[0]
    row = int(number) - 1
    assert f"frequency_rpm {test.frequency[row] * RPM_PER_RAD_S:.6g}," in cells
    assert f"amplitude_um {abs(test.response[row]) * 1e6:.6g}" in cells
    assert f"run {test.run[row]}" in cells
    assert tab.complaints == []
    assert all(address.startswith(("file:", "data:", "blob:")) for address in tab.requests)


def test_the_report_of_a_fit_alone_is_read_on_few_screens(browser: Browser, tmp_path: Path) -> None:
    """That of the demo's rig, as the command line writes it."""
    rig = rf.read(rf.datasets.path("rig_lumped.csv"))
    best = rf.refine(rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0}))
    report = rf.write_report(best.best, tmp_path / "report.html", refinement=best)
    assert report.stat().st_size < 1.5e6
    tab = browser.tab(report.as_uri(), width=1280)
    tab.settle()
    assert tab.run("document.documentElement.scrollHeight") <= 6000
