"""Results in files: ``fit.json`` reads back into the same result, to the last bit and without pickle.

The file holds the model, the data, what was asked for and all that was found. The optimisation problem is laid out
anew from these, and compared with what the file says of it.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.atomic_file import note_input, whole_file
from rotorfit.base.faults import of_program
from rotorfit.base.file_reading import beginning, reading, shown
from rotorfit.base.version import VERSIONS
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.json_values import UserDefinedError, check_types, decode, encode
from rotorfit.identify.fitting.noise.record import is_run_effect
from rotorfit.identify.fitting.problem_setup import build_problem, with_noise_of_data
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import RotorModel

SCHEMA = 1
"""Version of the file's layout; raised when older readers would misread it."""

_LOG = logging.getLogger("rotorfit")
_FORMAT = "rotorfit fit"
_KIND = "fit saved by rotorfit"


def fit_to_json(fit: FitResult) -> str:
    """A result as JSON text; see :func:`save_fit`."""
    _check(fit, build_problem(fit.model, fit.experiments, fit.settings), "the result")
    names = [f.name for f in fields(fit) if f.name not in ("model", "problem")]
    own = fit.model
    model = {"name": own.name, "planes": list(own.planes), "parameters": list(own.parameter_names)}
    try:
        model["own"] = encode(own)
    except UserDefinedError:  # the reader will have to give it
        model["class"] = type(own).__name__
    content = {
        "format": _FORMAT,
        "schema": SCHEMA,
        "rotorfit": VERSIONS,
        "model": model,
        **{name: encode(getattr(fit, name)) for name in names},
        # Its settings hold what the study found already.
        "noise": encode(None if fit.noise is None else replace(fit.noise, found=None)),
    }
    return json.dumps(content, allow_nan=False, ensure_ascii=False)


def save_fit(fit: FitResult, path: str | os.PathLike[str]) -> None:
    """Write a result, its data included, to a JSON file that :func:`load_fit` reads.

    A model of your own is written by its name; :func:`load_fit` then needs it as ``model=``.

    Args:
        fit: the result.
        path: file to write; it is replaced only when the text is complete.

    Raises:
        ValueError: priors that are not of scipy.stats, or a problem that was changed by hand after the fit.
        OSError: the file cannot be written.

    Example:
        >>> fit.save(folder / "fit.json")
    """
    text = fit_to_json(fit)
    with whole_file(Path(path)) as draft:
        draft.write_text(text, encoding="utf-8")


def load_fit(path: str | os.PathLike[str], *, model: RotorModel | None = None) -> FitResult:
    """Read a result that :func:`save_fit` wrote: it can be printed, plotted, sampled and fitted again. The log says
    where another version made it.

    Args:
        path: the file.
        model: the model, needed if it is one of your own.

    Raises:
        ValueError: not such a file, written by a newer version, damaged, or without the model that it needs.
        OSError: the file cannot be read.

    Example:
        >>> fit.save(folder / "fit.json")
        >>> rf.load_fit(folder / "fit.json").redchi == fit.redchi
        True
    """
    note_input(Path(path))
    with reading(str(path), _KIND):
        if not beginning(Path(path), 64).lstrip().startswith(b"{"):
            raise ValueError(f"{path} is not JSON, so not a fit saved by rotorfit: it does not begin with a brace")
        text = Path(path).read_text(encoding="utf-8")
    fit, written_by = _read(text, model, str(path))
    if written_by != VERSIONS:
        _LOG.warning(
            f"rotorfit: {path} was fitted by rotorfit {written_by}, this is {VERSIONS}: fitted again, its numbers may "
            "differ"
        )
    return fit


def fit_from_json(text: str, *, model: RotorModel | None = None, source: str = "the text") -> FitResult:
    """The result that :func:`fit_to_json` wrote."""
    return _read(text, model, source)[0]


def _read(text: str, model: RotorModel | None, source: str) -> tuple[FitResult, str]:
    """The result, and the version of rotorfit that wrote it."""
    if model is not None:
        model.symbolic  # noqa: B018 - an equation of the user's own fails here, by its own words, and no file is blamed
    with reading(source, _KIND, decoded=True):
        try:
            own, entries, written_by = _decoded(text, model, source)
        except ValueError as reason:
            raise ValueError(str(reason) if source in str(reason) else f"{source}: {reason}") from reason
    with reading(source, _KIND):
        try:
            problem = build_problem(own, entries["experiments"], entries["settings"])
            fit = FitResult(model=own, problem=problem, **entries)
            _check(fit, problem, f"written by rotorfit {written_by}")
        except ValueError as reason:
            if of_program(reason):
                raise
            raise ValueError(f"{source}: {reason}") from reason
    return fit, written_by


