"""Campaigns: one model fitted to many runs under different conditions (Figs 18 to 20 of the source)."""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.atomic_file import whole_file
from rotorfit.base.digits import plus_minus, significant
from rotorfit.base.equality import ByValue
from rotorfit.base.executors import Kept
from rotorfit.base.names import unknown_name
from rotorfit.base.progress import progress_on_stderr
from rotorfit.base.text_table import Printed, Wide, text_table
from rotorfit.estimators.misfit.parameter_space import parameter_space
from rotorfit.estimators.misfit.problem import LOSSES, Loss
from rotorfit.identify.fitting.fit import fit as fit_model
from rotorfit.identify.fitting.headline import named_by
from rotorfit.identify.fitting.noise.residual_study import MODEL_LIMITED_REDCHI
from rotorfit.identify.fitting.quantities import FittedParameter
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.identify.fitting.summary import natural
from rotorfit.lab.data.findings import Finding, attributed, listed
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.io.tables.result_tables import rows_csv
from rotorfit.models import RotorModel
from rotorfit.studies.campaigns.partitions import Reader, is_lazy, lazy_runs
from rotorfit.studies.campaigns.runs import Run, RunFit, Workers, fit_run, split_runs
from rotorfit.studies.campaigns.shared import fit_shared, refuse_none
from rotorfit.studies.campaigns.trends import Trend, trend_table, trends_of

if TYPE_CHECKING:
    from pandas import DataFrame

_LOG = logging.getLogger(__name__)


