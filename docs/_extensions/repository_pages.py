"""Documents of the repository that stand outside ``docs/`` as pages of the site, and links that lead to them.

They are copied as they are; links, theirs and those of all pages, are turned where they lead on the site. A link to a
file that is no page becomes a download.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).parent.parent
ROOT = DOCS.parent
COPIES = DOCS / "_repository"
DOCUMENTS = ("CHANGELOG.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "benchmarks/README.md")
_LINK = re.compile(r"\]\((?P<target>[^()\s#]+)(?P<fragment>#[^()\s]*)?\)")
_CODE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def documents() -> list[Path]:
    """Documents outside ``docs/`` that are pages of the site."""
    return [*(ROOT / name for name in DOCUMENTS), *sorted((ROOT / "benchmarks" / "results").glob("*.md"))]


def copy_documents() -> None:
    """Bring the copies up to date; what did not change is not touched, so that nothing is built twice."""
    wanted = {COPIES / document.relative_to(ROOT): document for document in documents()}
    for there in COPIES.rglob("*.md"):
        if there not in wanted:
            there.unlink()
    for copy, document in wanted.items():
        text = document.read_text(encoding="utf-8")
        if not copy.is_file() or copy.read_text(encoding="utf-8") != text:
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_text(text, encoding="utf-8")


def turned_links(text: str, page: Path, original: Path) -> str:
    """The text of a page with links that lead from where it stands on the site.

    Args:
        text: Markdown.
        page: the file that Sphinx reads.
        original: the file that it is, or is a copy of.
    """
    pages = {ROOT / "README.md": DOCS / "index.md"}
    pages |= {document: COPIES / document.relative_to(ROOT) for document in documents()}

    def turned(link: re.Match[str]) -> str:
        if "://" in link["target"] or link["target"].startswith("mailto:"):
            return link[0]
        target = Path(os.path.normpath(original.parent / link["target"]))
        fragment = "" if target == ROOT / "README.md" else link["fragment"] or ""
        return f"]({os.path.relpath(pages.get(target, target), page.parent)}{fragment})"

    parts = _CODE.split(text)
    return "".join(part if part.startswith("```") else _LINK.sub(turned, part) for part in parts)


def _turn(app: Sphinx, docname: str, source: list[str]) -> None:
    page = Path(app.env.doc2path(docname))
    if page.suffix == ".md":
        original = ROOT / page.relative_to(COPIES) if page.is_relative_to(COPIES) else page
        source[0] = turned_links(source[0], page, original)
        if original.name == "CHANGELOG.md":  # names everything, and would come first whatever is looked for
            source[0] = f"---\nnosearch: true\n---\n{source[0]}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Copy the documents and turn links when pages are read."""
    copy_documents()
    app.connect("source-read", _turn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
