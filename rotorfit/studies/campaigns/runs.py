"""The runs of a campaign: distinguished in the data, fitted one by one, here or by the workers of an executor; fits of
thousands in little memory, and as a store keeps them meanwhile, exact and without pickle."""

from __future__ import annotations

import hashlib
import json
import pickle
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.executors import Kept, carry_out
from rotorfit.base.faults import of_program
from rotorfit.base.file_reading import decompressed, reading
from rotorfit.base.names import unknown_name
from rotorfit.base.version import RESULTS
from rotorfit.estimators.blocks.row_keys import rows_by, words
from rotorfit.estimators.inference.covariance import spread_along, standard_error
from rotorfit.identify.fitting.fit import fit
from rotorfit.identify.fitting.json_values import decode, encode
from rotorfit.identify.fitting.noise.record import FoundNoise
from rotorfit.identify.fitting.problem_setup import as_tuple
from rotorfit.identify.fitting.quantities import FittedParameter, Quantity, Source
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.content import content_hash
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import RotorModel

if TYPE_CHECKING:
    from rotorfit.studies.campaigns.partitions import ReadingsOfPart


T = TypeVar("T")

Work = Callable[..., T]
"""A function of a module, ``work(model, run, **option)``, so that it can be sent to another process."""

RUNS_OF_A_BATCH = 8
"""Runs sent to a worker at once: some hundredths of a second of work, well above what sending costs."""


@dataclass(frozen=True, eq=False)
class HeldReadings:
    """Readings in hand; those in a file are :class:`~rotorfit.studies.campaigns.partitions.ReadingsOfPart`."""

    experiment: Experiment
    part: bytes = b""

    @property
    def content(self) -> str:
        """Hash of the readings."""
        return content_hash([self.experiment])

    def span(self, condition: str) -> tuple[float, float] | None:
        """Least and largest value of a condition that is a number and changes within the run."""
        values = np.asarray(self.experiment.attribute(condition))
        values = values[np.isfinite(values)] if values.dtype.kind in "fiu" else np.zeros(0)
        return (float(values.min()), float(values.max())) if values.size and np.ptp(values) else None


@dataclass(frozen=True, eq=False, slots=True)
class Run:
    """One run of a campaign: its readings and what is known of its conditions."""

    name: str  # by which the campaign lists it
    readings: HeldReadings | ReadingsOfPart  # in hand, or in a file
    attributes: Mapping[str, float | str]  # conditions of the run: the mean of numbers, the text of texts
    source: str = ""  # file of the readings

    @property
    def experiment(self) -> Experiment:
        """Its readings."""
        return self.readings.experiment


@dataclass(frozen=True, eq=False, kw_only=True, slots=True, weakref_slot=True)
class RunFit:
    """Result of the fit of one run; small, so that it travels well."""

    name: str  # name of the run
    attributes: Mapping[str, float | str]  # conditions of the run: the mean of numbers, the text of texts
    # parameters by name, empty where the fit was not possible
    params: Mapping[str, FittedParameter] = field(default_factory=dict)
    var_names: tuple[str, ...] = ()  # fitted parameters in the order of ``covar``
    covar: Float = field(default_factory=lambda: np.empty((0, 0)))  # covariance, SI units, shape ``(p, p)``
    chisqr: float = float(
        "nan"
    )  # chisqr, redchi, ndata, nfev: as in :class:`~rotorfit.identify.fitting.result.FitResult`
    redchi: float = float("nan")
    ndata: int = 0
    nfev: int = 0
    success: bool = False  # whether the fit converged
    message: str = ""  # how it ended, or why there is none
    findings: tuple[Finding, ...] = ()  # what there is to say about it
    # whether no motion at all would explain the readings as well as the fit does: a dead probe or force
    silent: bool = False
    # what the fit found of the noise and took the readings with, where that is not the noise of the data
    noise: FoundNoise | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if any(p.fit is None for p in self.params.values()):  # how they vary together is known here alone
            object.__setattr__(self, "params", HeldParameters(self.params, self))

    def quantity(self, value: float, slopes: Mapping[str, float], unit: str) -> Quantity:
        """A quantity made of parameters of the run, with its statistical error."""
        slope = np.array([slopes.get(name, 0.0) for name in self.var_names])
        error = float(standard_error(slope, self.covar))
        return Quantity(value=value, stderr=error, unit=unit, source=self, slopes=dict(slopes))

    def error_of(self, slopes: Mapping[str, float]) -> None:
        """Runs of a campaign are fitted without causes."""

    def error_parts(self, slopes: Mapping[str, float]) -> Float:
        """See :meth:`rotorfit.FitResult.error_parts`."""
        slope = np.array([slopes.get(name, 0.0) for name in self.var_names])
        return spread_along(slope, self.covar)

    @property
    def remark(self) -> str:
        """Objections to the run, empty where it is good."""
        if self.silent:
            return "says nothing: a model of no motion explains its readings as well as the fit"
        return "" if self.success else self.message


