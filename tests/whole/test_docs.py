"""The documents: their Python blocks run and print what is shown after them, their pictures and links are there."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from house import options_of
from matplotlib.figure import Figure
from report_pages import DOT, leave_pixels_out
from slow_cases import slow_but

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.identify.uncertainty.posterior import Posterior

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("[!_]*.md")), *sorted((ROOT / "docs").glob("[!_]*/*.md"))]


LONG_PAGES = ("real_rig.md", "anisotropic_shaft.md", "volts.md", "uncertainty.md")
"""Pages whose blocks take ten seconds and more."""


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_make", ROOT / "docs" / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.syspath_prepend(ROOT / "docs")
    monkeypatch.setitem(sys.modules, spec.name, module)  # where dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def same(shown: str, printed: str) -> bool:
    """Equal words; numbers may differ by one in the last digit shown, which another machine may round over."""
    old, new = shown.split(), printed.split()
    if len(old) != len(new):
        return False
    for a, b in zip(old, new, strict=True):
        head, digits, tail = _number(a)
        other_head, other, other_tail = _number(b)
        if (head, tail) != (other_head, other_tail) or (digits is None) != (other is None):
            return False
        if digits is not None and other is not None:
            mantissa, _, exponent = digits.partition("e")
            step = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
            if abs(float(digits) - float(other)) > 1.01 * step:
                return False
    return True


def _number(word: str) -> tuple[str, str | None, str]:
    found = re.fullmatch(r"([\[(]*)(-?\d+\.?\d*(?:e[-+]\d+)?)([\]),;:%]*)", word)
    return (found[1], found[2], found[3]) if found else (word, None, "")


def test_comparison_of_printed_text() -> None:
    assert same("lam 0.4750 +- 5e-05, [1.2, 3]", "lam 0.4751 +- 6e-05, [1.3, 4]")
    assert not same("lam 0.4750", "lam 0.4752")
    assert not same("lam 0.4750", "D 0.4750")
    assert not same("3 runs", "3 of 4 runs")


def shell_lines(page: Path) -> list[str]:
    """Commands of a page, one a line."""
    shell = re.findall(r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return "".join(shell).splitlines()


@pytest.mark.parametrize("page", ["README.md", "docs/tutorials/your_file.md"])
def test_pages_write_the_files_that_their_commands_read(page: str) -> None:
    """In an empty folder: what a command reads, a line before it, or a block of the page, has written."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```(?:python|toml)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    there = set(re.findall(r"# *([\w-]+\.toml)", "".join(blocks)))
    for command in shell_lines(ROOT / page):
        words = command.partition("#")[0].replace('"', " ").replace(")", " ").split()
        named = {word for word in words if re.fullmatch(r"[\w-]+\.(csv|toml|h5)", word)}
        if words[0] == "python3":
            there |= named
        else:
            assert named <= there, command
            there |= {words[words.index("--out") + 1]} if "--out" in words else set()


@pytest.fixture(scope="module")
def every_option() -> set[str]:
    """Options of all commands."""
    return {*options_of(), "--help", "--help-all"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}-{page.name}")
def test_words_of_a_page_are_those_of_the_program(page: Path, every_option: set[str]) -> None:
    """Names and options in its sentences, which no block runs."""
    words = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    kinds = {"fit": rf.FitResult, "posterior": Posterior, "record": rf.Recording, "store": rf.Store, "rf": rf}
    suffixes = {"json", "toml", "csv", "nc", "db", "png"}
    for owner, name in re.findall(r"\b(fit|posterior|record|store|rf)\.([A-Za-z_]+)", words):
        fields = getattr(kinds[owner], "__dataclass_fields__", {})
        assert name in {*dir(kinds[owner]), *fields, *suffixes}, f"{owner}.{name}"
    typed = " ".join(re.findall(r"`((?:--|rotorfit )[^`]*)`", words))
    assert set(re.findall(r"(?<![\w-])--[a-z][\w-]*", typed)) <= every_option


def test_the_first_block_of_the_readme_is_within_its_first_screens() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert lines.index("```python") < 60
    commands = [line for line in lines if re.match("python3 .*(rotorfit demo|pytest)", line)]
    assert len(commands) == 2


def test_the_overview_has_the_digits_of_the_print(make: ModuleType) -> None:
    fit = make.overview.demo_fit()
    shown = " ".join(str(fit).split())
    for value, error, unit in make.overview.numbers(fit).values():
        assert f"{value} {error} " in shown
        assert unit in shown
    onset = re.search(r"above ([0-9.]+)", shown)
    assert onset is not None
    assert round(float(onset[1])) == round(fit.threshold_speed().to("rpm").value)  # the picture has no decimals


@pytest.mark.parametrize(
    "page",
    slow_but(PAGES, *(page for page in PAGES if page.name not in LONG_PAGES)),
    ids=lambda page: f"{page.parent.name}-{page.name}",
)
def test_blocks_run_and_print_what_is_shown(
    make: ModuleType, page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_pixels_out(monkeypatch)  # of reports, which tests/show/test_report.py looks at
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: Path(path).write_bytes(DOT))  # nor are others drawn
    for outcome in make.run_page(page, tmp_path):
        if outcome.shown is not None:
            assert same(outcome.shown, outcome.printed), f"python docs/make.py\n{outcome.code}\n{outcome.printed}"
    pictures = list(tmp_path.glob("*.png"))
    if page.parent == ROOT / "docs" or page.name == "watch.md":  # others are tested with the command line
        monkeypatch.chdir(tmp_path)  # where the blocks have written the files that the commands read
        for command in shell_lines(page):
            assert main(command.split()[1:]) == 0, command
    for picture in pictures:
        assert (ROOT / "docs" / picture.name).is_file(), f"{picture.name}: python docs/make.py"


@pytest.mark.parametrize("page", [*PAGES, ROOT / "benchmarks" / "README.md"], ids=lambda p: f"{p.parent.name}-{p.name}")
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).is_file(), target
