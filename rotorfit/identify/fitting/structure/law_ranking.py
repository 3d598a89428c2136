"""Laws of eccentricity: which one the data ask for, if any, and one fitted to a table of coefficients alone."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Unpack

import casadi as ca
import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.faults import of_program
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table, Tabled, Wide
from rotorfit.identify.fitting.fit import fit, solve_again
from rotorfit.identify.fitting.problem_setup import as_tuple, build_problem
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitKeywords, check_keywords
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.kinds.coefficient_table import CoefficientTable
from rotorfit.models import Constant, EvenPolynomial, Law, MonotoneSpline, Muszynska, OneMode, RotorModel
from rotorfit.models.parameters import bare_name

_LOG = logging.getLogger(__name__)
DECISIVE_AIC = 10.0
"""Difference of AIC beyond which the worse of two models has no support left (Burnham & Anderson 2002)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LawFit:
    """One law in a comparison."""

    law: Law  # the law
    fit: FitResult | None  # its fit, ``None`` where there is none
    reason: str  # why it is not ranked, empty if it is
    count: int  # parameters that the data determine: directions that they do not see do not count
    aic: float  # aic, bic: with that count; infinite where not ranked
    bic: float
    weight: float = 0.0  # Akaike weight, its share of the support among those compared


@dataclass(frozen=True, eq=False, repr=False)
class LawComparison(ByValue, Tabled):
    """Ranking of laws of eccentricity on the same data; :func:`rotorfit.compare_laws` makes it.

    Attributes:
        laws: all laws, the lowest AIC first, those that failed last.
        stiffness: how much AIC would rise, to second order (Wald), if the best law's radial stiffness were held
            constant; NaN where it cannot change or the data do not determine how.
    """

    laws: tuple[LawFit, ...]
    stiffness: float

    @property
    def best(self) -> FitResult:
        """Fit with the lowest AIC."""
        return _fit_of(self.laws[0])

    @property
    def best_by_bic(self) -> FitResult:
        """Fit with the lowest BIC, which asks more of additional parameters."""
        return _fit_of(min(self.laws, key=lambda entry: entry.bic))

    def __getitem__(self, name: str) -> LawFit:
        """The best ranked law of a name, such as ``"muszynska"``.

        Raises:
            KeyError: no law of that name was compared.
        """
        for entry in self.laws:
            if entry.law.name == name:
                return entry
        raise KeyError(unknown_name("law", name, [entry.law.name for entry in self.laws]))

    @property
    def nonlinear(self) -> bool:
        """True if the data ask for coefficients that change with eccentricity."""
        linear = [entry.aic for entry in self.laws if not entry.law.parameters]
        return bool(self.laws[0].law.parameters) and all(aic - self.laws[0].aic > DECISIVE_AIC for aic in linear)

    @property
    def nonlinear_stiffness(self) -> bool:
        """True if the data ask for a radial stiffness that changes with eccentricity."""
        return self.nonlinear and self.stiffness > DECISIVE_AIC

    @property
    def verdict(self) -> str:
        """The answer in a sentence or two."""
        best, words = self.laws[0], []
        linear = min((entry.aic for entry in self.laws if not entry.law.parameters), default=np.inf)
        if not self.nonlinear:
            words.append("the data do not ask for a fluid that changes with eccentricity")
        else:
            gap = f": a linear fluid is worse by {linear - best.aic:.1f} in AIC" if np.isfinite(linear) else ""
            words.append(f"the data ask for a fluid that changes with eccentricity{gap}")
            if np.isnan(self.stiffness):
                words.append("whether its radial stiffness changes too is not determined")
            else:
                ask = "they ask for" if self.nonlinear_stiffness else "they do not ask for"
                words.append(f"{ask} a nonlinear stiffness: held constant it would change AIC by {self.stiffness:+.1f}")
        if self.best.model_limited:
            left = significant(self.best.redchi, 3)
            words.append(f"even the best law leaves redchi {left}: none of these explains the data")
        return "; ".join(words)

    def parts(self) -> list[str | Table]:
        """What is printed: the ranking as a table, and the verdict."""
        head: list[str | Wide] = ["law", "fitted", "redchi", "AIC", "dAIC", "dBIC", "weight"]
        aic, bic = self.laws[0].aic, min(entry.bic for entry in self.laws)
        rows: list[list[str | Wide]] = [head]
        for entry in self.laws:
            row: list[str | Wide] = [repr(entry.law), Wide("not ranked", 2)]
            if entry.fit is not None and not entry.reason:
                row = [repr(entry.law), str(entry.count), significant(entry.fit.redchi, 4), f"{entry.aic:.1f}"]
                row += [f"{entry.aic - aic:.1f}", f"{entry.bic - bic:.1f}", f"{entry.weight:.3f}"]
            rows.append(row)
        left_out = [f"{entry.law!r}: {entry.reason}" for entry in self.laws if entry.reason]
        return [Table(rows, "<44 >7 >10 >12 >10 >10 >9"), *left_out, self.verdict]