Batch = Sequence[tuple[Run, Mapping[str, Any]]]


# ---- telling runs apart -----------------------------------------------------------------------------------------


def split_runs(experiments: Experiment | Sequence[Experiment], split: str | None) -> tuple[Run, ...]:
    """Runs of a campaign, in the order of the data."""
    return tuple(distinct(runs_of(experiments, split)))


def runs_of(experiments: Experiment | Sequence[Experiment], split: str | None) -> list[Run]:
    """The runs, some of which may have one name."""
    runs: list[Run] = []
    for number, experiment in enumerate(as_tuple(experiments)):
        labels = None if split is None else experiment.attribute(split)
        parts = [(experiment.source or f"run {number + 1}", experiment)]
        if labels is not None:
            names, places = words(labels)
            parts = [(str(n), experiment.select(rows)) for n, rows in zip(names, rows_by(places), strict=True)]
        runs += [Run(name, HeldReadings(part), conditions(part), str(part.source)) for name, part in parts]
    return runs


def conditions(experiment: Experiment) -> dict[str, float | str]:
    """The speed and the other attributes of an experiment: the mean of numbers, the text of texts."""
    names = [name for name in ("speed_rpm", *experiment.attributes) if name != "run"]
    found: dict[str, float | str] = {}
    for name in dict.fromkeys(names):
        values = experiment.attribute(name)
        if np.issubdtype(values.dtype, np.number):
            finite = values[np.isfinite(values)]
            # One value throughout stays as it was given, to the last digit.
            same = not finite.size or np.ptp(finite) == 0
            found[name] = float(np.append(finite, np.nan)[0] if same else np.mean(finite))
        else:
            found[name] = " / ".join(dict.fromkeys(str(value) for value in words(values)[0]))
    return found


def distinct(runs: Sequence[Run]) -> Iterator[Run]:
    """Runs of the same name in several files are distinguished by the file, else by a number."""
    names, files = Counter(run.name for run in runs), Counter((run.name, run.source) for run in runs)
    before: Counter[str] = Counter()
    for run in runs:
        before[run.name] += 1
        if names[run.name] > 1:
            of_file = run.source and files[run.name, run.source] == 1
            yield replace(run, name=f"{run.name} ({run.source})" if of_file else f"{run.name} #{before[run.name]}")
        else:
            yield run


# ---- one run ----------------------------------------------------------------------------------------------------


