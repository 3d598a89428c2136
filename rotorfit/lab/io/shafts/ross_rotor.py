"""Rotors of the ROSS package: their matrices without the elements that a fit replaces."""

from __future__ import annotations

import copy
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Float
from rotorfit.base.atomic_file import note_input
from rotorfit.base.digits import significant
from rotorfit.base.file_reading import read_toml, reading
from rotorfit.base.names import unknown_name
from rotorfit.lab.io.shafts.structure_files import SAVED_ROTORS, read_structure
from rotorfit.models.known_structure import KnownStructure
from rotorfit.models.shafts.shaft import ROSS_4, ROSS_6

SPEED_FROM = 3
"""Line of ROSS from which tables over speed are called ``speed``; before, ``frequency`` meant the speed."""
_COEFFICIENTS = tuple(f"{kind}{axes}" for kind in "kcm" for axes in ("xx", "yy", "xy", "yx"))


def from_ross(
    kind: type[KnownStructure],
    rotor: Any,
    *,
    planes: Mapping[str, int | str],
    fluid: str | Sequence[str] = (),
    supports: str | Sequence[str] = (),
    magnetic: str | Sequence[str] = (),
    damping: str | Sequence[str] = (),
    speed: float | None = None,
    dofs: Sequence[str] = (),
    **options: Any,
) -> KnownStructure:
    """A rotor of the ROSS package as a known structure, its elements that are to be fitted taken out.

    ROSS itself is needed for rotors that it saved as TOML or JSON only.

    Args:
        rotor: a ``ross.Rotor`` (2.x or 3.x); or a file: matrices that ``rotor.save_mat`` wrote (MAT 5, with M, K,
            C, G and nodes), the same as ``.npz`` or as a folder of ``M.csv`` and so on, or a rotor saved by the
            line of ROSS that is installed.
        planes: node, counted from zero, of each plane; of a rotor also the tag of an element that stands there.
        fluid, supports, magnetic, damping: what is fitted, as for the class: planes or, of a rotor, tags of
            bearings and seals. A tagged element is taken out, because the fit finds what takes its place. Files of
            matrices know no tags: there the element is taken out before saving.
        speed: rotative speed, rad/s, at which elements that stay and change with speed are taken.
        dofs: coordinates of each node, as for the class, of files that hold neither ``nodes`` nor ``dofs``.
        **options: further arguments of the class.

    Raises:
        ValueError: unknown tags or nodes, elements that stay but change with speed or differ in x and y, a file
            of something else.
        OSError: no such file.

    Example:
        >>> rotor = rf.models.KnownStructure.from_ross(
        ...     "shaft.mat", planes={"disk": 7, "journal": 14}, fluid="journal"
        ... )  # doctest: +SKIP
    """
    taken_out = {
        name: (given,) if isinstance(given, str) else tuple(given)
        for name, given in (("fluid", fluid), ("supports", supports), ("magnetic", magnetic), ("damping", damping))
    }
    made = structure_options(rotor, planes=planes, taken_out=taken_out, speed=speed, dofs=dofs)
    if not isinstance(rotor, str | os.PathLike):
        return kind(**made, **options)
    try:
        model = kind(**made, **options)
    except ValueError as problem:
        raise ValueError(f"{rotor}: {problem}") from problem
    asked = {"planes": dict(planes), **taken_out, "speed": speed, "dofs": tuple(dofs), **options}
    model.made_from = {"structure": str(rotor), **{name: value for name, value in asked.items() if value}}
    return model


def structure_options(
    rotor: Any,
    *,
    planes: Mapping[str, int | str],
    taken_out: Mapping[str, Sequence[str]],
    speed: float | None,
    dofs: Sequence[str],
) -> dict[str, Any]:
    """Arguments of :class:`~rotorfit.models.KnownStructure` from a ``ross.Rotor`` or a path, with the node of each
    plane, or the tag of an element there.

    ``taken_out`` has by option (``fluid``, ``supports``, ``damping``) planes or tags that the fit replaces; elements
    whose coefficients change with speed are taken at ``speed``, rad/s; ``dofs`` are those of a file that does not say.
    """
    if isinstance(rotor, str | Path):
        path = Path(rotor)
        note_input(path)
        if path.suffix.lower() not in SAVED_ROTORS or path.is_dir():
            return _of_file(path.name, read_structure(path, dofs), planes, taken_out)
        rotor = _load_rotor(path)
    for name in ("M", "C", "G", "K", "bearing_elements", "nodes"):
        if not hasattr(rotor, name):
            raise ValueError(f"from_ross takes a ross.Rotor or a file, not a {type(rotor).__name__}")
    tags = {str(e.tag): e for e in (*rotor.disk_elements, *rotor.bearing_elements)}
    nodes: dict[str, int] = {}
    for plane, at in planes.items():
        if isinstance(at, str) and at not in tags:
            raise ValueError(f"plane {plane}: {unknown_name('element of the rotor', at, tags)}")
        nodes[plane] = int(tags[at].n) if isinstance(at, str) else at
    replaced: list[Any] = []
    options: dict[str, tuple[str, ...]] = {}
    for option, names in taken_out.items():
        options[option] = tuple(_plane_of(name, option, nodes, tags, replaced) for name in names)
    kept = copy.copy(rotor)
    kept.bearing_elements = [e for e in rotor.bearing_elements if not any(e is gone for gone in replaced)]
    _check_kept(kept, nodes, options["fluid"], speed)
    rate = 0.0 if speed is None else speed
    matrices = {"M": kept.M(rate), "C": kept.C(rate), "G": kept.G(), "K": kept.K(rate)}
    size, per_node = len(rotor.nodes) * int(rotor.number_dof), int(rotor.number_dof)
    if (beside := len(matrices["K"]) - size) != 0:
        raise ValueError(
            f"the rotor has {beside} coordinates beside those of its {len(rotor.nodes)} nodes, of support masses "
            "(n_link), which a known structure does not have. Link the bearings to the ground, or take them out"
        )
    return {**matrices, "planes": nodes, "dofs": ROSS_4 if per_node == len(ROSS_4) else ROSS_6, **options}


