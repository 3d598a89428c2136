"""Every page with Python blocks as a notebook to download, in which figures are shown where the page saves them."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).parent.parent
NOTEBOOKS = DOCS / "_notebooks"
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
_SAVED = re.compile(r"^(\S.*)\.savefig\([^()]*\)$", re.MULTILINE)
_PICTURE = re.compile(r"^!\[.*\]\(.*\)$\n?|^(?:<!--|-->)$\n?", re.MULTILINE)
"""A page's pictures, which a notebook draws itself, and marks of what a page does not show."""
_LINK_INSIDE = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)]*\)")


def cells_of(text: str) -> list[dict[str, object]]:
    """Cells of a page of Markdown: text and code."""
    cells: list[dict[str, object]] = []
    begin = 0
    for block in _BLOCK.finditer(text):
        if block[1] == "python":
            cells += [
                _cell("markdown", text[begin : block.start()]),
                _cell("code", _SAVED.sub(r"display(\1)", block[2])),
            ]
            begin = block.end()
    cells.append(_cell("markdown", text[begin:]))
    return [cell for cell in cells if cell["source"]]


def _cell(kind: str, source: str) -> dict[str, object]:
    if kind == "markdown":
        source = _LINK_INSIDE.sub(r"\1", _PICTURE.sub("", source))
    of_code = {"execution_count": None, "outputs": []} if kind == "code" else {}
    return {"cell_type": kind, "metadata": {}, "source": source.strip("\n"), **of_code}


def notebook(text: str) -> str:
    """A page of Markdown as the text of an ``.ipynb`` file."""
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    whole = {"cells": cells_of(text), "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 4}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _offer(app: Sphinx, docname: str, source: list[str]) -> None:
    page = Path(app.env.doc2path(docname))
    if page.suffix != ".md" or "\n```python\n" not in source[0] or docname.startswith("_"):
        return
    NOTEBOOKS.mkdir(exist_ok=True)
    file = NOTEBOOKS / f"{page.stem}.ipynb"
    file.write_text(notebook(page.read_text(encoding="utf-8")), encoding="utf-8")
    link = os.path.relpath(file, page.parent)
    source[0] += f"\n\nThis page as a notebook: {{download}}`{file.name} <{link}>`.\n"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write a page's notebook when the page is read."""
    app.connect("source-read", _offer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
