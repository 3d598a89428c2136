"""All that is found of a fit and its data: what they show themselves, and what only a fit gives away.

Where the model misses the data by far, the fit is tried with each error undone, and those that explain the data are
named: errors of what is given besides the readings (``data_errors``), filters that readings went through, and factors
and angles that some of them have (``trial_fits``).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.faults import of_program
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.parameter_space import DATUM
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.identify.diagnosis.check import check
from rotorfit.identify.diagnosis.data_errors import (
    DataError,
    backward_angles,
    data_errors,
    filtered_probes,
    mirrored_orbits,
)
from rotorfit.identify.diagnosis.free_rotor import beside_free_rotor
from rotorfit.identify.diagnosis.orbits import Orbits, orbits_of_tests
from rotorfit.identify.diagnosis.probe_filters import CHANNEL_FILTERS, POWERS, ChannelFilter, values_to_try
from rotorfit.identify.diagnosis.probe_pairs import UNEVEN, uneven_planes
from rotorfit.identify.diagnosis.trial_fits import (
    ALL,
    EXPLAINED_MISFIT_SHARE,
    EXPLAINING_MISFIT_SHARE,
    MOST_PLANES,
    PROMISING_MISFIT_SHARE,
    Explanation,
    Hint,
    Readings,
    factors_of_groups,
    readings_of,
    trial,
)
from rotorfit.identify.fitting.fit import fitted, solve
from rotorfit.identify.fitting.notices import notices_of
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.experiments import PerturbationTest, perturbations
from rotorfit.lab.data.findings import (
    BAD_LINES,
    INTERNAL_PROBLEM,
    LOCAL_MINIMUM,
    Finding,
    attributed,
    errors_first,
    errors_in,
)
from rotorfit.lab.data.probes import at_common_zero
from rotorfit.models.parameters import bare_name


def findings_of(fit: FitResult) -> tuple[Finding, ...]:
    """Findings about a fit and its data, errors first, and of these first the ones that explain its misfit. A diagnosis
    that fails says so and leaves the rest: the fit stands without it."""
    own, found = notices_of(fit), []
    try:
        found = _shown(fit)
        found = [
            *beside_free_rotor(fit),
            *other_rig(fit),
            *explained(_as_asked(fit), {finding.code for finding in found}),
            *found,
        ]
    except Exception as problem:
        text = (
            f"Internal problem of rotorfit, not of these data: a check of the fit failed ({type(problem).__name__}: "
            f"{problem}). The fit stands; errors of the data that only trial fits show were not looked for. Please "
            "report it."
        )
        found.append(Finding("warning", INTERNAL_PROBLEM, text, origin="fit"))
    return tuple(errors_first([*own, *found]))


def _shown(fit: FitResult) -> list[Finding]:
    """What the data show themselves."""
    datum = fit.params[DATUM].value if DATUM in fit.params else 0.0
    experiments = at_common_zero(fit.experiments, datum) if datum else fit.experiments
    sources = [test.source or test.title for test in experiments]
    shown = attributed([check(test) for test in experiments], sources)
    if fit.model.frame == "z" and fit.success and len(fit.thetas) == 1:
        # Anisotropy is a warning where an isotropic fit does not bear it, and nothing where it does.
        shown = [replace(one, severity="warning") if one.code == UNEVEN else one for one in shown]
    return shown


def _as_asked(fit: FitResult) -> FitResult:
    """The fit without blocks that were chosen for its model, which may follow an error of the data."""
    if fit.model_uncertainty is None or any(block.force_spectra for block in fit.problem.blocks):
        return fit
    model, asked = fit.model.variant(blocks=()), fit.settings.asked
    own = {name: prior for name, prior in asked.priors.items() if bare_name(name) in model.parameter_names}
    known = {name: value for name, value in asked.known.items() if name in model.parameter_names}
    return fitted(model, fit.experiments, replace(asked, known=known, priors=own, start={}))


def other_rig(fit: FitResult) -> Iterator[Finding]:
    """The dry run or stator mass of a fit, where more moves in it than in the test with fluid, although a fluid adds
    mass; or where less does, the model has no mass of the fluid to make up for it, and misses the data."""
    baseline = fit.settings.baseline
    # Share of the dry rig's mass that a fluid's negative direct inertia may take at most, or that may be missing
    largest_loss = 0.1
    for block in fit.problem.responses:
        if block.beside is None:
            continue
        dry, _ = _mass(np.abs(block.s), block.beside)
        whole = stiffness_matrices(block)
        added, error = _mass(np.abs(whole.frequency), np.asarray(whole.kappa - block.beside[whole.first_line]))
        least = max(largest_loss * abs(dry), SIGNIFICANT_ERRORS * error)
        if baseline is None:
            given, undo = f"stator_mass_kg is {significant(dry, 3)}", "the mass of this stator in kg"
            question = "Is it that of this stator, in kg?"
        else:
            given, undo = (
                f"{significant(dry, 3)} kg in the dry run {baseline.source}".rstrip(),
                "the dry run of this rig",
            )
            question = "Is the dry run of another rig, or of this one with other parts on its stator?"
        seen = f"In the test with fluid {significant(dry + added, 3)} +- {significant(error, 1)} kg move; {given}"
        if added < -least:
            yield Finding("error", "other-rig", f"{seen}. A fluid adds mass. {question}", remedy=undo)
            continue
        _, group, speed = block.condition
        inertia = [fit.model.coefficients(fit.thetas[g], float(v))[2].real for g, v in zip(group, speed, strict=True)]
        missing = added - float(np.mean([np.diag(one).mean() for one in inertia]))  # the mass of the fitted model, kg
        if missing > least and fit.redchi > fit.largest_redchi:
            text = (
                f"{seen}, and the model lacks {significant(missing, 3)} kg. {question} If it is right, leave "
                "the fluid's mass free."
            )
            yield Finding("error", "missing-mass", text, remedy=undo)


def _mass(w: Float, kappa: ComplexArray) -> tuple[float, float]:
    """Moving mass by ``Re kappa = K - w^2 M``, mean of the directions, and its standard error."""
    along = np.mean(np.diagonal(kappa, axis1=1, axis2=2).real, axis=1)
    design = np.column_stack([np.ones(w.size), -(w**2)])
    found, left, rank, _ = np.linalg.lstsq(design, along, rcond=None)
    if rank < design.shape[1] or w.size <= design.shape[1]:
        return 0.0, float("inf")
    spread = float(left[0]) / (w.size - design.shape[1])
    return float(found[1]), float(np.sqrt(spread * np.linalg.inv(design.T @ design)[1, 1]))


# ---- trial fits ------------------------------------------------------------------------------------------------------


_LEAST_REDCHI, _UNEXPLAINED_SHARE = 10.0, 0.02
"""redchi from which errors are looked for, and share of the power of the responses from which all are tried; below it,
those that a linear step promises."""

_LINEAR_MISFIT_SHARE = 0.25
"""Share that a linear step leaves of the misfit by a small error, if that is the explanation."""


def explained(fit: FitResult, shown: Collection[str] = ()) -> list[Finding]:
    """The errors of the data that explain what a fit misses, beside ``shown``, those that the data show themselves."""
    if fit.problem.loss != "linear":
        return []
    tests = perturbations(fit.experiments)
    orbits = orbits_of_tests(tests)
    # Corrections that make orbits turn with the force and nothing else look wrong, by the share of motion left: a fit
    # does not see motion against the force.
    turning = []
    for error in mirrored_orbits(orbits) if "wrong-direction" in shown else ():
        problem = _corrected(fit, error)
        # Without the error data show no other one, as negative damping.
        if problem is not None and not errors_in(one for test in tests for one in check(error.correct(test))):
            turning.append(error.explains(trial(problem)[0] / _power(problem)))
    if found := _findings(turning):
        return found
    if not fit.redchi >= _LEAST_REDCHI or any(one.code == BAD_LINES for one in fit.notices):
        return []
    changed = fit.settings.rescaled or fit.settings.solved is not None  # by noise and causes found at a wrong optimum
    asked = build_problem(fit.model, fit.experiments, fit.settings.asked) if changed else fit.problem
    tried = [one for one in _explanations(fit, asked, tests, orbits) if np.isfinite(one.left)]
    if np.min([one.left for one in tried], initial=np.inf) >= EXPLAINING_MISFIT_SHARE:
        return []
    astray = _elsewhere(fit, asked, tried)
    return [astray] if astray is not None else _findings(tried)


def _elsewhere(fit: FitResult, problem: Problem, tried: Sequence[Explanation]) -> Finding | None:
    """That the search had gone astray, not the data: where the data as they are, fitted from where trial fits ended,
    leave as little."""
    size, names = problem.space.size, fit.model.parameter_names
    best: tuple[float, Float] = (np.inf, np.zeros(0))
    for one in sorted(tried, key=lambda one: one.left)[:3]:
        if one.end is None or one.left >= EXPLAINING_MISFIT_SHARE:
            continue
        begin = np.concatenate([one.end, np.zeros(size)])[:size]
        begin[len(problem.space.names) :] = 0.0
        end = solve(problem, np.clip(begin, problem.space.lower, problem.space.upper), Options()).x
        left = 2 * problem.cost(end)
        if left < best[0]:
            best = left, end
    if not best[0] < EXPLAINING_MISFIT_SHARE * fit.chisqr:
        return None
    values = zip(problem.space.names, problem.space.base, best[1].tolist(), strict=False)
    start = ", ".join(f"{name}={value:.4g}" for name, base, value in values if base in names)
    redchi = significant(best[0] / max(fit.nfree, 1), 3)
    text = (
        f"The search ended in a local minimum (redchi {significant(fit.redchi, 3)}): from other start values the same "
        f"data and model have redchi {redchi}. Fit again from these (start=, --start {start}), and look at the units "
        "of forces, readings and known values if they surprise."
    )
    return Finding("warning", LOCAL_MINIMUM, text, remedy=f"start from {start}", origin="fit")


def _explanations(
    fit: FitResult, problem: Problem, tests: Sequence[PerturbationTest], orbits: Sequence[Orbits]
) -> Iterator[Explanation]:
    settings, rescaled = fit.settings.asked, fit.settings.rescaled
    far = fit.chisqr > _UNEXPLAINED_SHARE * _power(problem)
    uneven = uneven_planes(orbits)
    candidates = [*filtered_probes(uneven), *backward_angles(tests), *(data_errors(tests) if far else ())]
    missed = min(fit.chisqr, trial(problem)[0]) if candidates else fit.chisqr  # a search that went astray is no error
    for error in candidates:
        corrected = _corrected(fit, error)
        if corrected is None:
            continue
        left, end = trial(corrected)
        left = left / missed
        if left < error.leaves_at_most:
            yield error.explains(left, end)
            if left < EXPLAINED_MISFIT_SHARE:
                return
    readings = None if fit.model.eccentricity_dependent else readings_of(problem)
    if readings is not None:
        known = [name for name, value in settings.known.items() if value]
        solved = fit.settings.solved
        x = fit.x if solved is None else solved.plain[: fit.x.size]
        yield from _of_readings(readings, None if rescaled else x, far, uneven, known)


def _power(problem: Problem) -> float:
    return float(np.sum(np.abs(problem.measured / problem.sigma) ** 2))


def _corrected(fit: FitResult, error: DataError) -> Problem | None:
    """The problem with an error undone, None where it cannot be."""
    settings = fit.settings.asked
    if error.frees_datum and settings.phase_offsets:
        return None
    tests = [test.corrected(error.correct) for test in fit.experiments]
    try:
        changed = replace(settings, phase_offsets="common") if error.frees_datum else settings
        return build_problem(fit.model, tests, changed)
    except (ValueError, np.linalg.LinAlgError) as problem:  # what cannot be fitted explains nothing
        if of_program(problem):
            raise
        return None


def _of_readings(
    readings: Readings, x: Float | None, far: bool, uneven: Collection[str], known: Sequence[str]
) -> Iterator[Explanation]:
    """Explanations by filters and factors of readings."""
    least = np.inf if x is None else 2 * readings.problem.cost(x)
    if far or x is None:
        tried, end = trial(readings.problem)
        least, x = (tried, end) if tried < least or x is None else (least, x)
    if not np.isfinite(least):
        return
    hint = (lambda log: True) if far else _promised(readings, x)
    found = list(filters(readings, least, hint, uneven))
    yield from found
    if not any(one.left < EXPLAINED_MISFIT_SHARE for one in found):
        yield from factors_of_groups(readings, least, hint, known)


def _promised(readings: Readings, x: Float) -> Hint:
    """A linear step with the error as a value more, from where the search ended."""
    problem = readings.problem
    r, J = problem.jacobian(x)
    whitened = np.concatenate(problem.predict(x)) / problem.sigma
    span = np.linalg.qr(np.concatenate([J.real, J.imag]))[0]

    def beside_fit(columns: ComplexArray) -> Float:
        real = np.concatenate([columns.real, columns.imag])
        return np.asarray(real - span @ (span.T @ real))

    beside = beside_fit(r[:, None])[:, 0]

    def hint(log: ComplexArray) -> bool:
        columns = beside_fit(readings.seen(log) * whitened[:, None])
        step = np.linalg.lstsq(columns, beside, rcond=1e-9)[0]
        return float(np.sum((beside - columns @ step) ** 2)) < _LINEAR_MISFIT_SHARE * float(beside @ beside)

    return hint


def _findings(tried: Sequence[Explanation]) -> list[Finding]:
    """Those that leave least, of those that the data cannot tell apart the ones with the fewest values searched for."""
    least = min((one.left for one in tried), default=np.inf)
    if not least < EXPLAINING_MISFIT_SHARE:
        return []
    same_misfit_ratio = 1.5  # ratio of what two errors leave within which the data cannot tell them apart
    equal = sorted((one for one in tried if one.left < same_misfit_ratio * least), key=lambda one: one.left)
    fewest = min(one.free for one in equal)
    named = list({one.message: one for one in equal if one.free == fewest}.values())[:3]
    better = float(f"{1 / least:.2g}")
    others = f" This is one of {len(named)} explanations that the data cannot separate." if len(named) > 1 else ""
    found = []
    for one in named:
        text = (
            f"A trial fit shows that {one.message}. With this corrected, the misfit is {better:,.0f} times "
            f"smaller.{others} To correct it, {one.undo}."
        )
        found.append(Finding("error", one.code, text, remedy=one.undo, correction=one.correction))
    return found


def filters(readings: Readings, missed: float, hint: Hint, uneven: Collection[str]) -> Iterator[Explanation]:
    """Explanations of the data by filters of all probes and of those at one plane, unless its probes differ."""
    planes = np.unique(readings.plane).tolist()
    groups = [(ALL, np.ones(readings.plane.size, dtype=bool))]
    some = [plane for plane in planes[:MOST_PLANES] if plane not in uneven] if len(planes) > 1 else []
    groups += [(f"at {plane}", readings.plane == plane) for plane in some]
    whole = readings.s / readings.middle
    for who, rows in groups:
        least = np.inf
        if hint(np.where(rows, np.log(whole), 0.0)[:, None]):
            for power, (code, what, undo) in POWERS.items():
                left, end = trial(readings.corrected(np.where(rows, whole**power, 1.0)))
                least = min(left / missed, least)
                message, column = f"{_readings_said(who)} are {what}", _COLUMNS.get(power, "")
                named = (
                    f'give them as such (columns = {{amplitude_um = "{column}"}}, --column amplitude_um={column}), or '
                )
                name = f"{code} ({who}: 1 at 0 degrees)"
                of_unit = f"(--undo '{name}' where numbers are in the given unit {_PER[power]})"
                way = f"{named if who == ALL and column else ''}{undo} {of_unit}"
                yield Explanation(left=left / missed, code=code, message=message, undo=way, end=end)
        for kind in CHANNEL_FILTERS if least > EXPLAINED_MISFIT_SHARE else ():
            if hint(np.where(rows, kind.slope(readings.s), 0.0)[:, None]):
                yield from _searched(readings, kind, who, rows, missed)


def _searched(readings: Readings, kind: ChannelFilter, who: str, rows: Bool, missed: float) -> Iterator[Explanation]:
    def factor(value: float) -> ComplexArray:
        return np.where(rows, kind.seen(readings.s, value), 1.0)

    count = 9  # values across the band; neighbours differ by less than filters can be distinguished by
    tried = values_to_try(kind, readings.frequency, count)
    rough = [trial(readings.corrected(factor(value)), search=False)[0] for value in tried.tolist()]
    best = int(np.argmin(rough))
    if not 0 < best < tried.size - 1 or rough[best] > PROMISING_MISFIT_SHARE * missed:
        return  # at an end it is no corner but a power of the frequency, or nothing
    from scipy.optimize import minimize_scalar  # late: loading it takes longer than a fit

    found = minimize_scalar(
        lambda log: trial(readings.corrected(factor(float(np.exp(log)))))[0],
        bounds=np.log(tried[[best - 1, best + 1]]),
        method="bounded",
        options={"maxiter": 10},
    )
    value = float(np.exp(found.x))
    what, undo = kind.words(value)
    yield Explanation(
        left=float(found.fun) / missed,
        code=kind.code,
        message=f"{_readings_said(who)} are {what}",
        undo=undo,
        correction=f"{kind.code} ({who}: {kind.shown(value)})",
        free=1,
    )


_PER = {1: "per s", 2: "per s^2", -1: "times s"}
"""What readings are that differ from displacements by a power of jw, in the unit that they were given in."""
_COLUMNS = {1: "velocity_mm_s", 2: "acceleration_g"}
"""Columns of a table whose readings are such powers of s = jw times a displacement."""


def _readings_said(who: str) -> str:
    return "all readings" if who == ALL else f"the readings {who}"