def _of_file(
    source: str, content: dict[str, Any], planes: Mapping[str, int | str], taken_out: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Matrices alone: elements have no names there, and none can be taken out."""
    for plane, at in planes.items():
        if isinstance(at, str):
            raise ValueError(f"plane {plane}: {source} holds matrices only; give the number of the node")
    for option, names in taken_out.items():
        for name in names:
            if name not in planes:
                raise ValueError(
                    f"{option} names {name!r}, but the planes are {', '.join(planes)}. {source} holds "
                    "matrices, which know no tags of elements: take the element out of the rotor before it is saved "
                    f"(rotor.save_mat), and give the plane where it stands"
                )
    for plane in taken_out.get("fluid", ()):
        _refuse_fluid_in_file(source, content, plane, planes[plane])
    return {"C": None, "G": None, **content, "planes": dict(planes), **taken_out}


def _refuse_fluid_in_file(source: str, content: dict[str, Any], plane: str, node: int | str) -> None:
    """Refuse matrices with damping to the ground or cross-coupling at the plane of the fluid: it was left in them."""
    count, K, C = len(content["dofs"]), content["K"], content.get("C")
    own = [int(node) * count + k for k, name in enumerate(content["dofs"]) if name in ("x", "y", "z")]
    if not own or max(own) >= len(K):
        return  # no such node, which the model says
    there = K[np.ix_(own, own)]
    cross = np.abs(there - there.conj().T).max() / 2  # of a complex z the imaginary part
    damping = 0.0
    if C is not None:
        elsewhere = np.delete(C[own], own, axis=1)
        damping = 0.0 if elsewhere.any() else float(np.abs(C[np.ix_(own, own)]).max())
    if damping or cross > ROUND_OFF * np.abs(K).max():
        raise ValueError(
            f"{source} has damping of {significant(damping, 4)} N s/m and cross-coupling of "
            f"{significant(cross, 4)} N/m at node {node}, where the fluid that is fitted acts (plane {plane}): take "
            "the bearing or seal out of the rotor before it is saved (rotor.save_mat)"
        )


# ---- a saved rotor ---------------------------------------------------------------------------------------------------


def installed_ross() -> str | None:
    """Version of the ROSS package that is installed, None without one."""
    try:
        return version("ross-rotordynamics")
    except PackageNotFoundError:
        return None


def imported_ross() -> Any:
    """The ROSS package; what it and its own imports print, some of it from compiled code, is left out of answers."""
    sys.stdout.flush()
    shown, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import ross
    finally:
        os.dup2(shown, 1)
        os.close(shown)
        os.close(nowhere)
    return ross


def line_of(release: str) -> int:
    """Line of ROSS that a version belongs to: 2 for 2.3.0."""
    first = release.partition(".")[0]
    if not first.isdecimal() or int(first) < 1:
        raise ValueError(f"version is {release!r}, which is none of ROSS as '2.3' or '3.1' are")
    return int(first)


def _load_rotor(path: Path) -> Any:
    """A rotor that ROSS saved, of the installed line or of the other."""
    with reading(path.name, "rotor saved by ROSS"):
        if path.suffix.lower() == ".json":
            content = json.loads(path.read_text(encoding="utf-8"))
        else:
            content = read_toml(path, path.name)
        if not isinstance(content, dict) or "parameters" not in content:
            raise ValueError(
                f"{path.name} is not a rotor saved by ROSS: it has no 'parameters'; rotor.save(path) writes one"
            )
    saved, here = str(content.get("ross_version", "unknown")), installed_ross()
    way = "Open it there and write its matrices: rotor.save_mat('shaft.mat', speed), which need no ROSS to be read"
    if here is None:
        raise ValueError(f"{path.name} is a rotor of ROSS {saved}, and ROSS is not installed here. {way}")
    with reading(path.name, f"rotor saved by ROSS {saved}", decoded=True):
        try:
            content = _in_line(content, line_of(saved), line_of(here))
        except ValueError as reason:
            raise ValueError(f"{path.name} was saved by ROSS {saved}, {here} is installed: {reason}. {way}") from reason
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder) / "rotor.json"
            whole.write_text(json.dumps({**content, "ross_version": here}), encoding="utf-8")
            return imported_ross().Rotor.load(whole)


def _in_line(content: Mapping[str, Any], saved: int, here: int) -> dict[str, Any]:
    """Content of a saved rotor as another line of ROSS writes it.

    A table over speed is called ``frequency`` up to 2.x and ``speed`` from 3.0 on, where ``frequency`` is that of the
    whirl: read as it is, a table would mean something else.
    """
    found = {name: dict(part) if isinstance(part, dict) else part for name, part in content.items()}
    elements = [part for part in found.values() if isinstance(part, dict)]
    if saved < SPEED_FROM <= here:
        for part in elements:
            if "frequency" in part:
                part["speed"] = part.pop("frequency")
    elif here < SPEED_FROM <= saved:
        for name in ("default_damping_ratio", "modal_damping_ratio", "alpha", "beta"):
            if found["parameters"].pop(name, None):
                raise ValueError(f"{here}.x has no {name} of a rotor")
        for part in elements:
            if part.get("frequency") is not None:
                raise ValueError(f"{here}.x has no tables over the frequency of whirl")
            for name in ("interpolation", "radial_clearance"):  # between speeds, and of what tables were computed for
                part.pop(name, None)
            if "speed" in part:
                part["frequency"] = part.pop("speed")
    return found


# ---- elements --------------------------------------------------------------------------------------------------------


def _plane_of(name: str, option: str, nodes: dict[str, int], tags: Mapping[str, Any], replaced: list[Any]) -> str:
    """The plane of a name; an element's is at its node, a new one where no plane stands there."""
    if name in nodes:
        return name
    element = tags.get(name)
    if element is None:
        known = [*nodes, *tags]
        raise ValueError(f"{option}: {unknown_name('plane or tag of an element', name, known)}")
    if not hasattr(element, "kxx"):
        raise ValueError(f"{option}: {name} is a {type(element).__name__}; bearings and seals can be replaced")
    if element.n_link is not None:
        raise ValueError(f"{option}: {name} links node {element.n} to node {element.n_link}, not to the ground")
    replaced.append(element)
    for plane, node in nodes.items():
        if node == element.n:
            return plane
    nodes[name] = int(element.n)
    return name


def _unequal(K: Float, C: Float) -> str:
    """Coefficients of a bearing that differ between x and y."""
    found = []
    for letter, m in (("k", K), ("c", C)):
        if not np.isclose(m[0, 0], m[1, 1]):
            found.append(f"{letter}xx {m[0, 0]:g}, {letter}yy {m[1, 1]:g}")
        if not np.isclose(m[0, 1], -m[1, 0]):
            found.append(f"{letter}xy {m[0, 1]:g}, {letter}yx {m[1, 0]:g}")
    return ", ".join(found)


def _check_kept(rotor: Any, nodes: Mapping[str, int], fluid: Iterable[str], speed: float | None) -> None:
    """Elements that stay must be known at all speeds, the same in x and y, and no fluid themselves."""
    at_fluid = {nodes[plane] for plane in fluid}
    for element in rotor.bearing_elements:
        name = f"{element.tag} at node {element.n}"
        coefficients = (np.atleast_1d(np.asarray(getattr(element, each), dtype=float)) for each in _COEFFICIENTS)
        if speed is None and any(np.ptp(values) > 0 for values in coefficients):
            raise ValueError(
                f"{name} has coefficients that change with speed or frequency; take it out (fluid= or supports= name "
                "it), or give the speed, rad/s, whose coefficients are to be taken at all speeds"
            )
        at = 0.0 if speed is None else speed
        K, C = np.asarray(element.K(at), dtype=float), np.asarray(element.C(at), dtype=float)
        if element.n in at_fluid and (C.any() or K[0, 1] or K[1, 0]):
            raise ValueError(
                f"{name} stands where the fluid that is fitted acts, and has damping or cross-coupling of its own; "
                f"fluid={str(element.tag)!r} takes it out"
            )
        if not all(np.isclose(m[0, 0], m[1, 1]) and np.isclose(m[0, 1], -m[1, 0]) for m in (K, C)):
            raise ValueError(
                f"{name} is not the same in x and y ({_unequal(K, C)}); a known structure is, with kxx = kyy and "
                f"kxy = -kyx. supports={str(element.tag)!r} takes it out, and "
                "rf.models.Orthotropic(model, at=...) has what is put in its place"
            )
