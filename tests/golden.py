"""Golden numbers: fits of every model, law and kind of file, before and after a change that must not move them.

    python tests/golden.py             compare with tests/data/golden.json; exit code 1 where something moved
    python tests/golden.py --write     write the file anew, and the version of the numbers, which is its digest
    python tests/golden.py rig laws    only the cases whose names begin so

A value may move by a millionth of its standard error, a standard error and a threshold's by a millionth of themselves;
codes of findings and exit codes may not change at all. ``tests/whole/test_golden.py`` holds every case to a thousandth:
other versions of packages move values by some millionths. Cases that moved by less than this are written as they were,
so that a rewrite moves nothing else: stores and caches ask for the version of the numbers.

The file also holds the sentences: what a summary and the command line say in each case, each number a #. Tests of
findings assert codes; who improves a sentence writes the file anew and reads there what changed.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import hashlib
import io
import json
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "rigs"))

import law_data
from campaigns_of_weights import campaign as campaign_of_weights
from known_shaft import known_rig
from line_tests import ALL, TORSION, VALUES, line_test
from seal_campaigns import KNOWN as SEAL_KNOWN
from seal_campaigns import seal_campaign
from slips import exchanged, lag_as_lead, renamed, thinned, told_as_constant, turned
from synthetic import KNOWN, MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.base import version
from rotorfit.lab.data.rows import Experiment

GOLDEN = Path(__file__).parent / "data" / "golden.json"
MOVED = 1e-6
"""Of a standard error: two orders above where round-off of a different order of sums leaves the end of a search."""

Numbers = dict[str, Any]


def codes(experiments: Experiment | list[Experiment]) -> list[str]:
    """Codes of what the check of the data finds, sorted."""
    several = experiments if isinstance(experiments, list) else [experiments]
    return sorted({f"{found.severity} {found.code}" for test in several for found in rf.check(test)})


def numbers_of(fit: rf.FitResult) -> Numbers:
    """What must not move of a fit."""
    found: Numbers = {
        "values": {name: p.value for name, p in fit.params.items() if np.isfinite(p.stderr)},
        "stderr": {name: p.stderr for name, p in fit.params.items() if p.stderr and np.isfinite(p.stderr)},
        "redchi": fit.redchi,
        "unresolved": sorted(fit.identifiability.unresolved),
        "success": fit.success,
        "said": without_numbers(fit.summary()),
    }
    with contextlib.suppress(ValueError):
        threshold = fit.threshold_speed()
        if np.isfinite(threshold.stderr):
            found["values"]["threshold_speed"] = threshold.value
            found["stderr"]["threshold_speed"] = threshold.stderr
    return found


_NUMBER = re.compile(r"(?<![\w.])[-+]?(\d[\d,]*\d|\d)(\.\d+)?(e[-+]?\d+)?(?!\w)")
_CONTINUED = re.compile(r"\n +(?![ -])")
_WORD = re.compile(r"[A-Za-z]{2,}")


def without_numbers(text: str) -> list[str]:
    """Lines of four words or more, each once, each number a #; where they break depends on the numbers."""
    head, *parts = text.split("\n\n")
    whole = [" ".join(head.split("\n")), *_CONTINUED.sub(" ", "\n".join(parts)).splitlines()]
    lines = (" ".join(_NUMBER.sub("#", line).split()) for line in whole)
    return list(dict.fromkeys(line for line in lines if len(_WORD.findall(line)) >= 4))


def fitted(model: rf.models.RotorModel, experiments: Any, **settings: Any) -> Numbers:
    return numbers_of(rf.fit(model, experiments, **settings)) | {"codes": codes(experiments)}


# ---- cases ----------------------------------------------------------------------------------------------------------


def typical(name: str) -> Numbers:
    model, values = MODELS[name](), TYPICAL[name]
    theta = model.vector(values)
    w = covering_frequencies(model, theta, SPEEDS[name], 60)
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=w, noise=0.01, seed=3)
    known = known_of(name, values)
    return fitted(model, test, known=known)


def rig_refined() -> Numbers:
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    return numbers_of(rf.refine(fit).best)


def rig_closed_form() -> Numbers:
    return numbers_of(rf.closed_form(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}))


def rig_profile() -> Numbers:
    fit = rf.fit(rf.models.WhirlWhip(), thinned(rf.datasets.rig_open(), 4), known={"K3": 6000.0})
    low, high = fit.profile("lam").interval
    return {"values": {"low": low, "high": high}, "stderr": {"low": fit.params["lam"].stderr}}


def chain() -> Numbers:
    model = rf.models.Chain(planes=("disk", "coupling", "journal"), fluid="journal")
    rng = np.random.default_rng(5)
    values = {p.name: p.scale * rng.uniform(0.7, 1.4) for p in model.parameters} | {"lam": 0.46}
    theta = model.vector(values)
    w = np.concatenate([-np.linspace(400, 5, 40), np.linspace(5, 400, 40)])
    test = circular_test(model, theta, speeds=(60.0,), frequency=w, noise=0.005, seed=6)
    return fitted(model, test, known={"K4": values["K4"]})


