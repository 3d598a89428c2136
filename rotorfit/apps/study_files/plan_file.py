"""Plans of tests as TOML files: every key checked, relative paths relative to the file.

::

    model = "whirl-whip"
    known = {K3 = 6000.0}
    quantity = ["lam", "threshold_speed"]
    noise_um = 0.5                      # or by plane, {disk = 0.3, journal = 0.5}
    wanted = 0.01                       # relative standard error
    tests = ["last_year.csv"]           # patterns: made in any case, their readings do not count
    out = "planned"

    [values]                            # or fit = "results/fit.json", whose model is taken where none is named
    Md = 0.95
    K1 = [12e3, 16e3]                   # a range
    D = {norm = [450.0, 50.0]}          # a distribution of scipy.stats

    [design]
    speed_rpm = [600, 1000, 1400, 1800, 2200, 2500]
    speed_count = 3
    frequency_rpm = {from = 100, to = 3000, count = 40}
    force_N = 5.0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from rotorfit.apps.study_files.data_files import DataFile, no_progress, read_files
from rotorfit.apps.study_files.study import Study, build_model
from rotorfit.apps.study_files.study_file import known_keys, read_keys, refuse_unknown
from rotorfit.base.atomic_file import joined
from rotorfit.identify.options.kinds import Parser, count, number, numbers, one_or_more, prior, table, text, uncertainty
from rotorfit.identify.options.table import FIT, LAW, MODEL
from rotorfit.studies.planning.design import Design
from rotorfit.studies.planning.plan import plan
from rotorfit.studies.planning.record import Plan


def read_plan(path: str | Path) -> dict[str, Any]:
    """Settings of a plan from a TOML file: arguments of ``rf.plan``, and ``study``, model with its options and files of
    patterns, ``fit``, a saved fit that values come from, and ``out``, the folder for the results."""
    return read_keys(path, _settings)


def run_plan(given: Mapping[str, Any]) -> Plan:
    """Make the plan."""
    from rotorfit.identify.fitting.fit_file import load_fit

    settings = dict(given)
    study, fit, _ = (settings.pop(name) for name in ("study", "fit", "out"))
    made, _ = read_files(study.files, no_progress)
    if fit is not None:
        settings["values"] = load_fit(fit)
    model = build_model(study, made) if study.model else settings["values"].model
    designs = [settings.pop("design")] if "design" in settings else []
    return plan(model, tests=[*made, *designs], **settings)


def _settings(content: Mapping[str, Any], base: Path) -> dict[str, Any]:
    content = known_keys(content, _KEYS)
    if "model" not in content and ("fit" not in content or set(content) & set(_MODEL)):
        raise ValueError("the key 'model' is missing; it may be left out, with its options, where fit = names a fit")
    found = {key: _KEYS[key](key, value) for key, value in content.items()}
    if ("values" in found) == ("fit" in found):
        raise ValueError("give the values of the rotor: a table [values], or fit = the path of a saved fit.json")
    if not ({"tests", "design"} & set(found)):
        raise ValueError("nothing to plan: give a table [design], or tests = a list of files as patterns")
    found |= {name: str(joined(base, found[name])) for name in ("structure", "out", "fit") if name in found}
    model = {name: found.pop(name) for name in ("model", *_MODEL) if name in found}
    files = tuple(DataFile(joined(base, name)) for name in found.pop("tests", ()))
    return {"out": None, "fit": None, **found, "study": Study(files=files, **{"model": "", **model})}


# ---- values of keys -----------------------------------------------------------------------------


def _value(key: str, value: Any) -> Any:
    """A number, a range ``[low, high]`` or a distribution."""
    if isinstance(value, dict):
        return prior(key, value)
    if isinstance(value, list):
        return tuple(number(key, one) for one in value)
    return number(key, value)


_texts, _list = one_or_more(text), one_or_more(number)
_DESIGN: dict[str, Parser] = {
    "speed_rpm": numbers,
    "frequency_rpm": numbers,
    "directions": _texts,
    "force_planes": _texts,
    "probes": _texts,
    "levels": _list,
    "speed_count": count,
    "force_N": number,
    "mr_g_mm": number,
    "clearance_share": number,
    "clearance_um": number,
    "average_s": number,
    "sweep_rpm_per_s": number,
    "change_s": number,
}
"""Keys of the table ``[design]``: the attributes of :class:`~rotorfit.studies.planning.design.Design`."""


def _design(key: str, value: Any) -> Design:
    if not isinstance(value, dict):
        raise ValueError(f"{key} must be a table, got {value!r}")
    refuse_unknown(value, _DESIGN, f"key of [{key}]")
    for field in fields(Design)[:2]:
        if field.name not in value:
            raise ValueError(f"[{key}] needs {field.name}")
    return Design(**{name: _DESIGN[name](f"{key}.{name}", item) for name, item in value.items()})


_MODEL = (*MODEL, *LAW, "modes", "gains", "apart", "residuals")
_KEYS: dict[str, Parser] = {
    "model": text,
    **{name: FIT[name].kind.toml for name in (*_MODEL, "known", "priors", "per", "phase_offsets")},
    "values": table(_value),
    "fit": text,
    "tests": _texts,
    "design": _design,
    "quantity": _texts,
    "wanted": number,
    "noise_um": uncertainty,
    "noise_share": number,
    "common_share": number,
    "memory": lambda key, value: _list(key, value) if isinstance(value, list) else number(key, value),
    "runs": table(number),
    "even": number,
    "draws": count,
    "seed": FIT["seed"].kind.toml,
    "out": text,
}
"""Keys of the file and what their values must be."""
