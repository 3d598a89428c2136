"""What a newcomer has to hold in mind, as numbers: depth of a plain fit, places that ask a kind, arrows, options.

    python tests/house.py                    print them, with what the file says
    python tests/house.py --list             also which places ask a kind, which files are in the circle, and so on
    python tests/house.py --check            exit code 1 if one is worse than tests/data/house.json says
    python tests/house.py --write "reason"   write those that changed into the file, with the reason

A commit that makes a number worse rewrites the file, and its reason is read with the change. The calls are those of the
second ``rf.fit`` and the second ``rf.read`` of the bundled rig: functions of rotorfit itself, without lambdas and
comprehensions. Imports are of every sort, those inside functions and for types included, and the front is a node.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import json
import pkgutil
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

import rotorfit as rf
from rotorfit.apps.cli.main import build_parser
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings

TESTS = Path(__file__).parent
HOUSE = TESTS / "data" / "house.json"
FRONT = rf.__name__
APPLICATIONS = (f"{FRONT}.apps", f"{FRONT}.__main__")
LARGER_IS_BETTER = "test files that enter below the applications, %"

Measured = tuple[float, list[str]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Calls:
    """Functions of rotorfit that ran."""

    functions: frozenset[tuple[str, str]]  # module and qualified name
    depth: int  # of the deepest chain
    given: frozenset[tuple[str, str]]  # those that were handed a watched object

    @property
    def files(self) -> list[str]:
        """Their modules."""
        return sorted({module for module, _ in self.functions})


def calls_of(work: Callable[[], Any], watched: Any = None) -> Calls:
    """What runs the second time that the work is done: the first one fills caches."""
    work()
    functions, given = set(), set()
    depth = deepest = 0

    def own(frame: FrameType) -> bool:
        name = str(frame.f_globals.get("__name__"))
        return name.partition(".")[0] == FRONT and not frame.f_code.co_name.startswith("<")

    def arrived(value: Any) -> bool:
        return value is watched or (isinstance(value, tuple | list) and any(one is watched for one in value))

    def note(frame: FrameType, event: str, _: Any) -> None:
        nonlocal depth, deepest
        if event not in ("call", "return") or not own(frame):
            return
        depth += 1 if event == "call" else -1
        deepest = max(depth, deepest)
        if event == "call":
            code = frame.f_code
            functions.add((frame.f_globals["__name__"], code.co_qualname))
            arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
            if watched is not None and any(arrived(frame.f_locals.get(name)) for name in arguments):
                given.add((frame.f_globals["__name__"], code.co_qualname))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return Calls(functions=frozenset(functions), depth=deepest, given=frozenset(given))


def dotted(names: frozenset[tuple[str, str]]) -> list[str]:
    """Full names, sorted."""
    return sorted(".".join(pair) for pair in names)


def calls() -> Iterator[tuple[str, Measured]]:
    """Of a plain fit, of reading a file, and of the way of an experiment into a problem."""
    rig, file = rf.datasets.rig_open(), rf.datasets.path("rig_open.csv")
    model, known = rf.models.WhirlWhip(), {"K3": 6000.0}
    fit, read = calls_of(lambda: rf.fit(model, rig, known=known)), calls_of(lambda: rf.read(file))
    for name, one in (("a plain fit", fit), ("reading a CSV", read)):
        yield f"functions of {name}", (len(one.functions), dotted(one.functions))
        yield f"files of {name}", (len(one.files), one.files)
        yield f"deepest chain of {name}", (one.depth, [])
    laid = calls_of(lambda: build_problem(model, (rig,), FitSettings(known=known)), rig)
    yield "functions that an experiment passes on its way into a problem", (len(laid.given), dotted(laid.given))


@cache
def sources() -> dict[str, ast.Module]:
    """The parsed code of every module, none of them imported."""
    found: dict[str, ast.Module] = {}
    for name in (FRONT, *(i.name for i in pkgutil.walk_packages(rf.__path__, f"{FRONT}."))):
        spec = find_spec(name)
        if spec is not None and spec.origin is not None:
            found[name] = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    return found


@cache
def nodes(tree: ast.Module) -> list[ast.AST]:
    """All of a tree."""
    return list(ast.walk(tree))


@cache
def imports(tree: ast.Module) -> list[tuple[str, str, str]]:
    """Modules and names that are imported, wherever in a tree, and what they are called there."""
    found = []
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, "", alias.asname or alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(str(node.module), alias.name, alias.asname or alias.name) for alias in node.names]
    return found


@cache
def arrows() -> dict[str, set[str]]:
    """Modules that each module imports."""
    found: dict[str, set[str]] = {}
    for name, tree in sources().items():
        wanted = {whole if (whole := f"{home}.{what}") in sources() else home for home, what, _ in imports(tree)}
        found[name] = {home for home in wanted if home in sources()} - {name}
    return found


def largest_circle() -> list[str]:
    """The most modules each of which leads to every other one."""
    reached: dict[str, set[str]] = {}
    for name in arrows():
        seen, left = set(), [name]
        while left:
            new = arrows()[left.pop()] - seen
            seen |= new
            left.extend(new)
        reached[name] = seen
    circles = [sorted(other for other in reached[name] if name in reached[other]) for name in reached]
    return max(circles, key=len)


def rooms() -> Iterator[tuple[str, Measured]]:
    """Rooms, arrows between them and loose modules, and the circle."""

    def room(name: str) -> str:
        return name.split(".")[1] if "." in name else FRONT

    held = Counter(room(name) for name in sources() if name.count(".") > 1)
    tops = [name for name, n in held.items() if n > 1 and name not in ("models", "estimators")]
    between = {(room(a), room(b)) for a, several in arrows().items() for b in several if room(a) != room(b)}
    yield "rooms in rotorfit/", (len(tops), tops)
    yield "arrows between top rooms", (len(between), sorted(f"{a} -> {b}" for a, b in between))
    circle = largest_circle()
    yield "files in the largest circle of imports", (len(circle), circle)


def defined(home: str, name: str) -> tuple[str, ast.stmt | None]:
    """The module and the statement that define a name, imports followed."""
    for node in sources()[home].body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            return home, node
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == name for t in node.targets):
            return home, node
    for other, what, called in imports(sources()[home]):
        if called == name and other in sources() and what:
            return defined(other, what)
    return home, None


@cache
def family(home: str, name: str) -> tuple[str, ...]:
    """The files of the kinds of experiment, block or model that a name stands for: none if it is no kind."""
    home, node = defined(home, name)
    if isinstance(node, ast.ClassDef):
        if (home, node.name) in roots():
            return (home,)
        names = [part.id for base in node.bases for part in ast.walk(base) if isinstance(part, ast.Name)]
        return (home,) if any(family(home, base) for base in names) else ()
    if isinstance(node, ast.Assign):  # several kinds under one name
        return tuple(
            file for part in ast.walk(node.value) if isinstance(part, ast.Name) for file in family(home, part.id)
        )
    return ()


@cache
def roots() -> frozenset[tuple[str, str]]:
    """The classes that all kinds come from."""
    blocks = f"{FRONT}.estimators.blocks."
    found = {
        (name, node.name)
        for name, tree in sources().items()
        if name.startswith(blocks)
        for node in tree.body
        if isinstance(node, ast.ClassDef) and node.name in ("Block", "Observed", "OnResponses")
    }
    lab = f"{FRONT}.lab."
    first = next(kind for kind in reversed(rf.PerturbationTest.__mro__) if kind.__module__.startswith(lab))
    return frozenset({(first.__module__, first.__name__), (rf.models.RotorModel.__module__, "RotorModel"), *found})


def asked(node: ast.AST) -> list[ast.AST]:
    """The expressions in which a statement may name the kinds that it asks for."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "issubclass"):
        return [node.args[1]]
    if isinstance(node, ast.match_case):
        return [part.cls for part in ast.walk(node.pattern) if isinstance(part, ast.MatchClass)]
    if isinstance(node, ast.Dict):
        return [key for key in node.keys if key is not None]
    if isinstance(node, ast.FunctionDef) and any("register" in ast.unparse(one) for one in node.decorator_list):
        return [*node.decorator_list, *(one.annotation for one in node.args.args[:1] if one.annotation is not None)]
    return []