def laws(*tests: Callable[[], Experiment], whirl_whip: bool = False) -> Numbers:
    values = law_data.WHIRL_WHIP if whirl_whip else law_data.ONE_MODE
    law = rf.models.Muszynska()
    kind = rf.models.WhirlWhip if whirl_whip else rf.models.OneMode
    model = kind(law=law, clearance_um=law_data.CLEARANCE_UM)
    known = {"K3": values["K3"]} if whirl_whip else {"K": values["K"], "Ds": values["Ds"]}
    return fitted(model, [make() for make in tests], known=known)


def weights() -> Numbers:
    test = campaign_of_weights(np.random.default_rng(3))
    return fitted(rf.models.Modal(("disk2", "disk1")), test, phase_offsets="common", known={"zeta": 0.03})


def shaft() -> Numbers:
    model = rf.models.AnisotropicShaft()
    test = line_test(model, VALUES | TORSION, ALL, np.random.default_rng(2), steady=("1x", "2x"))
    return fitted(model, test)


def runs_differ() -> Numbers:
    """Forces of every second run one percent off: a variance between runs enters the errors."""
    test = thinned(rf.datasets.rig_open(), 3)
    names = list(dict.fromkeys(test.run.tolist()))
    odd = np.isin(test.run, names[::2])
    return fitted(rf.models.WhirlWhip(), replace(test, force=np.where(odd, 1.01, 1.0) * test.force), known={"K3": 6e3})


def robust() -> Numbers:
    test = thinned(rf.datasets.rig_open(), 3)
    response = test.response.copy()
    response[::37] *= 3
    bounds = {"D": (100.0, 900.0)}
    return fitted(
        rf.models.WhirlWhip(), replace(test, response=response), known={"K3": 6e3}, loss="cauchy", bounds=bounds
    )


def per_speed() -> Numbers:
    test = thinned(rf.datasets.rig_open(), 3)
    return fitted(rf.models.WhirlWhip(), test, known={"K3": 6e3}, per={"D": "speed_rpm"}, phase_offsets=True)


def volts() -> Numbers:
    records = [rf.read_recording(file) for file in rf.datasets.volts()]
    test = rf.responses(records)
    return fitted(rf.models.WhirlWhip(), test, known={"K3": 6000.0})


def start_ups() -> Numbers:
    return fitted(rf.models.TwoDisk(), rf.datasets.two_disk(), known={"beta1": 1.0, "beta2": 1.0})


def campaign(shared: bool) -> Numbers:
    table, _ = seal_campaign(9, lines=60)
    odd = table.run == "r04"
    table = replace(table, response=np.where(odd, table.response.conj(), table.response))
    found = rf.campaign(rf.models.OneMode(), table, known=SEAL_KNOWN, shared=("Mf",) if shared else ())
    numbers: Numbers = {"values": {}, "stderr": {}}
    for run in found.runs:
        for name, p in run.params.items():
            if not np.isfinite(p.stderr):
                continue
            numbers["values"][f"{run.name} {name}"] = p.value
            if p.stderr:
                numbers["stderr"][f"{run.name} {name}"] = p.stderr
    numbers["success"] = [run.success for run in found.runs]
    return numbers


# ---- the command line -----------------------------------------------------------------------------------------------

AWKWARD: dict[str, Callable[[rf.PerturbationTest], rf.PerturbationTest]] = {
    "clean": lambda test: test,
    "lag as lead": lag_as_lead,
    "probes exchanged": exchanged,
    "turned by 45 degrees": lambda test: turned(test, 45.0),
    "constant for unbalance": told_as_constant,
    "speeds exchanged": lambda test: renamed(test, "speed"),
    "forces negative": lambda test: replace(test, force=-test.force),
    "one plane in another unit": lambda test: replace(
        test, response=np.where(test.plane == "disk", 25.4, 1.0) * test.response
    ),
    "one probe peak to peak": lambda test: replace(
        test, response=np.where((test.plane == "disk") & (test.direction == "x"), 2.0, 1.0) * test.response
    ),
    "signs of frequencies lost": lambda test: replace(test, frequency=np.abs(test.frequency)),
    "speeds in Hz": lambda test: replace(test, speed=test.speed / 60),
    "half of the sweep missing": lambda test: test.select(test.frequency > 0),
}


_OF_THE_DATA = ("ERROR in the data", "check: ", "rotorfit: ")
"""Beginnings of lines of a fit to wrong data that do not hang on the minimum where round-off lets it end."""


def command_line(name: str) -> Numbers:
    test = AWKWARD[name](thinned(rf.datasets.rig_open(), 4))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rig.csv"
        rf.write(test, file)
        words = [str(file), "--model", "whirl-whip", "--known", "K3=6000"]
        exits, lines = {}, []
        for command, more in (("fit", words), ("info", words[:1])):
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                exits[command] = main([command, *more])
            text = said.getvalue().replace(f"{folder}/", "").splitlines()
            lines += [line for line in text if command == "info" or not exits[command] or line.startswith(_OF_THE_DATA)]
    return {"exit codes": exits, "codes": codes(test), "said": without_numbers("\n".join(lines))}


