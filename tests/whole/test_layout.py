"""Which part may know which, what importing costs, and documentation that agrees with the signatures."""

from __future__ import annotations

import ast
import builtins
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
import textwrap
import tomllib
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from package_modules import MODULES
from sentences import refuses

import rotorfit
from rotorfit import datasets
from rotorfit.base.accessors import PROVIDERS

PACKAGE = Path(rotorfit.__file__).parent
HEAVY = ("matplotlib", "emcee", "xarray", "arviz", "numba", "scipy.stats", "h5py", "pyuff")


def source_of(name: str) -> Path:
    return Path(str(importlib.import_module(name).__file__))


@cache
def tree_of(name: str) -> ast.Module:
    return ast.parse(source_of(name).read_text(encoding="utf-8"))


def room(name: str) -> str:
    """The room of a module: the part after ``rotorfit``."""
    return ([*name.split("."), ""])[1]


def test_the_front_door_is_small() -> None:
    assert len(list(PACKAGE.glob("*.py"))) <= 6


def test_a_room_is_entered_by_its_files() -> None:
    """Imports in the ``__init__`` of a room would load all of it: ``import rotorfit`` would not stay light."""
    for name in MODULES:
        file = source_of(name)
        if file.name == "__init__.py" and room(name) not in ("", "models", "estimators", "datasets"):
            assert [type(node) for node in ast.parse(file.read_text(encoding="utf-8")).body] == [ast.Expr], name


def test_no_private_name_is_left_unused() -> None:
    """Functions, methods, classes and constants of one leading underscore, which their own file alone may use."""
    unused = []
    for name in MODULES:
        nodes = list(ast.walk(tree_of(name)))
        made = {n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.ClassDef)}
        made |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        used = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}
        used |= {n.attr for n in nodes if isinstance(n, ast.Attribute)}
        unused += [f"{name}.{one}" for one in made - used if re.fullmatch(r"_[a-zA-Z0-9].*[^_]", one)]
    assert unused == []


def test_every_module_imports_without_a_front_part() -> None:
    """Each of the lower packages can be used alone: importing it does not load the front."""
    code = (
        "import sys, rotorfit.estimators.minimisation.least_squares, rotorfit.estimators.starting.closed_form\n"
        "front = [m for m in sys.modules if m.startswith('rotorfit.')"
        " and not m.startswith(('rotorfit.models', 'rotorfit.estimators', 'rotorfit.base'))]\n"
        "sys.exit(' '.join(front) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_import_is_light_and_quick() -> None:
    code = (
        "import time\nbegin = time.perf_counter()\nimport rotorfit\nprint(time.perf_counter() - begin)\n"
        "rotorfit.models; rotorfit.fit\nimport sys\n"
        f"print(*[m for m in {HEAVY!r} if m in sys.modules])"
    )
    runs = [subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True) for _ in range(5)]
    assert [run.stdout.splitlines()[1] for run in runs] == [""] * 5
    assert min(float(run.stdout.splitlines()[0]) for run in runs) < 0.4


