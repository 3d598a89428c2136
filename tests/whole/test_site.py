"""The site: what is public is in its reference; once it is built, links lead somewhere and pages show in a browser.

Build it with ``python -m sphinx -W -b html docs docs/_build``; without that the tests of the built site are skipped,
unless ROTORFIT_SITE=required says that it has to be there.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from slow_cases import slow_but

import rotorfit
from rotorfit.base.accessors import PROVIDERS

ROOT = Path(__file__).parents[2]
SITE = ROOT / "docs" / "_build"
MAIN_PAGES = (
    "index.html", "tutorials/index.html", "tutorials/your_file.html", "volts.html", "howto/faq.html",
    "theory/models.html", "reference/validation.html", "reference/command_line.html", "reference/api/fits.html",
    "_gallery/index.html", "_gallery/plot_fig_10_dynamic_stiffness.html", "about/index.html", "bibliography.html",
)  # fmt: skip
TUTORIALS = (
    "first_fit", "your_file", "uff58", "volts", "experiments", "campaigns", "balancing", "real_rig", "planning",
    "structure", "anisotropic_shaft", "uncertainty", "plot_fig_11_oil",
)  # fmt: skip
"""Notebooks that are run whole, with one of the gallery; before a release all of them."""
THEME_SAYS = "[PST]: "
"""What the theme writes to the console itself: light or dark, where the sidebar is."""
WIDTHS = (1300, 400)
"""Of a desktop's and a telephone's window, pixels."""
MEASURE = """<script>
window.addEventListener('load', () => setTimeout(() => {
  const cut = [...document.querySelectorAll('article img, article svg')].filter(e => {
    const box = e.getBoundingClientRect();
    return box.width > 0 && (box.right > innerWidth + 1 || box.left < -1);
  }).map(e => e.outerHTML.slice(0, 80));
  parent.postMessage(JSON.stringify({
    page: document.documentElement.scrollWidth, window: innerWidth, cut,
    broken: [...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src),
  }), '*');
}, 500));
</script>"""
ACCESS = """<script>
window.addEventListener('load', () => setTimeout(() => axe.run({runOnly: ['wcag2a', 'wcag2aa']}).then(found =>
  document.body.append(Object.assign(document.createElement('output'), {textContent: JSON.stringify(
    found.violations.map(v => [v.id, v.help, v.nodes.map(n => n.html.slice(0, 120))]))}))), 500));
</script>"""
"""What axe finds against the guidelines for accessible pages, contrast and keyboard among them."""
FRAME = """<!doctype html><iframe src="{src}" width="{width}" height="900" style="border: 0"></iframe><output></output>
<script>addEventListener('message', e => document.querySelector('output').textContent = e.data)</script>"""
"""A page in a frame, as a browser's own window has a least width."""


def test_every_public_name_is_on_one_page_of_the_reference() -> None:
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "reference" / "api").glob("*.rst")]
    listed = re.findall(
        r"^\.\. auto(?:class|function|data):: rotorfit\.((?:models\.)?\w+)$", "\n".join(pages), re.MULTILINE
    )
    public = {name for name, home in rotorfit._HOME.items() if home}
    constants = {"BLOCKS", "LAWS", "MODELS", "ROSS_4", "ROSS_6"}  # shown from where their docstrings stand
    models = {f"models.{name}" for name in rotorfit.models.__all__ if name not in constants}
    assert sorted(name for name in listed if name != "models.MODELS") == sorted(public | models)


def test_the_figures_of_every_record_are_in_the_reference() -> None:
    """Providers that are functions stand on the page of their record, as its methods do."""
    pages = "\n".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "reference" / "api").glob("*.rst"))
    wanted = {place.replace(":", ".") for place in PROVIDERS.values() if place.endswith("Plots")}
    assert {name for name in wanted if f".. autoclass:: {name}\n   :members:" not in pages} == set()


def test_the_first_line_of_every_page_says_whom_it_is_for() -> None:
    docs = ROOT / "docs"
    written = [page for ending in ("md", "rst") for page in docs.rglob(f"[!_]*.{ending}")]
    written = [page for page in written if not any(part.startswith("_") for part in page.relative_to(docs).parts)]
    texts = {page: re.split(r"\n{2,}", page.read_text(encoding="utf-8"), maxsplit=2) for page in written}
    assert len(texts) > 30
    assert [page for page, parts in texts.items() if not parts[1].startswith("For ")] == []


# ---- the built site ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site() -> Path:
    if not (SITE / "index.html").is_file():
        missing = "the site is not built: python -m sphinx -W -b html docs docs/_build"
        pytest.fail(missing) if os.environ.get("ROTORFIT_SITE") == "required" else pytest.skip(missing)
    return SITE