def _fit_of(entry: LawFit) -> FitResult:
    if entry.fit is None:
        raise ValueError(f"{entry.law!r} has no fit: {entry.reason}")
    return entry.fit


def compare_laws(
    model: RotorModel,
    experiments: Experiment | Sequence[Experiment],
    laws: Sequence[Law] | None = None,
    *,
    clearance_um: float | None = None,
    known: Mapping[str, float | None] | None = None,
    **options: Unpack[FitKeywords],
) -> LawComparison:
    """Fit the same data with several laws of eccentricity and rank them by AIC and BIC.

    Args:
        model: the rotor, with any law or none.
        experiments: one experiment or a list.
        laws: laws to compare; by default the linear fluid, the power law, even polynomials of one and two terms and
            a monotone spline over the eccentricities of the data.
        clearance_um: radial clearance; by default that of the model.
        known: values that are not fitted; parameters of a law hold for that law.
        options: further keywords of :func:`rotorfit.fit`: ``bounds``, ``priors``, ``per``, ``loss``, ``start``,
            ``phase_offsets``, ``calibration``, ``assumptions``, ``max_iterations``.

    Returns:
        the ranking; print it. A law whose fit fails is listed with the reason.

    Raises:
        ValueError: a model that takes no law, no clearance, or not one law that can be fitted.
        KeyError: known parameters that no law has.
        TypeError: a keyword that is none of these.

    Example:
        >>> values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
        >>> law = rf.models.Muszynska()
        >>> true = values | law.start(values["K0"], values["D"])
        >>> test = rf.simulate(
        ...     rf.models.OneMode(law=law, clearance_um=127.0), true, speed_rpm=1500,
        ...     frequency_rpm=[300, 600, 900, 1200, 1500, 1800, 2100, 2400], force=[2.0, 8.0],
        ... )
        >>> found = rf.compare_laws(rf.models.OneMode(), test, [rf.models.Constant(), law], clearance_um=127.0)
        >>> found.laws[0].law, found.nonlinear
        (Muszynska(), True)
    """
    check_keywords("compare_laws", options, FitKeywords, "laws", "clearance_um", "known")
    if "law" not in model.options():
        raise ValueError(f"{model.name} takes no law of eccentricity; models with a fluid do")
    several = as_tuple(experiments)
    gap = clearance_um if clearance_um is not None else model.options()["clearance_um"]
    if gap is None:
        raise ValueError("laws of eccentricity need the radial clearance: give it (clearance_um=, --clearance-um)")
    candidates = _default_laws(model.variant(law=Muszynska(), clearance_um=gap), several) if laws is None else (*laws,)
    if not candidates:
        raise ValueError("laws is empty: name at least one law")
    known = known or {}
    names = {name for law in candidates for name in model.variant(law=law, clearance_um=gap).parameter_names}
    for name in known:
        if name not in names:
            raise KeyError(unknown_name(f"parameter of {model.name} with these laws", name, sorted(names)))
    entries = [_try(model.variant(law=law, clearance_um=gap), law, several, known, options) for law in candidates]
    if len({entry.fit.ndata for entry in entries if entry.fit is not None}) > 1:
        # A linear rotor moves in circles wherever it rests and gets one number from each x/y pair, an off-centre
        # nonlinear one two; information criteria compare on the same data only: the linear fluid as a nonlinear one.
        linear = EvenPolynomial(1)
        zero = dict.fromkeys((q.name for q in linear.parameters), 0.0)
        same = _try(model.variant(law=linear, clearance_um=gap), linear, several, {**known, **zero}, options)
        entries = [replace(same, law=entry.law) if not entry.law.parameters else entry for entry in entries]
    ranked = sorted(entries, key=lambda entry: entry.aic)
    if ranked[0].reason:
        raise ValueError("no law could be fitted: " + "; ".join(f"{e.law!r}: {e.reason}" for e in ranked))
    share = np.array([np.exp(-0.5 * (entry.aic - ranked[0].aic)) for entry in ranked])
    weighed = [replace(e, weight=float(w)) for e, w in zip(ranked, share / share.sum(), strict=True)]
    found = LawComparison(tuple(weighed), _stiffness_support(weighed[0]))
    _LOG.info("laws compared:\n%s", found)
    return found