def fit_run(model: RotorModel, run: Run, *, settings: FitSettings, start: Mapping[str, float]) -> RunFit:
    """The fit of one run; of data that cannot be fitted, a result that says why."""
    try:
        given = {name: getattr(settings, name) for name in ("known", "bounds", "priors", "loss", "causes")}
        found = fit(model, run.experiment, start=start, **given)
    except (ValueError, KeyError, np.linalg.LinAlgError) as problem:
        if of_program(problem):
            raise
        reason = problem.args[0] if isinstance(problem, KeyError) and problem.args else problem
        return RunFit(name=run.name, attributes=run.attributes, message=f"not fitted: {reason}")
    # What differs between the sweeps of a run is in the covariance, and in no parameter.
    own = [i for i, name in enumerate(found.var_names) if name in found.params]
    data = found.problem
    still = float(np.sum(np.abs(data.measured / data.sigma) ** 2))  # chi-squared of no motion
    misses = (np.concatenate(data.predict(found.x)) - data.measured) / data.sigma
    missed = float(np.sum(np.abs(misses) ** 2))
    # Fall of chi-squared a parameter that fitting noise does not reach: noise alone lowers it by one on average, a
    # search for the best of many resonances by some times that, a rotor by as many times as there are readings.
    fall_by_chance = 10.0
    # Readings whose errors are not normal, such as spectra, have no likelihood of no motion.
    normal = all(block.normal for block in data.blocks)
    return RunFit(
        name=run.name,
        attributes=run.attributes,
        # A whole result holds its readings, which a process that holds no part of the data does not.
        params={name: replace(p) for name, p in found.params.items()} if run.readings.part else dict(found.params),
        var_names=tuple(found.var_names[i] for i in own),
        covar=found.covar[np.ix_(own, own)],
        chisqr=found.chisqr,
        redchi=found.redchi,
        ndata=found.ndata,
        nfev=found.nfev,
        success=found.success,
        message=found.message,
        findings=found.notices,
        silent=normal and still - missed < fall_by_chance * max(1.0, found.redchi) * max(found.nvarys, 1),
        noise=found.settings.noise,
    )


def _fit_alone(model: RotorModel, run: Run, **option: Any) -> RunFit:
    """The fit of one run without the whole result, which holds the readings."""
    found = fit_run(model, run, **option)
    return replace(found, params={name: replace(p) for name, p in found.params.items()})


# ---- many runs --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Workers:
    """Does the same work on many runs, in this process or over an executor."""

    model: RotorModel  # the rotor; a worker compiles it once
    executor: Executor | None = None  # any ``concurrent.futures`` executor, ``None`` for this process
    progress: Callable[[int, int], None] | None = None  # called with the number of runs done and the number of all
    kept: Kept | None = None  # where fits are kept as they come, and found again

    def _keys(self, runs: Sequence[Run], options: Sequence[Mapping[str, Any]]) -> list[str]:
        """Name of the fit of each run in what is kept: a digest of what makes it."""
        model = encode(self.model)
        found: list[str] = []
        told, how = None, ""
        for run, option in zip(runs, options, strict=True):
            if option is not told:  # one for all runs, or for many that follow one another
                told, how = option, json.dumps([RESULTS, model, encode(dict(option))], sort_keys=True)
            found.append(hashlib.sha256(f"{how}{run.readings.content}".encode()).hexdigest())
        return found

    def __call__(self, work: Work[T], runs: Sequence[Run], options: Sequence[Mapping[str, Any]]) -> list[T]:
        """``work(model, run, **option)`` for every run, in their order; fits that are kept are not made again. A batch
        whose worker was lost is not repeated for ever: see :func:`~rotorfit.base.executors.carry_out`."""
        pairs = list(zip(runs, options, strict=True))
        kept = self.kept if work is fit_run else None
        keys: list[str] = []
        found: dict[str, Any] = {}
        if kept is not None:
            work = _fit_alone  # type: ignore[assignment]
            keys = self._keys(runs, options)
            some = 1000  # fits looked for at a time, so that few are in memory as they are stored
            for begin in range(0, len(keys), some):
                found |= {key: _from_bytes(data) for key, data in kept.find(keys[begin : begin + some]).items()}
        left = [number for number in range(len(pairs)) if not keys or keys[number] not in found]
        # So many runs of one part of the data go together, more where it is to be read first.
        items = []
        size = 1 if self.executor is None and not keys else RUNS_OF_A_BATCH
        for part, group in groupby(left, key=lambda number: runs[number].readings.part):
            own, most = list(group), 8 * size if part else size
            items += [(own[i : i + most], [pairs[n] for n in own[i : i + most]]) for i in range(0, len(own), most)]
        count = len(pairs) - len(left)

        def done(item: tuple[Sequence[int], Batch], results: Sequence[Any]) -> None:
            nonlocal count
            count += len(results)
            if kept is not None:
                kept.keep({keys[n]: _to_bytes(one) for n, one in zip(item[0], results, strict=True)})
            if self.progress is not None:
                self.progress(count, len(pairs))

        remedy = "define its class in a module of its own, or leave executor out"
        refusal = f"{self.model.name} cannot be sent to other workers ({{problem}}): {remedy}"
        model = self.model if self.executor is None else packed(self.model, refusal)
        made = carry_out(partial(_work_batch, model, work), items, self.executor, done)
        results = dict(zip(left, (result for batch in made for result in batch), strict=True))
        return [results[n] if n in results else found[keys[n]] for n in range(len(pairs))]


