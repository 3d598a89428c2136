"""Settings of the site: ``python -m sphinx -W -b html docs docs/_build``. It asks no server, neither built nor read."""

from __future__ import annotations

import inspect
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

import rotorfit

ROOT = Path(__file__).parent.parent
REPOSITORY = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Repository"]

project = "rotorfit"
author = "The rotorfit maintainers"
version = release = rotorfit.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.linkcode",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinxcontrib.bibtex",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "command_line",
    "notebooks",
    "public_names",
    "repository_pages",
]
exclude_patterns = ["_build", "_extensions", "_notebooks", "paper"]
suppress_warnings = ["ref.python"]  # fields of records that have one name, such as ``attributes``
smartquotes = False  # -- stays what it is: the options of a command

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_default_options = {"inherited-members": "object, dict, tuple, Sequence, ABC, RotorModel, Exception, IntEnum"}
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False

sphinx_gallery_conf = {
    "examples_dirs": ["paper"],
    "gallery_dirs": ["_gallery"],
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("matplotlib", "result_figures"),
    "capture_repr": (),
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 20,
}


def linkcode_resolve(domain: str, info: dict[str, str]) -> str | None:
    """Where the repository holds what a page describes."""
    found = sys.modules.get(info["module"]) if domain == "py" else None
    for part in info["fullname"].split("."):
        found = getattr(found, part, None)
    try:
        found = inspect.unwrap(found.fget if isinstance(found, property) else found)
        lines, begin = inspect.getsourcelines(found)
        file = Path(inspect.getsourcefile(found) or "").resolve().relative_to(ROOT)
    except (TypeError, OSError, ValueError):  # data, and what other packages write
        return None
    return f"{REPOSITORY}/blob/main/{file}#L{begin}-L{begin + len(lines) - 1}"


def for_whom(app: Sphinx, docname: str, source: list[str]) -> None:
    """Say on the pages of the gallery too whom they are for; their first paragraph is the text of their thumbnail."""
    if docname.startswith("_gallery/plot_"):
        source[0] = re.sub(r"\n=+\n", r"\g<0>\nFor lecturers and readers of the paper.\n", source[0], count=1)


def listed(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: object) -> None:
    """Make items of a list of what docutils writes as bibliography entries within one, for those who hear the page."""
    if "body" in context:
        context["body"] = context["body"].replace('role="doc-biblioentry"', 'role="listitem"')


def setup(app: Sphinx) -> None:
    """Change pages as they are read and as they are written."""
    app.connect("source-read", for_whom)
    app.connect("html-page-context", listed)


html_theme = "pydata_sphinx_theme"
html_title = "rotorfit"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_context = {"default_mode": "auto"}  # light or dark, as the reader's system is
html_theme_options = {
    "logo": {"text": f"rotorfit {version}"},
    "icon_links": [{"name": "Source", "url": REPOSITORY, "icon": "fa-brands fa-github"}],
    "navigation_with_keys": False,
    "show_nav_level": 1,
    "header_links_before_dropdown": 7,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
