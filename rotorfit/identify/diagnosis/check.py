"""Look a test over before fitting: errors of sign, direction, scale and plan that the data themselves give away; and
read it with a warning of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial, wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, Unpack, overload

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.identify.diagnosis.forces import exchanged_axes, force_along_axis, turning_force
from rotorfit.identify.diagnosis.imposed import imposed_orbits
from rotorfit.identify.diagnosis.orbits import orbits_of
from rotorfit.identify.diagnosis.plan import plan
from rotorfit.identify.diagnosis.probe_pairs import reciprocity, uneven_probes
from rotorfit.identify.diagnosis.readings import amplitudes, clipped, copied_readings, unread
from rotorfit.identify.diagnosis.signs import half_turns, signs, wrong_direction
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import PHASE_DATUM, Finding, errors_first, listed, rows_of, warn_of, without_phases
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.weights import dwells
from rotorfit.lab.io import files
from rotorfit.lab.kinds.displacement_test import DisplacementTest

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

P = ParamSpec("P")
Kind = TypeVar("Kind", bound=Experiment)


def check(test: Experiment) -> list[Finding]:
    """Findings about a test, errors first, with those of its reading or of its recordings.

    Recognised are readings that are not finite, doubled, zero or cut off, forces of zero, implausible amplitudes,
    frequencies in another unit than speeds, readings at 1x, gaps in the plan of the test (planes without force, one
    direction only, one frequency only), conjugated FRFs, responses in the wrong direction, forces along an axis given
    as circular and the reverse, axes of forces exchanged or inverted, readings inverted from some frequency on, a
    reversed sense of rotation, gains, delays and filters of one probe of a pair, planes that answer each other
    unequally, start-ups without partner, positions against their load, records without a mode, free vibration in
    another unit than the speed, run-ups too fast to settle, several machines in one test. Notes give the scatter
    between mountings of weights and the number of modes that weights at dwell speeds show. What only a fit gives away
    is in :attr:`FitResult.findings`.

    Args:
        test: what was measured, SI units.

    Example:
        >>> [finding.code for finding in rf.check(rig) if finding.severity == "error"]
        []
    """
    measured: list[NDArray[Any]] = [getattr(test, name) for name in test._columns() if name not in _MAY_BE_NAN]
    numeric = [np.isfinite(values) for values in measured if values.dtype.kind in "fc"]
    whole = np.logical_and.reduce(numeric) if numeric else np.ones(len(test), dtype=bool)
    findings = [*test.findings, *_numbers(test, whole)]
    machines = words(np.asarray(test.attributes.get("machine", np.zeros(0))))[0]
    if len(machines) > 1:
        text = (
            f"The readings are of {len(machines)} machines, {listed(sorted(map(str, machines)))}: a fit takes them for "
            f"one. Fit each by itself (`--where machine={machines[0]}`), or give parameters a value for each "
            "(`--per K0=machine`)."
        )
        findings.append(Finding("warning", "several-machines", text))
    finite = np.flatnonzero(whole)
    if finite.size:
        rest = test if finite.size == len(test) else test.select(finite)
        findings += [found.at_rows(finite) for found in _of_its_kind(rest)]
    if any(found.code == PHASE_DATUM for found in test.findings):
        findings = list(without_phases(findings))
    named = (replace(found, correction=found.code) if _can_do_without(test, found) else found for found in findings)
    return errors_first(named)


def _can_do_without(test: Experiment, found: Finding) -> bool:
    return found.severity == "error" and found.code in _LEFT_OUT and 0 < len(found.rows) < len(test)


def mended(test: Experiment, findings: Sequence[Finding]) -> Experiment:
    """A test without the errors of findings that have one name to undo them by."""
    if any(found.code in _LEFT_OUT for found in findings):
        keep = np.ones(len(test), dtype=bool)
        keep[[row for found in findings for row in found.rows]] = False
        return test.select(keep)
    for found in findings:
        rows = np.isin(np.arange(len(test)), found.rows)
        test = test.corrected(partial(_MENDED[str(found.correction)], rows=rows, found=found))
    return test


_LEFT_OUT = frozenset(
    {"not-finite", "no-force", "no-orbit", "no-load", "zero", "clipped", "dead-probe", "turned-lines"}
)
"""Codes of errors of some readings, which are left out to undo them."""


def _of_unknown_noise(test: PerturbationTest, rows: Bool, found: Finding) -> PerturbationTest:
    return replace(test, sigma=np.where(rows, np.nan, test.sigma))


def _forces_along(test: PerturbationTest, rows: Bool, found: Finding) -> PerturbationTest:
    """Forces that turn or not as the remedy says, ``force_direction x``."""
    axis = str(found.remedy).rpartition(" ")[2]
    return replace(test, force_direction=np.where(rows, axis, test.force_direction))


def _of_lag(test: PerturbationTest, rows: Bool, found: Finding) -> PerturbationTest:
    """Phases of lag in the runs that show it; the finding counts readings at the force alone."""
    own = np.isin(test.run, test.run[rows])
    turned = test.with_forces(lambda force: np.where(own, force.conj(), force))
    return replace(turned, response=np.where(own, test.response.conj(), test.response))


def _turned_half(test: PerturbationTest, rows: Bool, found: Finding) -> PerturbationTest:
    own = np.isin(test.run, test.run[rows])
    return test.with_forces(lambda force: np.where(own, -force, force))


def _mirrored(test: PerturbationTest, rows: Bool, found: Finding) -> PerturbationTest:
    """The other sense of rotation: y counted the other way, and with it the sense in which forces turn."""
    y, z = (np.char.endswith(test.direction, axis) for axis in "yz")
    response = np.where(y, -test.response, np.where(z, test.response.conj(), test.response))
    return replace(test, frequency=-test.frequency, response=response)


_MENDED: Mapping[str, Callable[..., PerturbationTest]] = {
    "sigma": _of_unknown_noise,
    "linear-force": _forces_along,
    "turning-force": _forces_along,
    "conjugated": _of_lag,
    "half-turn": _turned_half,
    "reversed-rotation": _mirrored,
}
"""How errors are undone that tests show themselves, by the names that their findings give."""
SHOWN_BY_TESTS = _LEFT_OUT | {*_MENDED}
"""Names by which a finding of a test alone says how it is undone."""


def _of_its_kind(test: Experiment) -> Iterator[Finding]:
    yield from test.own_findings()
    if test.swept:
        yield from copied_readings(test)
        yield from amplitudes(test)
        yield from plan(test)
    if (responses := test.perturbation) is not None:
        yield from _physics(responses)
    elif isinstance(test, DisplacementTest):
        yield from imposed_orbits(test)


def _physics(test: PerturbationTest) -> Iterator[Finding]:
    yield from unread(test)
    yield from clipped(test)
    yield from turning_force(test)
    yield from exchanged_axes(test)
    forced = np.flatnonzero((test.force != 0) & ~test.several)
    if not forced.size:
        return  # a reference run alone, or several forces at once, of which none has an orbit of its own
    orbits = orbits_of(test if forced.size == len(test) else test.select(forced), forced)
    if not orbits.frequency.size:
        return
    yield from half_turns(orbits)
    wrong = list(force_along_axis(orbits)) or list(wrong_direction(orbits))
    yield from wrong
    if wrong:
        return  # the component in the direction of the force is only a residue
    uneven = list(uneven_probes(orbits))
    yield from uneven
    if not any(finding.severity == "warning" for finding in uneven):
        yield from reciprocity(orbits)
    yield from signs(orbits)


_MAY_BE_NAN = ("sigma", "eccentricity", "position")
"""Columns in which NaN stands for what was not measured, or was given in another column."""


_REFERENCE = (
    "This is a reference run: no reading has a force. Alone it says nothing of the rotor; put it together with the "
    "runs that have a trial weight (rf.join_runs, `rotorfit join REFERENCE TRIAL --out BOTH.csv`)."
)


def _numbers(test: Experiment, finite: Bool) -> Iterator[Finding]:
    if not len(test):
        yield Finding("error", "empty", "The test has no readings.")
        return
    if not finite.all():
        text = f"Not finite: {(~finite).sum()} readings; remove them, test.select(...) with the rows to keep."
        yield Finding("error", "not-finite", text, rows_of(~finite), remedy="remove these rows")
    sigma = getattr(test, "sigma", np.array([1.0]))
    if (sigma <= 0).any():
        text = f"The noise sigma is not positive in {(sigma <= 0).sum()} rows; NaN stands for unknown noise."
        yield Finding("error", "sigma", text, rows_of(sigma <= 0), remedy="leave it out", correction="sigma")
    still = test.unforced
    if not still.any():
        return
    if still.all() and test.synchronous:
        yield Finding("warning", "reference-run", _REFERENCE)
    # Runs without a weight are what others at the same few speeds are compared with: weights are solved together.
    elif not (test.synchronous and dwells(test)):
        text = f"The force is zero in {still.sum()} rows; remove them, they have no dynamic stiffness."
        yield Finding("error", "no-force", text, rows_of(still), remedy="remove these rows")


def checking(reader: Callable[P, Experiment]) -> Callable[P, Experiment]:
    """A reader that warns of errors in what it reads."""

    @wraps(reader)
    def read(*args: P.args, **options: P.kwargs) -> Experiment:
        test = reader(*args, **options)
        warn_of(found for found in check(test) if found.severity == "error" and found not in test.findings)
        return test

    return read


if TYPE_CHECKING:  # what is read without a kind depends on the file

    @overload
    def read(path: str | Path | DataFrame, *, kind: type[Kind], **options: Unpack[files.ReadKeywords]) -> Kind: ...
    @overload
    def read(path: str | Path | DataFrame, **options: Unpack[files.ReadKeywords]) -> Any: ...
    def read(path: str | Path | DataFrame, **options: Any) -> Any:
        """See :func:`rotorfit.lab.io.files.read`."""

else:
    read = checking(files.read)
    read.__module__ = __name__  # under which other processes find it
