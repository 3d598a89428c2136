"""What is built holds what the tree holds, once; the source tree and its links are as the package says."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import rotorfit

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGE_DIR = PYPROJECT["tool"]["setuptools"]["package-dir"]
PATTERNS = PYPROJECT["tool"]["setuptools"]["package-data"]


def folder_of(package: str) -> Path:
    """Source folder of a package, by the longest prefix in package-dir, as setuptools does."""
    prefix = max((p for p in PACKAGE_DIR if package == p or package.startswith(p + ".")), key=len)
    return ROOT / PACKAGE_DIR[prefix] / package[len(prefix) + 1 :].replace(".", "/")


def shipped_files() -> set[str]:
    """Paths inside the wheel that the tree asks for."""
    names = set()
    for package in PYPROJECT["tool"]["setuptools"]["packages"]:
        for pattern in ("*.py", *PATTERNS.get(package, ())):
            names |= {f"{package.replace('.', '/')}/{file.name}" for file in folder_of(package).glob(pattern)}
    return names


def test_helpers_on_the_path_of_tests_have_names_of_their_own() -> None:
    folders = PYPROJECT["tool"]["pytest"]["ini_options"]["pythonpath"]
    names = [file.name for folder in folders for file in (ROOT / folder).glob("*.py")]
    assert sorted(names) == sorted(set(names))


def test_packages_are_those_of_the_tree() -> None:
    found = set()
    for prefix, folder in PACKAGE_DIR.items():
        for init in (ROOT / folder).rglob("__init__.py"):
            inside = init.parent.relative_to(ROOT / folder)
            if not any((ROOT / folder / part).is_symlink() for part in (inside, *inside.parents) if part != Path()):
                found.add(".".join([prefix, *inside.parts]))
    assert sorted(PYPROJECT["tool"]["setuptools"]["packages"]) == sorted(found)


@pytest.mark.parametrize("name", ["models", "estimators"])
def test_links_lead_static_tools_to_the_sub_packages(name: str) -> None:
    link = ROOT / "rotorfit" / name
    assert link.is_symlink()
    assert link.readlink() == Path("..") / name
    assert PACKAGE_DIR[f"rotorfit.{name}"] == name


def test_no_data_file_is_left_behind() -> None:
    """Every file beside the code is named by package-data."""
    for package in PYPROJECT["tool"]["setuptools"]["packages"]:
        folder = folder_of(package)
        for file in folder.iterdir():
            if file.is_file() and file.suffix not in (".py", ".pyc"):
                assert any(file.match(pattern) for pattern in PATTERNS.get(package, ())), file


def test_version_and_licence() -> None:
    assert PYPROJECT["project"]["version"] == rotorfit.__version__
    assert (ROOT / PYPROJECT["project"]["license-files"][0]).is_file()


def test_declared_pythons() -> None:
    declared = [c for c in PYPROJECT["project"]["classifiers"] if re.match(r"Programming Language :: Python :: 3\.", c)]
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    (beside,) = re.findall(r"python: \[(.*)\]", workflow)
    run = ["3.11", "3.13", *re.findall(r"3\.\d+", beside)]  # .ci/run runs the tests on the first two
    assert [c.rpartition(" ")[2] for c in declared] == sorted(run)
    assert PYPROJECT["project"]["requires-python"] == ">=3.11"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist of a copy of the tree, and the wheel built from that sdist as an installer would."""
    folder = tmp_path_factory.mktemp("build")
    copy = folder / "tree"
    skip = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    for name in ("rotorfit", *(Path(d).name for d in PACKAGE_DIR.values() if d != "rotorfit")):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=skip)
    (copy / "tests").mkdir()
    shutil.copy(__file__, copy / "tests")
    for name in (
        "pyproject.toml",
        "MANIFEST.in",
        PYPROJECT["project"]["readme"],
        *PYPROJECT["project"]["license-files"],
    ):
        shutil.copy(ROOT / name, copy / name)
    build = "import setuptools.build_meta as b, sys; print(getattr(b, sys.argv[1])(sys.argv[2]))"
    subprocess.run([sys.executable, "-c", build, "build_sdist", str(folder)], cwd=copy, check=True, capture_output=True)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        # Pythons before 3.11.4 know no filters, those from 3.12 on warn without one.
        archive.extractall(folder / "unpacked", **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    (tree,) = (folder / "unpacked").iterdir()
    subprocess.run([sys.executable, "-c", build, "build_wheel", str(folder)], cwd=tree, check=True, capture_output=True)
    return folder


def test_wheel_holds_every_file_once(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
    assert sorted(names) == sorted(shipped_files())


def test_sdist_holds_the_sources_once(built: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    modules = [name for name in names if name.endswith("models/lumped.py")]
    assert modules == ["models/lumped.py"]
    assert len(names) == len(set(names))
    assert not [name for name in names if name.startswith("tests/")]  # without what they need they would not run
    for package in PYPROJECT["tool"]["setuptools"]["packages"]:
        folder = folder_of(package).relative_to(ROOT)
        for file in (ROOT / folder).glob("*.py"):
            assert str(folder / file.name) in names


def test_built_wheel_fits_the_rig(built: Path, tmp_path: Path) -> None:
    """The wheel alone, without the tree, does the main job."""
    (wheel,) = built.glob("*.whl")
    code = (
        "import rotorfit as rf\n"
        "fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={'K3': 6000.0})\n"
        "print(rf.__file__, fit.success)"
    )
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={"PYTHONPATH": str(tmp_path), "OMP_NUM_THREADS": "1"},
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.split() == [str(tmp_path / "rotorfit" / "__init__.py"), "True"]
