"""Power of the tests: errors put into the code one at a time, and the share of them that the tests find.

    python tests/mutation.py --record                  once: which test runs which line, and how long each test takes
    python tests/mutation.py --places 200 --seed 21    then the score, and every error that no test found

An error is a sign or an operator exchanged, a comparison turned, a condition negated, or a number half as large again.
Places are drawn from all of them, those that no test runs included. A place's tests run from the quickest to the
slowest until one fails or those that fit into ``--seconds`` have passed.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
CODE = ("models", "estimators", "rotorfit")
RECORD = ROOT / ".mutation"
"""Where the record of a full run is kept: lines by test, and seconds by test."""
OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.Lt: ">=",
    ast.LtE: ">",
    ast.Gt: "<=",
    ast.GtE: "<",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.And: "or",
    ast.Or: "and",
}
FOUND_BY_ITS_TIME = 10.0
"""Times its own time, and a test hangs by the error: more than a loaded machine makes of it."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """One error to put into a file: the text between two offsets, and what stands there instead."""

    file: str
    line: int
    start: int
    stop: int
    instead: str

    def put_into(self, tree: Path) -> str:
        """Write the file with the error; the text before."""
        path = tree / self.file
        before = path.read_bytes()
        path.write_bytes(before[: self.start] + self.instead.encode() + before[self.stop :])
        return before.decode()

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: -> {self.instead.strip()}"


# ---- errors -------------------------------------------------------------------------------------


def places(file: Path) -> Iterator[Place]:
    """All errors that can be put into a file."""
    content = file.read_bytes()
    starts = [0]
    for text in content.splitlines(keepends=True):
        starts.append(starts[-1] + len(text))

    def offset(line: int, column: int) -> int:
        return starts[line - 1] + column

    def place(line: int, start: int, stop: int, instead: str) -> Place:
        return Place(file=str(file.relative_to(ROOT)), line=line, start=start, stop=stop, instead=instead)

    for node in ast.walk(ast.parse(content)):
        for left, operator, right in _between_operands(node):
            if type(operator) in OPERATORS:
                start = offset(left.end_lineno or 0, left.end_col_offset or 0)
                stop = offset(right.lineno, right.col_offset)
                between = content[start:stop].decode()
                if all(character in " \n()+-*/<>=!andor" for character in between):  # no comment in between
                    kept = "".join(character for character in between if character in "()\n")
                    opening, closing = kept.replace(")", ""), kept.replace("(", "").replace("\n", "")
                    yield place(left.end_lineno or 0, start, stop, f"{closing} {OPERATORS[type(operator)]} {opening}")
        if isinstance(node, ast.If | ast.IfExp | ast.While):
            test = node.test
            start = offset(test.lineno, test.col_offset)
            stop = offset(test.end_lineno or 0, test.end_col_offset or 0)
            yield place(test.lineno, start, stop, f"(not ({content[start:stop].decode()}))")
        if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
            start, stop = offset(node.lineno, node.col_offset), offset(node.lineno, node.end_col_offset or 0)
            larger = node.value + 1 if isinstance(node.value, int) else 1.5 * node.value
            yield place(node.lineno, start, stop, repr(larger))


def _between_operands(node: ast.AST) -> Iterator[tuple[ast.expr, ast.AST, ast.expr]]:
    """Operators of a node, each with the operand before and after it."""
    if isinstance(node, ast.BinOp):
        yield node.left, node.op, node.right
    if isinstance(node, ast.Compare):
        yield from zip([node.left, *node.comparators[:-1]], node.ops, node.comparators, strict=True)
    if isinstance(node, ast.BoolOp):
        yield from ((left, node.op, right) for left, right in zip(node.values, node.values[1:], strict=False))


def drawn(count: int, seed: int) -> list[Place]:
    """Places from all over the code, the same for the same seed and code."""
    files = sorted(path for room in CODE for path in (ROOT / room).rglob("*.py"))
    everywhere = [place for file in files for place in places(file)]
    return random.Random(seed).sample(everywhere, count)


# ---- which test runs which line -----------------------------------------------------------------


def record(words: Sequence[str]) -> None:
    """Run the tests once, with the lines that each of them runs."""
    RECORD.mkdir(exist_ok=True)
    contexts = ["--cov=rotorfit", "--cov-context=test", "--cov-report=", f"--junitxml={RECORD / 'times.xml'}"]
    environment = os.environ | {"COVERAGE_FILE": str(RECORD / "lines")}
    command = [sys.executable, "-m", "pytest", "-q", "-n", "auto", "-o", "junit_family=xunit1", *contexts, *words]
    subprocess.run(command, cwd=ROOT, env=environment, check=False)


def seconds_of_tests() -> dict[str, float]:
    """Time of each test of the recorded run, by its name; tests that did not run are left out."""
    times: dict[str, float] = {}
    for case in ElementTree.parse(RECORD / "times.xml").iter("testcase"):
        if case.find("skipped") is None and case.find("failure") is None and case.get("file"):
            times[f"{case.get('file')}::{case.get('name')}"] = float(case.get("time", "0"))
    return times


def tests_of(place: Place, times: dict[str, float]) -> list[str]:
    """Tests that run the place's line, the quickest first; a line that only an import runs has those of its file."""
    from coverage.numbits import numbits_to_nums

    with sqlite3.connect(RECORD / "lines") as database:
        rows = database.execute(
            "SELECT context.context, line_bits.numbits FROM line_bits JOIN file ON file.id = line_bits.file_id "
            "JOIN context ON context.id = line_bits.context_id WHERE file.path LIKE ? AND context.context != ''",
            (f"%/{place.file}",),
        ).fetchall()
    names = {context.rsplit("|", 1)[0] for context, bits in rows if place.line in numbits_to_nums(bits)}
    names = names or {context.rsplit("|", 1)[0] for context, _ in rows}
    return sorted((name for name in names if name in times), key=times.__getitem__)