def packed(thing: Any, refusal: str) -> bytes:
    """What other workers are sent, refused with a remedy where it cannot be."""
    try:
        return pickle.dumps(thing)
    except (pickle.PicklingError, AttributeError, TypeError) as problem:
        raise ValueError(refusal.format(problem=problem)) from problem


@lru_cache(maxsize=4)
def _unpacked(model: bytes) -> RotorModel:
    """The model of a campaign; a worker keeps it, and with it its compiled functions, from batch to batch."""
    found: RotorModel = pickle.loads(model)
    return found


def _work_batch(model: RotorModel | bytes, work: Work[T], item: tuple[Sequence[int], Batch]) -> list[T]:
    """Results of a batch, here or on a worker, to which the model goes packed."""
    rotor = _unpacked(model) if isinstance(model, bytes) else model
    return [work(rotor, run, **option) for run, option in item[1]]


# ---- fits that are held ----------------------------------------------------------------------------------------------


_NUMBERS = ("value", "stderr", "init_value", "plain", "freedom")
_COMMON = ("name", "unit", "meaning", "min", "max", "vary", "resolved", "at_bound")


class HeldParameters(Mapping[str, FittedParameter]):
    """Parameters of one result, each made when it is asked for."""

    __slots__ = ("_common", "_fit", "_numbers")

    def __init__(self, params: Mapping[str, FittedParameter], fit: Source) -> None:
        common = tuple(tuple(getattr(p, name) for name in _COMMON) for p in params.values())
        numbers = np.array([[getattr(p, name) for name in _NUMBERS] for p in params.values()])
        self.__setstate__((common, numbers, fit))

    def __getstate__(self) -> tuple[Any, ...]:
        return tuple(self._common.values()), self._numbers, self._fit

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        common, self._numbers, self._fit = state
        self._common = _by_name(common)

    def __getitem__(self, name: str) -> FittedParameter:
        if name not in self._common:
            raise KeyError(unknown_name("parameter", name, self._common))
        common = self._common[name]
        numbers = self._numbers[list(self._common).index(name)].tolist()
        given = dict(zip((*_COMMON, *_NUMBERS), (*common, *numbers), strict=True))
        found = FittedParameter(**given)
        object.__setattr__(found, "fit", self._fit)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._common)

    def __len__(self) -> int:
        return len(self._common)

    def __repr__(self) -> str:
        return repr(dict(self))


def _to_bytes(fit: RunFit) -> bytes:
    """A fit as compressed JSON."""
    entries = encode({entry.name: getattr(fit, entry.name) for entry in fields(fit)})
    return zlib.compress(json.dumps(entries, allow_nan=False).encode("utf-8"))


def _from_bytes(data: bytes) -> RunFit:
    name = "a fit that the store keeps"
    with reading(name, "fit of a run", decoded=True):
        return RunFit(**decode(json.loads(decompressed(name, data, len(data)))))


@lru_cache(maxsize=256)
def _by_name(common: tuple[tuple[Any, ...], ...]) -> dict[str, tuple[Any, ...]]:
    """The shared entries of each parameter; the same object for all results that agree in them."""
    return {entries[0]: entries for entries in common}
