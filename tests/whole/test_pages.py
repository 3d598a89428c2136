"""The pages for contributors name files and functions that are there; the bibliography holds what the code cites."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ("ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "docs/bibliography.md")


@pytest.mark.parametrize("page", PAGES)
def test_links_and_files_of_a_page_are_there(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    links = [link.partition("#")[0] for link in re.findall(r"\]\(([^)]+)\)", text) if not link.startswith("http")]
    assert [link for link in links if link and not ((ROOT / page).parent / link).exists()] == []
    files = re.findall(r"`((?:rotorfit|models|estimators|tests|docs|benchmarks)/[\w/.]+?)/?`", text)
    assert [file for file in files if not (ROOT / file).exists()] == []
    there = [str(file.relative_to(ROOT)) for file in ROOT.rglob("*.py")]
    short = re.findall(r"`([\w/]+\.py)`", text)
    assert [file for file in short if not any(f"/{path}".endswith(f"/{file}") for path in there)] == []
    folders = re.findall(r"`((?:base|lab|identify|show|studies|apps)/[\w/]+/)`", text)
    assert [folder for folder in folders if not (ROOT / "rotorfit" / folder).is_dir()] == []


def test_every_storey_and_every_room_is_drawn() -> None:
    drawing = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").split("```")[1]
    inits = [
        *ROOT.glob("rotorfit/*/__init__.py"),
        *ROOT.glob("rotorfit/*/*/__init__.py"),
    ]  # by the links, the lower two
    assert sorted({i.parent.name for i in inits if not re.search(rf"\b{i.parent.name}\b", drawing)}) == []
    layers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"][
        0
    ]
    drawn = re.findall(r"^ (\w+) +│", drawing, flags=re.MULTILINE)
    assert drawn == [layer for layer in layers["layers"] if layer != "__main__"]


def test_functions_on_the_way_from_file_to_result_are_where_the_page_says() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    named = re.findall(r"(\w+) \(((?:identify|lab|estimators)(?:\.\w+)+)\)", text)
    assert len(named) >= 6
    for function, module in named:
        source = (ROOT / "rotorfit" / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
        assert f"def {function}(" in source, (function, module)


def test_every_citation_is_in_the_bibliography() -> None:
    entries = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8").split("\n@")
    cited = set()
    for folder in ("rotorfit", "models", "estimators", "benchmarks"):
        for file in (ROOT / folder).rglob("*.py"):
            if not file.is_symlink():
                found = re.findall(
                    r"\b([A-Z][a-z]+(?:(?: and | & )[A-Z][A-Za-z]+| et al\.)?) \(?((?:19|20)\d\d)\b",
                    file.read_text(encoding="utf-8"),
                )
                cited |= {(re.split(r" and | & | et al", name)[0], year) for name, year in found}
    months = {"January", "May", "June", "July", "November", "Version", "Python", "In", "Since", "Matlab", "Excel"}
    missing = {
        (name, year)
        for name, year in cited
        if name not in months and not any(name in entry and f"year = {{{year}}}" in entry for entry in entries)
    }
    assert missing == set()
