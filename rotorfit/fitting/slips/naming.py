"""Slips in a file that only a fit gives away.

Where the model misses the data by far, the fit is tried with each slip undone, and the one that explains the data is
named: in what is told besides the readings (``labels``), by filters that readings went through (``filters``), and by
factors and angles that some of them have (``runs``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial

import numpy as np

from rotorfit.checks.orbits import orbits_of
from rotorfit.checks.probe_filters import FilteredProbe
from rotorfit.checks.probe_pairs import uneven_planes
from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.fitting.problem_setup import build_problem
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.slips.filters import filter_slips
from rotorfit.fitting.slips.labels import label_slips
from rotorfit.fitting.slips.readings import PLAINLY, Found, Hint, Readings, Trial, readings_of
from rotorfit.fitting.slips.runs import run_slips
from rotorfit.models.array_types import ComplexArray, Float

EXPLAINS = 0.1
"""Misfit that is left, of that of the data as told, if a slip is the explanation: missing structure alone is up to a
hundred times the noise, but does not vanish by what has nothing to do with it."""

_FAR, _UNEXPLAINED = 10.0, 0.02
"""redchi from which slips are looked for, and share of the power of the responses from which all are tried; below it,
those that a linear step promises."""

_PROMISED = 0.25  # share that a linear step leaves of the misfit by a small slip, if that is the explanation
_ALIKE = 1.5  # ratio of what two slips leave within which the data cannot tell them apart
_MOST_TOLD = 3


def slip(fit: FitResult, trial: Trial) -> str:
    """The slip that explains what a fit misses, in words; empty where none does, or nothing has to be explained."""
    if fit.problem.loss != "linear" or fit.redchi < _FAR:
        return ""
    settings = fit.settings.asked
    levelled = fit.settings.levelled
    problem = build_problem(fit.model, fit.experiments, settings) if levelled else fit.problem
    still = sum(float(np.sum(np.abs(block.measured / block.sigma) ** 2)) for block in problem.blocks)
    far = fit.chisqr > _UNEXPLAINED * still
    found: list[Found] = []
    if far:
        missed = min(fit.chisqr, trial(problem)[0])  # a search that went astray by itself is no slip
        for one in label_slips(fit.model, fit.experiments, settings, trial, missed):
            found.append(one)
            if one.left < PLAINLY:
                return _told(found)
    readings = None if fit.model.eccentricity_dependent else readings_of(problem)
    if readings is not None:
        uneven = cache(partial(_uneven, fit.experiments))
        known = [name for name, value in settings.known.items() if value]
        found += _of_readings(readings, trial, fit.x if not levelled else None, far, uneven, known)
    return _told(found)


def _uneven(experiments: Sequence[Experiment]) -> dict[str, FilteredProbe | None]:
    found: dict[str, FilteredProbe | None] = {}
    for test in experiments:
        if isinstance(test, PerturbationTest):
            found |= uneven_planes(orbits_of(test, np.arange(len(test))))
    return found


def _of_readings(
    readings: Readings,
    trial: Trial,
    x: Float | None,
    far: bool,
    uneven: Callable[[], Mapping[str, FilteredProbe | None]],
    known: Sequence[str],
) -> Iterator[Found]:
    """What filters and factors of readings explain."""
    least = np.inf if x is None else 2 * readings.problem.cost(x)
    if far or x is None:
        tried, end = trial(readings.problem)
        least, x = (tried, end) if tried < least or x is None else (least, x)
    hint = _anything if far else _promised(readings, x)
    filters = list(filter_slips(readings, trial, least, hint, uneven))
    yield from filters
    if not any(one.left < PLAINLY for one in filters):
        yield from run_slips(readings, trial, least, hint, known)


def _anything(_: ComplexArray) -> bool:
    return True


def _promised(readings: Readings, x: Float) -> Hint:
    """A linear step with the slip as a value more, from where the search ended."""
    problem = readings.problem
    r, J = problem.jacobian(x)
    whitened = np.concatenate(problem.predict(x)) / np.concatenate([block.sigma for block in problem.blocks])
    span = np.linalg.qr(_real(J))[0]
    beside = _beside(span, _real(r[:, None]))[:, 0]

    def hint(log: ComplexArray) -> bool:
        columns = _beside(span, _real(readings.seen(log) * whitened[:, None]))
        step = np.linalg.lstsq(columns, beside, rcond=1e-9)[0]
        return float(np.sum((beside - columns @ step) ** 2)) < _PROMISED * float(beside @ beside)

    return hint


def _real(columns: ComplexArray) -> Float:
    return np.concatenate([columns.real, columns.imag])


def _beside(span: Float, columns: Float) -> Float:
    return np.asarray(columns - span @ (span.T @ columns))


def _told(found: Sequence[Found]) -> str:
    least = min((one.left for one in found), default=np.inf)
    if not least < EXPLAINS:
        return ""
    alike = sorted((one for one in found if one.left < _ALIKE * least), key=lambda one: one.left)
    fewest = min(one.free for one in alike)
    told = list(dict.fromkeys(one.told for one in alike if one.free == fewest))[:_MOST_TOLD]
    better = float(f"{1 / least:.2g}")
    return f"A trial fit says: {'; or '.join(told)}. So taken, the model misses the data {better:,.0f} times less."