def within(names: list[str], times: dict[str, float], seconds: float) -> list[str]:
    """The first of them that take together no more than so many seconds, one at least."""
    chosen, taken = [], 0.0
    for name in names:
        taken += times[name]
        if chosen and taken > seconds:
            break
        chosen.append(name)
    return chosen


# ---- one error ----------------------------------------------------------------------------------


def found(place: Place, tree: Path, names: list[str], allowed: float) -> bool:
    """Whether a test fails, hangs or cannot be collected with the error in the code."""
    if not names:
        return False
    before = place.put_into(tree)
    listed = tree / "chosen.json"
    listed.write_text(json.dumps(names))
    command = [
        sys.executable,
        "-c",
        "import json, pytest\n"
        "raise SystemExit(pytest.main(['-x', '-q', '-p', 'no:cacheprovider', *json.load(open('chosen.json'))]))",
    ]
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=allowed, check=False)
    except subprocess.TimeoutExpired:
        return True
    finally:
        (tree / place.file).write_text(before)
    return done.returncode != 0


def score(count: int, seed: int, seconds: float, jobs: int) -> float:
    """Print each error that no test found; the share of those found."""
    times = seconds_of_tests()
    chosen = drawn(count, seed)
    with tempfile.TemporaryDirectory() as folder:
        trees: Queue[Path] = Queue()
        for number in range(jobs):
            tree = Path(folder) / str(number)
            shutil.copytree(
                ROOT, tree, symlinks=True, ignore=shutil.ignore_patterns(".git", ".venv", ".mutation", "__pycache__")
            )
            trees.put(tree)

        def judged(place: Place) -> bool:
            names = within(tests_of(place, times), times, seconds)
            tree = trees.get()
            try:
                allowed = 60.0 + FOUND_BY_ITS_TIME * sum(times[name] for name in names)
                answer = found(place, tree, names, allowed)
            finally:
                trees.put(tree)
            if not answer:
                print(f"not found by {len(names)} tests: {place}", flush=True)
            return answer

        with ThreadPoolExecutor(jobs) as pool:
            answers = list(pool.map(judged, chosen))
    return sum(answers) / len(answers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--record", action="store_true", help="run the tests once and keep which lines each of them runs"
    )
    parser.add_argument("--places", type=int, default=200)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests that a place is given")
    parser.add_argument("--jobs", type=int, default=2)
    options, words = parser.parse_known_args()
    if options.record:
        record(words)
        return
    share = score(options.places, options.seed, options.seconds, options.jobs)
    print(f"{share:.1%} of {options.places} errors found (seed {options.seed}, {options.seconds:g} s of tests a place)")


if __name__ == "__main__":
    main()