def _stiffness_support(entry: LawFit) -> float:
    """Wald statistic of a radial stiffness that does not change, less twice the parameters that this would save."""
    own = [q.name for q in entry.law.parameters]
    symbols = {name: ca.SX.sym(name) for name in (*own, "K0", "D")}
    stiffness = entry.law.at(SimpleNamespace(**symbols), ca.SX.sym("eccentricity")).K0
    names = [name for name in own if ca.depends_on(stiffness, symbols[name])]  # zero means no change
    result = _fit_of(entry)
    places = [i for i, name in enumerate(result.var_names) if bare_name(name) in names]
    resolved = all(result.params[result.var_names[i]].resolved for i in places)
    if not places or not resolved:
        return float("nan")
    change = result.x[places]
    return float(change @ np.linalg.solve(result.covar[np.ix_(places, places)], change)) - 2 * len(places)


def _try(
    model: RotorModel,
    law: Law,
    experiments: tuple[Experiment, ...],
    known: Mapping[str, float | None],
    options: FitKeywords,
) -> LawFit:
    mine = {name: value for name, value in known.items() if name in model.parameter_names}
    try:
        result = fit(model, experiments, known=mine, **options)
        if result.settings.noise is not None:  # laws are compared by one likelihood, with the noise that the data tell
            plain = replace(result.settings, noise=None)
            result = solve_again(replace(result, settings=plain), build_problem(model, experiments, plain))
    except (ValueError, np.linalg.LinAlgError) as reason:
        if of_program(reason):
            raise
        return LawFit(law=law, fit=None, reason=str(reason), count=0, aic=np.inf, bic=np.inf)
    if not result.success:
        why = f"the fit did not converge: {result.message}"
        return LawFit(law=law, fit=result, reason=why, count=result.nvarys, aic=np.inf, bic=np.inf)
    unseen = result.identifiability.null_space.shape[1] if result.identifiability.null_space.size else 0
    aic, bic = result.aic - 2 * unseen, result.bic - unseen * float(np.log(result.ndata))
    return LawFit(law=law, fit=result, reason="", count=result.nvarys - unseen, aic=aic, bic=bic)


def _default_laws(model: RotorModel, experiments: tuple[Experiment, ...]) -> tuple[Law, ...]:
    """Common laws; the spline's knots lie where the data are."""
    laws: tuple[Law, ...] = (Constant(), Muszynska(), EvenPolynomial(1), EvenPolynomial(2))
    blocks = [e.observe(model, np.zeros(len(e), dtype=np.intp)) for e in experiments]
    measured = [np.asarray(getattr(block, "eccentricity", np.zeros(0)), dtype=float) for block in blocks]
    eps = np.concatenate(measured)
    reach = float(np.nanmax(eps, initial=0.0))
    if reach <= 0:
        return laws
    # Eccentricity below which laws are not told apart: usual ones change K0 by a few parts in ten thousand there
    smallest_reach = 0.01
    if reach < smallest_reach:
        raise ValueError(
            f"the journal moves by at most {significant(100 * reach, 2)} % of the clearance of "
            f"{significant(1e6 * (model.least_clearance or 0.0), 4)} um: so small orbits tell no law from another. "
            "Check clearance_um and the units of the motion, or test with more force"
        )
    return (
        *laws,
        MonotoneSpline(knots=(round(0.5 * reach, 3), round(0.8 * reach, 3)), reach=min(1.0, round(1.02 * reach, 3))),
    )


def fit_law(law: Law, table: CoefficientTable, *, per: Sequence[str] = ("K0", "D", "Mf"), by: str = "run") -> FitResult:
    """Fit a law of eccentricity to tabulated bearing or seal coefficients.

    The exponents or factors of the law and lam are shared by all rows; the parameters in ``per`` have a value for
    each run. By default a run is one speed of one seal, since computed and measured K0 and D change with speed.

    Args:
        law: the law, for instance ``rf.models.Muszynska()``.
        table: the coefficients.
        per: parameters that take one value for each value of ``by``.
        by: attribute of the table, or ``"run"``.

    Raises:
        KeyError: unknown parameter or attribute.
        ValueError: coefficients that are not finite or of unknown accuracy.

    Example:
        >>> table = rf.datasets.seal_muszynska_tum()
        >>> law = rf.fit_law(rf.models.Muszynska(), table)
        >>> round(law.params["n_K"].value, 3)
        2.0
    """
    # The eccentricities are ratios already: any clearance serves.
    model = OneMode(law=law, clearance_um=1.0)
    rows = table.select(table.eccentricity == table.eccentricity.min())  # eq. (13) of those nearest to the centre
    ratio = rows.kxy / (rows.cxx * rows.speed)
    columns = (rows.kxx + rows.mxx * (ratio * rows.speed) ** 2, rows.cxx, rows.mxx, ratio)
    K0, D, Mf, lam = (float(np.median(column)) for column in columns)
    start = {"K0": K0, "D": D, "Mf": Mf, "lam": lam} | law.start(K0, D)
    nothing: dict[str, float | None] = {"M": 0.0, "K": 0.0, "Ds": 0.0}
    return fit(model, table, known=nothing, per=dict.fromkeys(per, by), start=start)