def _decoded(text: str, model: RotorModel | None, source: str) -> tuple[RotorModel, dict[str, Any], str]:
    """The model, the entries of the result, and what wrote them."""
    try:
        content = json.loads(text)
    except json.JSONDecodeError as reason:
        raise ValueError(f"{source} is not JSON, so not a fit saved by rotorfit: {reason}") from reason
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ValueError(f"{source} is not a fit saved by rotorfit: it does not say 'format': {_FORMAT!r}")
    if content.get("schema") != SCHEMA:
        raise ValueError(
            f"{source} has schema {content.get('schema')!r}, written by rotorfit {content.get('rotorfit', '?')}; "
            f"this version reads schema {SCHEMA}"
        )
    saved = [f for f in fields(FitResult) if f.name not in ("model", "problem")]
    needed = [f.name for f in saved if f.default is MISSING]
    missing = [name for name in ("model", *needed) if name not in content]
    if missing:
        raise ValueError(f"{source} is incomplete: it has no {', '.join(missing)}")
    own = _read_model(content["model"], model)
    entries = {f.name: decode(content[f.name]) for f in saved if f.name in content}
    check_types(FitResult, entries)
    if entries.get("noise") is not None:
        entries["noise"] = replace(entries["noise"], found=entries["settings"].noise)
    return own, entries, shown(str(content["rotorfit"])[:80])


def _read_model(entry: Mapping[str, Any], given: RotorModel | None) -> RotorModel:
    if given is None:
        if "own" not in entry:
            raise ValueError(
                f"it was fitted with the model {entry['name']!r} of your own (class {entry['class']}), which a file "
                f"cannot hold; give it: load_fit(path, model={entry['class']}(...))"
            )
        made: RotorModel = decode(entry["own"])
        return made
    shape = {"name": given.name, "planes": list(given.planes), "parameters": list(given.parameter_names)}
    for what, mine in shape.items():
        if mine != entry[what]:
            raise ValueError(f"the model given has the {what} {mine}, but the fit was made with {entry[what]}")
    return given


def _check_causes(fit: FitResult, what: str) -> None:
    """Numbers of the causes are of as many causes as there are, and shares of errors have their freedom."""
    if fit.noise is not None and len(fit.noise.shares) != len(fit.noise.freedom):
        raise ValueError(f"{what} has {len(fit.noise.shares)} shares of its errors with the freedom of others")
    if fit.settings.solved is not None:
        errors, count = fit.settings.solved.errors, len(fit.settings.solved.causes)
        of_each = (errors.size, errors.one_sided, errors.free)
        if {one.shape for one in of_each} != {(count,)} or errors.covar.shape != (count, count):
            raise ValueError(f"{what} has {count} causes with the errors of others")
        if errors.moves.shape != (fit.x.size, count):
            raise ValueError(f"{what} has causes that do not move its {fit.x.size} fitted values")


def _check(fit: FitResult, problem: Problem, what: str) -> None:
    """The problem laid out anew must be the one that was solved."""
    names = (*problem.space.names, *problem.space.nuisance)
    fitted = tuple(name for name, p in fit.params.items() if p.vary)
    if fit.x.shape != (len(names),) or set(fitted) != {name for name in names if not is_run_effect(name)}:
        raise ValueError(f"{what} has fitted {', '.join(fitted)}, but its settings make {', '.join(names)}")
    if not np.isfinite(fit.x).all():
        raise ValueError(f"{what} has fitted values that are no finite numbers")
    _check_causes(fit, what)
    given, before = with_noise_of_data(problem, fit.settings, fit.x)
    chisqr = float(np.sum(np.abs(given.residuals(before)) ** 2))
    agreement = 1e-6  # of chi-squared: other processors and libraries round differently, other noise does not agree
    if not np.isclose(chisqr, fit.chisqr, rtol=agreement, atol=1e-12 * problem.n_data):
        raise ValueError(
            f"{what} has chi-squared {fit.chisqr:.7g}, but its model, data and settings give {chisqr:.7g}: the problem "
            "was changed after the fit, or this version estimates the noise differently; fit the data again"
        )