class Parts(HTMLParser):
    """Anchors, targets and images of a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.images_without_words: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        self.anchors |= {found[name] for name in ("id", "name") if name in found}
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        if "src" in found:
            self.loaded.append(found["src"])
        if tag == "link" and found.get("rel") != "canonical":
            self.loaded.append(found["href"])
        thumbnail = found.get("src", "").endswith("_thumb.png")  # its page's title stands below it
        if tag == "img" and not thumbnail and not found.get("alt", "").strip():
            self.images_without_words.append(found["src"])


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Parts]:
    return {page: Parts(page) for page in site.rglob("*.html") if "_static" not in page.parts}


def test_every_link_inside_leads_somewhere(pages: dict[Path, Parts]) -> None:
    assert len(pages) > 50
    dead = []
    for page, parts in pages.items():
        for link in (*parts.links, *parts.loaded):
            target = urlsplit(link)
            if target.scheme:
                continue
            there = (page.parent / unquote(target.path)).resolve() if target.path else page
            found = there.is_file() or (there / "index.html").is_file()
            if found and target.fragment and there in pages:
                found = unquote(target.fragment) in pages[there].anchors
            if not found:
                dead.append(f"{page.relative_to(SITE)}: {link}")
    assert dead == []


def test_no_page_loads_from_a_server(pages: dict[Path, Parts]) -> None:
    assert [f"{page}: {src}" for page, parts in pages.items() for src in parts.loaded if urlsplit(src).netloc] == []
    sheets = [sheet for sheet in SITE.rglob("*.css") if re.search(r"url\(['\"]?(https?:)?//", sheet.read_text("utf-8"))]
    assert sheets == []


def test_every_picture_has_words(pages: dict[Path, Parts]) -> None:
    assert [f"{page}: {src}" for page, parts in pages.items() for src in parts.images_without_words] == []


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", MAIN_PAGES)
def test_main_pages_in_a_browser(
    site: Path, chromium: Callable[..., tuple[str, list[str]]], name: str, width: int
) -> None:
    page = site / name
    measured, frame = page.with_name(f"measured-{page.name}"), page.with_name(f"frame-{page.name}")
    measured.write_text(page.read_text(encoding="utf-8").replace("</body>", MEASURE + "</body>"), encoding="utf-8")
    frame.write_text(FRAME.format(src=measured.name, width=width), encoding="utf-8")
    try:
        dom, console = chromium(frame, "--window-size=1400,1000", "--virtual-time-budget=5000", "--dump-dom")
    finally:
        measured.unlink()
        frame.unlink()
    assert [line for line in console if THEME_SAYS not in line] == []
    found = json.loads(unescape(re.findall(r"<output>(.*?)</output>", dom, re.DOTALL)[0]))
    assert found["window"] == width
    assert found["page"] <= found["window"], "the page scrolls sideways"
    assert found["cut"] == []
    assert found["broken"] == []


@pytest.mark.parametrize("name", MAIN_PAGES)
def test_main_pages_are_accessible(site: Path, chromium: Callable[..., tuple[str, list[str]]], name: str) -> None:
    if os.environ.get("ROTORFIT_SITE") != "required":
        pytest.importorskip("axe_core_python", reason="pip install axe-core-python")
    import axe_core_python as axe

    script = (Path(axe.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
    page = site / name
    measured = page.with_name(f"axe-{page.name}")
    text = page.read_text(encoding="utf-8")
    measured.write_text(text.replace("</body>", f"<script>{script}</script>{ACCESS}</body>"), encoding="utf-8")
    try:
        dom, _ = chromium(measured, "--window-size=1300,1000", "--virtual-time-budget=20000", "--dump-dom")
    finally:
        measured.unlink()
    (found,) = re.findall(r"<output>(.*?)</output>", dom, re.DOTALL)
    assert json.loads(unescape(found)) == []


@pytest.mark.parametrize("name", slow_but(TUTORIALS, "your_file", "experiments", "plot_fig_11_oil"))
def test_notebooks_run_and_show_their_figures(
    site: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code of all pages is run by tests/whole/test_docs.py and by the build; here it is a notebook's."""
    nbclient = pytest.importorskip("nbclient", reason="of the extra docs")
    import nbformat

    monkeypatch.delenv("MPLBACKEND")  # as in a browser
    (file,) = (site / "_downloads").rglob(f"{name}.ipynb")
    book = nbformat.read(file, as_version=4)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(book, timeout=300, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    saved = sum(cell.source.count("display(") for cell in book.cells if cell.cell_type == "code")
    wanted = 2 if name.startswith("plot_") else saved  # the gallery's are the last values of cells
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= wanted