def cases() -> Iterator[tuple[str, Callable[[], Numbers]]]:
    yield "rig", lambda: fitted(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    yield "rig refined", rig_refined
    yield "rig closed form", rig_closed_form
    yield "rig profile", rig_profile
    yield "rig known structure", lambda: fitted(known_rig(), rf.datasets.rig_open())
    yield "rig runs differ", runs_differ
    yield "rig robust loss, bounds", robust
    yield "rig per speed, phase offsets", per_speed
    for name in KNOWN:
        yield f"typical {name}", lambda name=name: typical(name)
    yield "chain", chain
    yield "start-ups", start_ups
    yield "weights", weights
    yield "shaft lines", shaft
    yield "volts", volts
    v = law_data.ONE_MODE
    yield "laws sweeps", lambda: laws(lambda: law_data.sweep(v, levels=(2.0, 12.0), lines=30))
    yield (
        "laws sweeps and statics",
        lambda: laws(lambda: law_data.sweep(v, levels=(2.0, 12.0), lines=30), lambda: law_data.static(v)),
    )
    yield (
        "laws all kinds",
        lambda: laws(
            lambda: law_data.sweep(v, levels=(8.0,), lines=30),
            lambda: law_data.static(v),
            lambda: law_data.impulse(v),
            lambda: law_data.squeeze(v),
            lambda: law_data.off_centre(v),
        ),
    )
    yield "laws ring-downs", lambda: laws(lambda: law_data.ring_down(v), lambda: law_data.static(v))
    yield (
        "laws two modes",
        lambda: laws(lambda: law_data.sweep(law_data.WHIRL_WHIP, levels=(3.0, 10.0)), whirl_whip=True),
    )
    yield "campaign", lambda: campaign(shared=False)
    yield "campaign shared", lambda: campaign(shared=True)
    for name in AWKWARD:
        yield f"command line {name}", lambda name=name: command_line(name)


# ---- comparing ------------------------------------------------------------------------------------------------------


def plain(value: Any) -> Any:
    """Numbers as JSON has them."""
    if isinstance(value, dict):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value.item() if isinstance(value, np.generic) else value


def differences(now: Numbers, then: Numbers, largest: float = MOVED) -> Iterator[str]:
    """What moved by more than a share of its standard error, in sentences."""
    for name in ("codes", "exit codes", "unresolved", "success"):
        if now.get(name) != then.get(name):
            yield f"{name}: {then.get(name)} before, {now.get(name)} now"
    yield from list(difflib.unified_diff(then.get("said", []), now.get("said", []), "before", "now", n=0, lineterm=""))[
        2:
    ]
    errors = then.get("stderr", {})
    for name, value in then.get("values", {}).items():
        scale = errors.get(name) or errors.get("low") or abs(value) or 1.0
        moved = abs(now.get("values", {}).get(name, np.inf) - value) / scale
        if not moved < largest:
            yield f"{name} moved by {moved:.3g} standard errors: {value!r} before"
    for name, value in errors.items():
        moved = abs(now.get("stderr", {}).get(name, np.inf) / value - 1)
        if not moved < largest:
            yield f"standard error of {name} moved by {moved:.3g} of itself: {value!r} before"


def digest(stored: Numbers) -> str:
    """The version of the numbers: all that the file holds but sentences."""
    numbers = {name: {key: part for key, part in case.items() if key != "said"} for name, case in stored.items()}
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:8]


def rewritten(now: Numbers, then: Numbers) -> Numbers:
    """A case as it is written: sentences as they are now, numbers as they were unless one moved, came or went."""
    names = [[sorted(case.get(part, {})) for part in ("values", "stderr")] for case in (now, then)]
    moved = names[0] != names[1] or any(differences({**now, "said": then.get("said", [])}, then))
    return {**(now if moved else then), **({"said": now["said"]} if "said" in now else {})}


def main_of_golden() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="beginnings of names; all cases without")
    parser.add_argument("--write", action="store_true", help="write the file anew")
    options = parser.parse_args()
    stored = json.loads(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.exists() else {}
    failed = 0
    for name, make in cases():
        if options.cases and not name.startswith(tuple(options.cases)):
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = json.loads(json.dumps(plain(make())))
        moved = [] if options.write else list(differences(found, stored.get(name, {})))
        if not options.write and name not in stored:
            moved = ["no golden numbers"]
        stored[name] = rewritten(found, stored.get(name, {})) if options.write else stored.get(name)
        failed += bool(moved)
        print(f"{'MOVED' if moved else 'same '} {name}", *(f"      {line}" for line in moved), sep="\n", flush=True)
    if options.write:
        stored = {name: stored[name] for name, _ in cases() if name in stored}
        GOLDEN.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        source = Path(version.__file__)
        text = source.read_text(encoding="utf-8").replace(version.RESULTS, digest(stored))
        source.write_text(text, encoding="utf-8")
    elif digest(stored) != version.RESULTS:
        print("MOVED the version of the numbers: it is not the digest of the file, write both anew")
        failed += 1
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main_of_golden())
