"""Run the Python blocks of README.md and the pages of docs/; put what they print and draw into the documents.

A page's blocks run top to bottom in an empty folder. A ``text`` block right
after a Python block is what that prints; pictures that a block saves are those of docs/.

    python docs/make.py [PAGE ...]

The picture of the first pages, which ``overview.py`` draws, is made with the README.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import overview
from PIL import Image

ROOT = Path(__file__).parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("[!_]*.md")), *sorted((ROOT / "docs").glob("[!_]*/*.md")))
_BLOCK = re.compile(
    r"^```python\n(?P<code>.*?)^```\n(?:(?P<between>\n|:::\n:::\{grid-item\}\n)```text\n(?P<shown>.*?)^```\n)?",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Outcome:
    """One Python block: the text block shown after it, if there is one, and what it printed now."""

    code: str
    shown: str | None
    printed: str


def run_page(page: Path, folder: Path) -> list[Outcome]:
    """Run the blocks of a page, in order and in one namespace, with ``folder`` as the working directory."""
    mpl.use("agg")
    names: dict[str, object] = {"__name__": page.stem}
    outcomes = []
    with contextlib.chdir(folder):
        for block in _BLOCK.finditer(page.read_text(encoding="utf-8")):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(block["code"], str(page), "exec"), names)
            text = "\n".join(line.rstrip() for line in printed.getvalue().splitlines())
            outcomes.append(Outcome(block["code"], block["shown"], f"{text}\n"))
    return outcomes


def rewrite(page: Path, outcomes: list[Outcome]) -> None:
    """Replace the text blocks of a page by what the blocks before them printed."""
    remaining = iter(outcomes)

    def fresh(block: re.Match[str]) -> str:
        outcome = next(remaining)
        if block["shown"] is None:
            return block[0]
        return f"```python\n{block['code']}```\n{block['between']}```text\n{outcome.printed}```\n"

    page.write_text(_BLOCK.sub(fresh, page.read_text(encoding="utf-8")), encoding="utf-8")


def main(pages: list[Path]) -> None:
    """Run pages, keep their pictures, rewrite their texts."""
    for page in pages or PAGES:
        with tempfile.TemporaryDirectory() as folder:
            outcomes = run_page(page, Path(folder))
            rewrite(page, outcomes)
            if page.name == "README.md":
                overview.save(Path(folder))
            for picture in sorted(Path(folder).glob("*.png")):
                colours = Image.open(picture).convert("RGB").quantize(128)  # a third of the size, to the eye the same
                colours.save(ROOT / "docs" / picture.name, optimize=True)
        print(f"{os.path.relpath(page, ROOT)}: {len(outcomes)} blocks")


if __name__ == "__main__":
    main([Path(word).resolve() for word in sys.argv[1:]])