def types_asked(tree: ast.Module) -> set[ast.AST]:
    """``type(experiment)`` and the like, other than to say its name or to make another one."""
    found: set[ast.AST] = set()
    for node in nodes(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "type" and node.args:
            what = node.args[0]
            called = what.id if isinstance(what, ast.Name) else what.attr if isinstance(what, ast.Attribute) else ""
            if called in ("experiment", "test", "block", "model"):
                found.add(node)
    said = {node.value for node in nodes(tree) if isinstance(node, ast.Attribute)}
    return found - said - {node.func for node in nodes(tree) if isinstance(node, ast.Call)}


def places(name: str, tree: ast.Module) -> list[str]:
    """Lines of a module that ask of which kind an experiment, a block or a model is, kinds of its own left out."""
    typed, found = types_asked(tree), []
    for node in nodes(tree):
        named = [part for one in asked(node) for part in ast.walk(one)]
        called = [part.id for part in named if isinstance(part, ast.Name)]
        called += [part.attr for part in named if isinstance(part, ast.Attribute)]
        if node in typed or {file for one in called for file in family(name, one)} - {name}:
            where = node.pattern if isinstance(node, ast.match_case) else node
            found.append(f"{name}:{where.lineno}")  # type: ignore[attr-defined]
    return found


def kinds() -> Iterator[tuple[str, Measured]]:
    """Places that ask a kind what it is."""
    found = [place for name, tree in sources().items() for place in places(name, tree)]
    yield "places that ask a kind", (len(found), found)


def options_of(*words: str) -> set[str]:
    """Options that the help of a command, and of what it has below it, offers."""
    parser = build_parser()
    found: set[str] = set()
    left = [parser]
    for word in words:
        left = [below(left[0])[word]]
    while left:
        parser = left.pop()
        left += below(parser).values()
        found |= set(re.findall(r"^\s+(?:-\w(?: \S+)?, )?(--[a-z][\w-]*)", parser.format_help(), re.MULTILINE))
    return found - {"--help", "--help-all"}


def below(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of a parser's own commands."""
    groups = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {name: one for group in groups for name, one in group.items()}


def words() -> Iterator[tuple[str, Measured]]:
    """What users meet: members of a result, options."""
    members = {name for name in dir(rf.FitResult) if not name.startswith("_")}
    members |= {field.name for field in dataclasses.fields(rf.FitResult) if not field.name.startswith("_")}
    yield "public members of FitResult", (len(members), sorted(members))
    every, fit = options_of(), options_of("fit")
    yield "options of the command line", (len(every), sorted(every))
    yield "options of rotorfit fit", (len(fit), sorted(fit))


def size() -> Iterator[tuple[str, Measured]]:
    """Classes and lines of code."""
    classes = sum(isinstance(node, ast.ClassDef) for tree in sources().values() for node in nodes(tree))
    files = [Path(spec.origin) for name in sources() if (spec := find_spec(name)) and spec.origin]
    lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
    yield "classes", (classes, [])
    yield "lines of code, in thousands begun", (-(-lines // 1000), [str(lines)])


@cache
def enters_by_the_applications(file: Path) -> bool:
    """Whether a file of tests or of helpers takes the command line, the store or the app in its hands."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    tests = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    tests = [
        node for node in tests if node.name.startswith("test_") or "fixture" in ast.unparse(node).partition("def")[0]
    ]
    arguments = {one.arg for node in tests for one in node.args.args}
    homes = {home for home, _, _ in imports(tree)}
    homes |= {rf._HOME.get(node.attr, "") for node in nodes(tree) if isinstance(node, ast.Attribute)}  # rf.Store
    helpers = [one for home in homes for one in (TESTS / "rigs" / f"{home}.py", TESTS / f"{home}.py") if one.is_file()]
    return (
        not arguments.isdisjoint({"run", "draw"})
        or any(home.startswith(APPLICATIONS) for home in homes)
        or any(enters_by_the_applications(helper) for helper in helpers)
    )


def tests() -> Iterator[tuple[str, Measured]]:
    """The share of test files that enter below the applications."""
    files = sorted(TESTS.glob("*/test_*.py"))
    above = [f"{file.parent.name}/{file.name}" for file in files if enters_by_the_applications(file)]
    yield LARGER_IS_BETTER, (round(100 * (1 - len(above) / len(files))), above)


def measured() -> dict[str, Measured]:
    """Every number, with the names behind it."""
    return {name: value for part in (calls, kinds, rooms, words, size, tests) for name, value in part()}


def main() -> int:
    """Print, compare or write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--list", action="store_true", help="the names behind each number")
    choice.add_argument("--check", action="store_true", help="exit code 1 if a number is worse than in the file")
    choice.add_argument("--write", metavar="REASON", help="write the numbers that changed, with the reason")
    options = parser.parse_args()
    then = json.loads(HOUSE.read_text(encoding="utf-8")) if HOUSE.is_file() else {}
    now = measured()
    worse = False
    for name, (value, names) in now.items():
        before = then.get(name, {}).get("is")
        risen = before is None or (value < before if name == LARGER_IS_BETTER else value > before)
        worse |= risen
        if before != value or not options.check:
            compared = "" if before == value else f"   {'WORSE' if risen else 'better'} than in the file: {before}"
            print(f"{value:6g}  {name}{compared}")
        if options.list:
            print(*(f"          {one}" for one in names), sep="\n")
    if options.write is not None:
        kept = {name: old for name, old in then.items() if name in now and old["is"] == now[name][0]}
        found = {name: kept.get(name, {"is": value, "why": options.write}) for name, (value, _) in now.items()}
        rows = ",\n".join(f" {json.dumps(name)}: {json.dumps(row)}" for name, row in found.items())
        HOUSE.write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")
    elif now.keys() != then.keys() or worse:
        print('mend it, or write tests/data/house.json in the same commit: python tests/house.py --write "reason"')
    return int(options.check and worse)


if __name__ == "__main__":
    raise SystemExit(main())