_FLUID = ("K0", "lam", "lam_D", "D")  # what the source follows in a campaign, where the model has it


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Campaign(ByValue, Printed):
    """Fits of all runs of a campaign.

    Attributes:
        model: the rotor.
        runs: results by run, in the order of the data.
        shared: parameters with one value for all runs.
        shared_covar: their covariance, SI units, shape ``(s, s)``.
        settings: what the user asked for.
        success: whether every run was fitted and the shared parameters settled.
    """

    model: RotorModel
    runs: tuple[RunFit, ...]
    shared: Mapping[str, FittedParameter]
    shared_covar: Float
    settings: FitSettings
    success: bool
    _data: tuple[Run, ...] = field(repr=False)

    plot = Accessor()

    @cached_property
    def fitted(self) -> tuple[str, ...]:
        """Parameters that every run has a value of its own for."""
        return tuple(dict.fromkeys(name for run in self.runs for name in run.var_names))

    @cached_property
    def attributes(self) -> tuple[str, ...]:
        """Conditions that the runs may be followed against or grouped by."""
        return tuple(dict.fromkeys(name for run in self.runs for name in run.attributes))

    @property
    def rig(self) -> str:
        """What was tested, by the names of its files."""
        return named_by([run.source for run in self._data])

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What the fits of all runs were found to lack, with the name of the run, errors first."""
        return tuple(attributed([run.findings for run in self.runs], [run.name for run in self.runs]))

    def values(self, parameter: str) -> tuple[Float, Float]:
        """Values and standard errors of ``parameter``, by name, NaN in runs that do not give it, shape ``(R,)`` each.

        Raises:
            KeyError: no such parameter.
        """
        if parameter not in self.fitted:
            self.model.parameter(parameter)
        found = [self._parameter(run, parameter) for run in self.runs]
        pairs = [(p.value, p.stderr) if p is not None and p.resolved else (np.nan, np.nan) for p in found]
        value, stderr = np.array(pairs, dtype=float).reshape(-1, 2).T
        return value, stderr

    def unit(self, parameter: str) -> str:
        """Unit of a parameter that was fitted run by run, of the runs whose model has it.

        Args:
            parameter: its name.
        """
        return next(run.params[parameter].unit for run in self.runs if parameter in run.params)

    def _parameter(self, run: RunFit, name: str) -> FittedParameter | None:
        return run.params.get(name, self.shared.get(name) if run.params else None)

    def trends(
        self,
        parameters: str | Sequence[str] | None = None,
        *,
        against: str | Sequence[str],
        by: str | None = None,
        degree: int = 1,
    ) -> tuple[Trend, ...]:
        """Parameters against attributes of the runs, group by group, each with its weighted line or curve.

        Runs that say nothing (:attr:`RunFit.silent`) are left out.

        Args:
            parameters: what to follow, by default K0, lam and D as far as they were fitted.
            against: attribute with numbers, or several: each trend is then the one with the others held.
            by: attribute that makes groups, for instance the kind of inlet.
            degree: of the polynomial in each attribute: 1 for straight lines, 2 where K0 grows with the flow squared.

        Raises:
            KeyError: no such attribute, or a parameter that was not fitted run by run.
            ValueError: ``against`` holds text, or several attributes that always change together, or too few values for
                the degree.

        Example:
            >>> found = rf.campaign(rf.models.WhirlWhip(), rig, split="speed_rpm", known={"K3": 6000.0})
            >>> (trend,) = found.trends("D", against="speed_rpm")
            >>> trend.degree, len(trend.coefficients)
            (1, 2)
        """
        if degree < 1:
            raise ValueError(f"the degree of a trend is 1 for a straight line or more, got {degree}")
        names = self._followed(parameters)
        axes = (against,) if isinstance(against, str) else tuple(against)
        for attribute in (*axes, by):
            if attribute is not None and attribute not in self.attributes:
                raise KeyError(unknown_name("attribute of the runs", attribute, self.attributes))
        for axis in axes:
            texts = {run.name: text for run in self.runs if isinstance(text := run.attributes.get(axis), str)}
            if texts:
                odd, text = next(((n, t) for n, t in texts.items() if not _is_number(t)), next(iter(texts.items())))
                raise ValueError(
                    f"{axis} holds text ({text!r} in run {odd}): trends need numbers, text makes groups (by)"
                )
        found = []
        for name in names:
            groups: dict[str, list[RunFit]] = {}
            for run in self.runs:
                parameter = run.params.get(name)
                usable = parameter is not None and parameter.resolved and 0 < parameter.stderr < np.inf
                if (
                    usable
                    and not run.silent
                    and all(np.isfinite(float(run.attributes.get(axis, np.nan))) for axis in axes)
                ):
                    value = "" if by is None else run.attributes.get(by, "")
                    label = value if isinstance(value, str) else f"{value:.6g}"
                    groups.setdefault(label, []).append(run)
            unit = self.unit(name)
            every = [[float(run.attributes[axis]) for axis in axes] for runs in groups.values() for run in runs]
            for group in sorted(groups, key=natural):
                found += trends_of(groups[group], name, unit, axes, group, np.mean(every, axis=0), degree)
        return tuple(found)

    def _followed(self, parameters: str | Sequence[str] | None) -> tuple[str, ...]:
        if parameters is None:
            return tuple(name for name in _FLUID if name in self.fitted) or self.fitted
        names = (parameters,) if isinstance(parameters, str) else tuple(parameters)
        for name in names:
            if name not in self.fitted:
                raise KeyError(unknown_name("parameter fitted run by run", name, self.fitted))
        return names

    def fit(self, run: str) -> FitResult:
        """The full result of one ``run``, by name, fitted anew with the shared parameters at their values.

        Raises:
            KeyError: no such run.
        """
        named, s = {data.name: data for data in self._data}, self.settings
        if run not in named:
            raise KeyError(unknown_name("run of the campaign", run, named))
        known = {**s.known, **{name: parameter.value for name, parameter in self.shared.items()}}
        test = named[run].experiment
        return fit_model(
            self.model, test, known=known, bounds={**s.bounds}, priors=s.priors, loss=s.loss, causes=s.causes
        )

    # ---- presentation -------------------------------------------------------------------------------------------

    def table(self, attributes: Sequence[str] | None = None) -> str:
        """Values and standard errors of all runs as text; ``attributes`` are shown first, by default all of them."""
        shown = self.attributes if attributes is None else tuple(attributes)
        rows: list[list[str | Wide]] = [["run", *shown]]
        for name in self.fitted:
            rows[0] += [name, "+-"]
        rows[0] += ["redchi", ""]
        for run in self.runs:
            values = [run.attributes.get(name, "") for name in shown]
            rows.append([run.name, *(value[:13] if isinstance(value, str) else f"{value:.6g}" for value in values)])
            if not run.params:
                rows[-1].append(Wide(run.message, 2 * len(self.fitted) + 2, remark=True))
                continue
            for name in self.fitted:
                p = run.params.get(name)  # what the data of a run leave out of the model is not there
                said = "" if p is None else p.shown().value
                rows[-1] += [said, p.shown().error] if p is not None and p.determined else [Wide(said, 2)]
            rows[-1] += [significant(run.redchi, 3), run.remark]
        columns = ["<4", *[">14"] * len(shown), *[">12", ">10"] * len(self.fitted), ">9", "<1"]
        return "\n".join(text_table(rows, " ".join(columns)))

    def summary(
        self,
        parameters: str | Sequence[str] | None = None,
        *,
        against: str | Sequence[str] | None = None,
        by: str | None = None,
        degree: int = 1,
    ) -> str:
        """The shared parameters, how the runs went, and with ``against`` the trends of ``parameters``, in groups ``by``
        an attribute and as polynomials of a ``degree``, all as for :meth:`trends`."""
        done = [run for run in self.runs if run.params]
        redchi = [run.redchi for run in done]
        lines = [f"{self.model.name}: {len(done)} of {len(self.runs)} runs fitted"]
        if redchi:
            low, high, middle = (significant(end, 3) for end in (min(redchi), max(redchi), np.median(redchi)))
            lines[0] += f", redchi {low} to {high}, median {middle}"
        lines += [f"shared {p.name} = {plus_minus(p.value, p.stderr)} {p.unit}" for p in self.shared.values()]
        out = "; left out of trends"
        lines += [f"{run.name}: {run.remark}{out * run.silent}" for run in self.runs if run.remark]
        missed = sorted((r for r in done if r.redchi > MODEL_LIMITED_REDCHI and not r.silent), key=lambda r: -r.redchi)
        above = f"redchi is above {MODEL_LIMITED_REDCHI:g}"
        if 2 * len(missed) > len(done):
            lines.append(f"{above} in {len(missed)} of {len(done)} runs: more than noise, in most of them")
        elif missed:
            named = listed([f"{run.name} ({significant(run.redchi, 3)})" for run in missed])
            lines.append(f"{above}, more than noise: {named}; look at their units, speeds and directions")
        if against is not None:
            trends = trend_table(self.trends(parameters, against=against, by=by, degree=degree))
            lines += [*self.condition_remarks(against), "", trends]
        return "\n".join(lines)

    def condition_remarks(self, against: str | Sequence[str]) -> list[str]:
        """Runs that have no number for a condition, and runs in which it changed by more than a tenth of its range.

        ``against`` is the attribute, or the attributes, that trends are shown against.
        """
        axes = (against,) if isinstance(against, str) else tuple(against)
        sentences = []
        largest_change = 0.1  # of the range of a condition over the runs, by which it may change within one
        for axis in axes:
            means = {run.name: run.attributes.get(axis, np.nan) for run in self.runs}
            numbers = {name: float(value) for name, value in means.items() if not isinstance(value, str)}
            without = [name for name, value in numbers.items() if not np.isfinite(value)]
            if without:
                sentences.append(f"{axis} is not known in {listed(without)}; left out of its trends")
            known = [value for value in numbers.values() if np.isfinite(value)]
            spread = float(np.ptp(known)) if known else 0.0
            for data in self._data:
                span = data.readings.span(axis) if data.name in numbers else None
                if span is not None and span[1] - span[0] > largest_change * (spread or np.abs(span).max()):
                    ends = f"{significant(span[0], 4)} to {significant(span[1], 4)}"
                    sentences.append(f"{axis} changed within {data.name}, {ends}: its mean stands for the run")
        return sentences

    def __str__(self) -> str:
        return self.summary()

    def to_dataframe(self) -> DataFrame:
        """All runs as a table with the columns of :meth:`to_csv`."""
        from pandas import read_csv

        return read_csv(io.StringIO(self.to_csv()))

    def to_csv(self, path: str | Path | None = None) -> str:
        """All runs as CSV: conditions, values, standard errors (``K0_stderr``), quality; also written to ``path``."""
        names, quality = (*self.shared, *self.fitted), ("redchi", "readings", "success", "message", "silent")
        columns = [column for name in names for column in (name, f"{name}_stderr")]
        rows: list[list[Any]] = [["run", *self.attributes, *columns, *quality]]
        for run in self.runs:
            cells: list[Any] = []
            for name in names:
                p = self._parameter(run, name)
                cells += ["", ""] if p is None or not p.resolved else [repr(p.value), repr(p.stderr)]
            conditions = [run.attributes.get(name, "") for name in self.attributes]
            how = [repr(run.redchi), run.ndata // 2, run.success] if run.params else ["", 0, False]
            rows.append([run.name, *conditions, *cells, *how, run.message, run.silent])
        text = rows_csv(rows)
        if path is not None:
            with whole_file(Path(path)) as draft:
                draft.write_text(text, encoding="utf-8")
        return text


def campaign(
    model: RotorModel,
    experiments: Experiment | Sequence[Experiment] | Sequence[str | Path | Reader],
    *,
    split: str | None = "run",
    shared: Sequence[str] = (),
    known: Mapping[str, float | None] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, Any] | None = None,
    loss: Loss = "linear",
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    store: Kept | None = None,
    progress: bool | Callable[[int, int], None] | None = None,
) -> Campaign:
    """Fit every run of a campaign, all parameters run by run but those that are known or shared.

    Args:
        model: the rotor, for instance ``rf.models.OneMode()``.
        experiments: one table of many runs or several, conditions such as pressure, flow, temperature or kind of inlet
            being further columns of the data. Paths, or functions without arguments that read a table such as
            ``functools.partial(rf.read, path)``, are parts of the data that are read where their runs are fitted: no
            process holds more than one of them at a time, and a run is in one of them.
        split: attribute that tells the runs apart; ``None`` takes each experiment for one run.
        shared: parameters with one value for all runs, fitted jointly with the others.
        known, bounds, priors, loss, start: as for :func:`rotorfit.fit`.
        executor: any ``concurrent.futures`` executor, also Dask's ``client.get_executor(pure=False)``; by default the
            runs are fitted one after the other in this process. A run whose worker is lost is fitted again, and when no
            worker has answered for five minutes the rest is fitted here.
        store: a :class:`rotorfit.Store` where fits are kept as they come: a campaign that was stopped or killed takes
            up where it was when it is begun again.
        progress: whether a line of progress is printed to stderr, by default where that is a terminal; or a function
            that is called with the number of runs done and the number of all, once for each pass over the runs.

    Returns:
        the campaign; a run that could not be fitted has no parameters and a message that says why.

    Raises:
        KeyError: unknown parameters, or an experiment without the attribute of ``split``.
        ValueError: nothing to fit, no run that can be fitted, contradictory settings, or shared parameters that the
            runs do not determine.

    Example:
        >>> found = rf.campaign(rf.models.WhirlWhip(), rig, split="speed_rpm", known={"K3": 6000.0})
        >>> found.values("lam")[0].shape
        (2,)
    """
    settings = FitSettings(known=known or {}, bounds=bounds or {}, priors=priors or {}, per={}, loss=loss, causes=None)
    start = dict(start or {})
    names = (shared,) if isinstance(shared, str) else tuple(shared)
    _check(model, settings, names, start)
    runs = _runs(experiments, split, executor)
    params: Mapping[str, FittedParameter] = {}
    covar, settled = np.empty((0, 0)), True
    with progress_on_stderr(progress, "{} of {} runs".format) as tell:
        workers = Workers(model, executor, tell, store)
        if names:
            (fits, params, covar), settled = fit_shared(workers, runs, names, settings, start)
        else:
            fits = tuple(workers(fit_run, runs, [{"settings": settings, "start": start}] * len(runs)))
            refuse_none(fits)
    for run in fits:
        if not run.success:
            _LOG.info("run %s: %s", run.name, run.message)
    return Campaign(
        model=model,
        runs=fits,
        shared=params,
        shared_covar=covar,
        settings=settings,
        success=settled and all(run.success for run in fits),
        _data=runs,
    )


def _runs(
    experiments: Experiment | Sequence[Experiment] | Sequence[str | Path | Reader],
    split: str | None,
    executor: Executor | None,
) -> tuple[Run, ...]:
    """The runs of tables in hand, or of parts that are read where they are fitted."""
    items: list[Any] = [experiments] if isinstance(experiments, Experiment) or is_lazy(experiments) else [*experiments]
    lazy = [is_lazy(item) for item in items]
    if not any(lazy):
        return split_runs(items, split)
    if not all(lazy):
        raise TypeError("a campaign takes tables or parts that are read where they are fitted, not some of each")
    return lazy_runs(items, split, executor)


def _check(model: RotorModel, settings: FitSettings, shared: Sequence[str], start: Mapping[str, float]) -> None:
    """Refuse wrong settings once, before the first run: they are wrong for every run."""
    if settings.loss not in LOSSES:
        raise ValueError(unknown_name("loss", settings.loss, LOSSES))
    space = parameter_space(model, known=settings.held, bounds=settings.bounds, groups=[{}])
    for name in (*shared, *settings.priors, *start):
        model.parameter(name)
    fixed = [name for name in shared if name not in space.names]
    if fixed:
        raise ValueError(f"{', '.join(fixed)} cannot be known and shared: free a default (known=, --known NAME=free)")
    if len(shared) >= len(space.names):
        raise ValueError("every fitted parameter is shared: that is a joint fit (rf.fit, `rotorfit fit`)")
    if any(name in settings.priors for name in shared):
        raise ValueError("a prior of a shared parameter would count once for every run; bound it, or take it for known")