def test_first_fit_needs_no_heavy_package() -> None:
    """Plots, samplers and compilers are loaded when they are asked for."""
    code = (
        "import rotorfit as rf, sys\n"
        "rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={'K3': 6000.0}).summary()\n"
        f"sys.exit(' '.join(m for m in {HEAVY!r} if m in sys.modules) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_report_without_figures_needs_no_heavy_package(tmp_path: Path) -> None:
    words = ["rotorfit", "fit", str(datasets.path("rig_open.csv")), "--model", "whirl-whip", "--known", "K3=6000"]
    words += ["--out", str(tmp_path / "fit"), "--no-figures", "--quiet"]
    code = (
        "import sys\nfrom rotorfit.__main__ import main\n"
        f"sys.argv = {words!r}\nassert main() == 0\n"
        f"sys.exit(' '.join(m for m in {HEAVY!r} if m in sys.modules) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert (tmp_path / "fit" / "report.html").exists()


@pytest.mark.parametrize("package", ["models", "estimators"])
def test_sub_packages_refuse_another_name(package: str) -> None:
    """A second copy of a class under another name would fail every isinstance test."""
    done = subprocess.run(
        [sys.executable, "-c", f"import {package}"], cwd=PACKAGE, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert f"import this package as rotorfit.{package}" in done.stderr


def test_all_public_names_resolve() -> None:
    for name in rotorfit.__all__:
        assert getattr(rotorfit, name) is not None
    assert set(rotorfit.__all__) <= set(dir(rotorfit))
    with refuses(AttributeError):
        getattr(rotorfit, "fitt")  # noqa: B009


def test_no_module_hides_a_public_name() -> None:
    """Importing a module sets its name on the package: a function of the same name would be gone after that."""
    # Not asked of the package: there the answer is a module already, once a test before this one imported it.
    public = set(rotorfit.__all__) - {"datasets", "models"}
    assert not public & {room(name) for name in MODULES}


def test_type_checkers_see_every_public_name() -> None:
    """A name imported under its own name again is exported; any other import is private to a strict type checker."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    exported = {alias.name: node.module for node in imports for alias in node.names if alias.asname == alias.name}
    assert exported == {name: home or "rotorfit" for name, home in rotorfit._HOME.items()}


def test_what_a_storey_above_provides_is_a_member_of_the_record(rig_fit: rotorfit.FitResult) -> None:
    """Of the class the provider itself, with its documentation; of a record something to be called."""
    for member, place in PROVIDERS.items():
        owner, _, name = member.partition(".")
        kind = getattr(rotorfit, owner, None) or getattr(rotorfit.models, owner)
        provider = getattr(kind, name)
        assert (getattr(provider, "__wrapped__", provider)).__module__ == place.partition(":")[0]
        assert inspect.getdoc(provider)
        assert not inspect.isclass(provider) or callable(provider(None)), member
    assert "bode" in dir(rig_fit.plot)
    assert {"plot", "plot_bode"} & {*dir(rig_fit)} == {"plot"}


# ---- documentation ----------------------------------------------------------------------------


def public_callables() -> dict[str, object]:
    """Public functions, classes and methods of all modules, without what decorators put round them."""
    found: dict[str, object] = {}

    def add(name: str, thing: object) -> None:
        function = inspect.unwrap(getattr(thing, "__func__", thing))  # type: ignore[arg-type]
        if inspect.isfunction(function) and function.__module__ in MODULES:
            found[name] = function

    for module in MODULES:
        for name, thing in vars(importlib.import_module(module)).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != module:
                continue
            add(f"{module}.{name}", thing)
            if inspect.isclass(thing):
                found[f"{module}.{name}"] = thing
                for method, function in vars(thing).items():
                    if not method.startswith("_"):
                        add(f"{module}.{name}.{method}", function)
    return found


CALLABLES = public_callables()
EXPORTED = [getattr(rotorfit, name) for name in rotorfit._HOME if rotorfit._HOME[name]]
EXPORTED += [thing for name in rotorfit.models.__all__ if callable(thing := getattr(rotorfit.models, name))]
PROVIDED = [
    getattr(importlib.import_module(place.partition(":")[0]), place.partition(":")[2]) for place in PROVIDERS.values()
]
FOR_USERS = {inspect.unwrap(thing) for thing in (*EXPORTED, *PROVIDED)}


GIVEN_THE_RECORD = {inspect.unwrap(thing) for thing in PROVIDED}
"""Providers of members of records: their first argument is the record, as ``self`` is of a method."""


def for_users(name: str) -> bool:
    """Whether users call it: what the package or its models export, and methods of that. Internals have a line."""
    owner = CALLABLES.get(name.rpartition(".")[0])
    return CALLABLES[name] in FOR_USERS or owner in FOR_USERS


CLASSES = {name: thing for name, thing in CALLABLES.items() if inspect.isclass(thing)}
PROTOCOLS = [thing for thing in CLASSES.values() if getattr(thing, "_is_protocol", False)]


def entries(docstring: str | None, title: str) -> list[str] | None:
    """Names that a section of a docstring explains, None without it."""
    section = re.search(rf"^{title}:\n((?:    .*\n|\n)+)", inspect.cleandoc(docstring or "") + "\n", re.MULTILINE)
    if section is None:
        return None
    found = re.findall(r"^    (\*{0,2}[\w.]+(?:, \*{0,2}[\w.]+)*):(?:\s|$)", section[1], re.MULTILINE)
    return [name.lstrip("*") for names in found for name in names.split(", ")]


def documented(docstring: str | None) -> list[str] | None:
    """Names in the Args section, None without one."""
    return entries(docstring, "Args")


def arguments(thing: object) -> list[str]:
    function = thing.__init__ if inspect.isclass(thing) else thing  # type: ignore[misc]
    names = [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]  # type: ignore[arg-type]
    return names[1:] if thing in GIVEN_THE_RECORD else names


def members(kind: type) -> set[str]:
    """Attributes and methods of a class and its bases, those that are annotated only included."""
    return {*dir(kind), *(name for base in kind.__mro__ for name in vars(base).get("__annotations__", ()))}


def stands_in_for(kind: type) -> list[type]:
    """Base classes of a class, and the protocols that it answers."""
    answered = [p for p in PROTOCOLS if {name for name in members(p) if not name.startswith("_")} <= members(kind)]
    return [*kind.__mro__[1:], *answered]


def undocumented(callables: dict[str, object], classes: dict[str, type]) -> list[str]:
    """Functions and methods whose Args part does not name their arguments.

    A method of a base class or a protocol is documented there: one that takes its place, with the same arguments, says
    at most what is different. A sentence that names all arguments may stand in place of the Args part.
    """
    found = []
    for name, function in callables.items():
        owner, _, own = name.rpartition(".")
        told = [documented(function.__doc__)]
        if told == [None] and owner in classes:
            told = [documented(vars(kind)[own].__doc__) for kind in stands_in_for(classes[owner]) if own in vars(kind)]
        wanted = arguments(function)
        said = [
            ("``ax`` and ``unit``" if one in ("look", "sheet") else f"``{one}``") in str(function.__doc__)
            for one in wanted
        ]
        if wanted not in (*told, []) and not (documented(function.__doc__) is None and all(said)):
            found.append(name)
    return found


def test_documented_arguments_of_a_class_are_those_of_its_signature() -> None:
    for name, kind in CLASSES.items():
        assert documented(kind.__doc__) in (None, arguments(kind)), name


def test_functions_and_methods_document_their_arguments() -> None:
    functions = {name: thing for name, thing in CALLABLES.items() if name not in CLASSES and for_users(name)}
    assert len(functions) > 250
    assert undocumented(functions, CLASSES) == []


def test_an_argument_that_is_not_documented_is_found() -> None:
    class Base:
        def moved(self, by: float) -> None:
            """Elsewhere.

            Args:
                by: how far, m.
            """

    class Alike(Base):
        def moved(self, by: float) -> None:
            """Twice as far."""

    class Other(Base):
        def moved(self, by: float, along: str = "x") -> None:
            """Along an axis."""

    kinds = {kind.__name__: kind for kind in (Base, Alike, Other)}
    methods: dict[str, object] = {f"{name}.moved": vars(kind)["moved"] for name, kind in kinds.items()}
    assert undocumented(methods, kinds) == ["Other.moved"]


def raised(function: object) -> list[str]:
    """Exceptions that a function makes and raises itself; what others in it raise, called or defined, is theirs."""
    todo: list[ast.AST] = list(ast.parse(textwrap.dedent(inspect.getsource(function))).body[0].body)  # type: ignore
    found = []
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            found.append(ast.unparse(node.exc.func).rpartition(".")[2])
        if not isinstance(node, ast.FunctionDef | ast.Lambda):
            todo += ast.iter_child_nodes(node)
    return [name for name in found if name != "NotImplementedError"]


def exceptions(kind: type) -> dict[str, type]:
    """An exception and all that are kinds of it, by name."""
    kinds = {name: one for below in kind.__subclasses__() for name, one in exceptions(below).items()}
    return {**kinds, kind.__name__: kind}


def test_errors_that_a_function_raises_are_documented() -> None:
    kinds = exceptions(BaseException) | {
        name: one for name, one in vars(builtins).items() if name.endswith("Error") and inspect.isclass(one)
    }
    found = []
    for name, function in CALLABLES.items():
        if not for_users(name):
            continue
        told = tuple(kinds[one.rpartition(".")[2]] for one in entries(function.__doc__, "Raises") or ())
        own = [] if name in CLASSES else raised(function)
        found += [f"{name}: {error}" for error in own if not issubclass(kinds[error], told)]
    assert found == []


def fields(kind: type) -> set[str]:
    """Fields that a record has of its own; those of its base are documented there."""
    names = [field.name for field in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    own = vars(kind).get("__annotations__", ())
    return {name for name in (*names, *getattr(kind, "_fields", ())) if name in own and not name.startswith("_")}


def test_documented_attributes_are_those_of_the_class() -> None:
    for name, kind in CLASSES.items():
        if not for_users(name):
            continue
        told = {*(entries(kind.__doc__, "Attributes") or ()), *(entries(kind.__doc__, "Args") or ())}
        assert fields(kind) <= told, name
        source = inspect.getsource(kind)
        gone = {*(entries(kind.__doc__, "Attributes") or ())} - members(kind)
        assert [own for own in gone if not re.search(rf"\bself\.{own}\b", source)] == [], name


def there(target: str, scopes: list[object]) -> bool:
    """Whether a dotted name leads somewhere from one of the scopes."""
    for start in scopes:
        place = start
        for part in target.split("."):
            if not (hasattr(place, part) or (inspect.isclass(place) and part in members(place))):
                break
            place = getattr(place, part, None)
        else:
            return True
    return False


def test_names_that_docstrings_refer_to_are_there() -> None:
    def missing(node: ast.AST, kind: object, module: ModuleType) -> list[str]:
        found = []
        for child in ast.iter_child_nodes(node):
            outermost = isinstance(child, ast.ClassDef) and kind is module
            found += missing(child, getattr(module, child.name) if outermost else kind, module)  # type: ignore[attr-defined]
            if isinstance(child, ast.Constant) and isinstance(child.value, str):
                told = re.findall(r":(?:func|meth|class|data|attr|mod|exc):`~?([^`]+)`", child.value)
                scopes = [kind, module, rotorfit, builtins, SimpleNamespace(rotorfit=rotorfit)]
                found += [target for target in told if not there(target, scopes)]
        return found

    for name in MODULES:
        module = importlib.import_module(name)
        assert missing(tree_of(name), module, module) == [], name


@pytest.mark.parametrize("storey", ["base", "models", "estimators"])
def test_tests_of_a_storey_take_nothing_from_above(storey: str) -> None:
    """``pytest tests/models`` is quick and says where a fault is. Bundled data are no code."""
    root = Path(__file__).parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    above = {*layers[: layers.index(storey)]} - {"datasets"}
    homes = {name: room(f"{home}.") for name, home in rotorfit._HOME.items() if home}
    taken = []
    for file in (root / "tests" / storey).glob("test_*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("rotorfit"):
                taken += [(file.name, room(f"{node.module}.{alias.name}")) for alias in node.names]
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rf":
                taken.append((file.name, homes.get(node.attr, node.attr)))
    assert [(file, home) for file, home in taken if home in above] == []


def test_records_that_hold_arrays_compare_without_an_error() -> None:
    """By identity, or as they say: what a dataclass does by itself raises where an array is not one number."""
    array = re.compile(r"\b(Float|ComplexArray|Index|Bool|Text|Records|NDArray)\b")
    raising = {
        f"{kind.__module__}.{kind.__name__}"
        for name in MODULES
        for kind in vars(importlib.import_module(name)).values()
        if isinstance(kind, type) and dataclasses.is_dataclass(kind) and kind.__module__.startswith("rotorfit")
        if vars(kind).get("__eq__") is not None and vars(kind)["__eq__"].__code__.co_filename == "<string>"
        if any(
            array.search(str(f.type)) and "Callable" not in str(f.type) and f.compare for f in dataclasses.fields(kind)
        )
    }
    assert raising == set()
