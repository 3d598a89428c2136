"""Assumptions behind each number: terms left out of the model, tested by the data or not, and how they move results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.estimators.blocks.nonlinear import OrbitResponses, responses_of
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.small_motion import OffCentreResponses
from rotorfit.estimators.inference.covariance import prior_curvature
from rotorfit.estimators.inference.score_tests import (
    Clearance,
    Gain,
    Offset,
    Rest,
    Scores,
    Term,
    is_linear,
    score_tests,
    whitened_columns,
)
from rotorfit.estimators.inference.smooth_causes import (
    MEANINGS,
    Cause,
    Kind,
    Part,
    beyond,
    cause_change,
    changed_values,
    changes_with_speed,
)
from rotorfit.estimators.misfit.problem import robust_weights
from rotorfit.identify.fitting.assumptions.assumption_table import THRESHOLD_COLUMN, Assumption, Assumptions
from rotorfit.identify.fitting.assumptions.onset import onset_with
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.observing.circular import Places
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.linear_force import directional
from rotorfit.models import Threshold
from rotorfit.models.laws import Muszynska
from rotorfit.models.motion.neglected_terms import LeftOut, fluid_coordinates, onset_shift, terms_left_out
from rotorfit.models.structure import block_parameters

_RESULTS = ("K0", "D", "lam", "lam_D", "lam_M", "Mf", "n_K", "n_D", "b")
_PLAUSIBLE = {
    "term": 0.01,  # of what is there already, that nobody thought of
    "gyroscopic": 0.06,  # of the inertia: a full disk at a third of the span has that, its radius a fifth of the span
    "offset": 0.02,  # of the way to the next plane, by which a probe or a force is off
    "clearance": 0.02,  # of the clearance, which heat and wear change
    "rest": 0.05,  # eccentricity at which a journal rests that is taken as centred
    "gain": 0.015,  # of a channel and of an unbalance, which calibration leaves: chains of probes hold 1 to 2 per cent
    "damper": 0.03,  # of the fluid's damping, by which a support or the surroundings damp the journal too
}
"""Sizes that what a model leaves out may well have, which the user may replace. Chosen."""
_ACTING = (Kind.SPEED, Kind.BEND, Kind.HYSTERESIS, Kind.ELSEWHERE)
"""Causes that are of the rotor."""
_WITH_SPEED = {"K0": 0.3, "D": 0.1, "lam": 0.05}
"""Share by which values of the fluid may well change when the speed doubles: K0 of seals grows by a power of about 0.3,
lam and D change with swirl and temperature. Chosen."""


def assumptions_of(fit: FitResult, priors: Mapping[str, float] | None = None) -> Assumptions:
    """Score tests of terms left out of the model and of values taken as known; see :meth:`FitResult.assumptions`."""
    if len(fit.thetas) > 1:
        raise ValueError(
            "assumptions are tested where all tests share their parameters; these were fitted per attribute"
        )
    linear = [base for block in fit.problem.blocks if is_linear(block) and (base := responses_of(block)) is not None]
    terms = [*_left_out(fit, linear), *_offsets(fit, linear), *_known(fit), *_gains(fit), *_rest(fit), *_causes(fit)]
    # An isotropic fit bears what pairs of probes show of the supports where it moves nothing by half its error.
    pair = Kind.PAIR.value
    largest_shift = 0.5  # shift over the standard error up to which intervals of 95 % hold the truth in 92 % and more
    entries = [e for e in _entries(fit, terms) if not e.name.startswith(pair) or e.weight >= largest_shift]

    def order(entry: Assumption) -> tuple[bool, float]:
        heavier = abs(entry.z) if entry.missing else entry.weight
        return not entry.missing, -float(f"{heavier:.6g}")  # round-off does not order those that are equal

    found = Assumptions(tuple(sorted(entries, key=order)))
    return found.with_priors(priors) if priors else found


def assuming(fit: FitResult, given: Mapping[str, float], *, also_fitted: bool = False) -> FitResult:
    """The result with standard uncertainties of assumptions, which enter its intervals as a systematic share."""
    table = assumptions_of(fit)
    if also_fitted:
        there = {entry.name for entry in table.entries}
        given = {name: size for name, size in given.items() if name in there}
    table.with_priors(given)
    return replace(fit, settings=replace(fit.settings, assumptions=dict(given)))


def _entries(fit: FitResult, described: Sequence[_Described]) -> list[Assumption]:
    """Entries of the table for some terms; of found causes with the size that the study of residuals gave them. Effects
    of runs, which the fit may have since, take up a part of a cause. Other terms have the size that residuals ask for
    beside those causes: what explains the same is no second reason to doubt the results, but for gyroscopic effects,
    which rotors have as large as it takes in the place of the cause."""
    if not described:
        return []
    problem, terms = fit.problem, [term for term, *_ in described]
    residuals, jacobian = problem.jacobian(fit.x)
    columns = whitened_columns(problem, fit.x, terms)
    root = np.sqrt(robust_weights(problem.loss, np.abs(residuals) ** 2)[1])[:, None]
    residuals, jacobian, columns = residuals * root[:, 0], jacobian * root, columns * root
    prior = prior_curvature(problem, fit.x)
    scores = beside = score_tests(residuals, jacobian, columns, prior)
    found = np.array([isinstance(term, Cause) and bool(term.sizes) for term in terms])
    rivals: dict[int, tuple[int, float, float]] = {}
    # Times its plausible size up to which a gyroscopic effect may be in the place of a cause that was found: that of a
    # full disk at a third of the span has the share 0.3 where its radius is 0.44 of the span. Chosen.
    largest_rival = 5.0
    if found.any():
        largest = [largest_rival * size if name.startswith("g[") else 0.0 for _, name, *_, size in described]
        beside, rivals = _beside(residuals, jacobian, columns, prior, found, np.array(largest))
    onset = fit.onset(0) if fit.model.speed_dependent else None
    errors = {name: fit.params[name].stderr for name in _RESULTS if name in fit.var_names}
    if not errors:
        errors = {name: fit.params[name].stderr for name in fit.problem.space.names[:4]}
    if onset is not None and onset.speed > 0:
        errors[THRESHOLD_COLUMN] = fit.threshold_of(0).stderr
    entries = []
    for number, (term, name, what, unit, usual) in enumerate(described):
        meaning, plausible = what, usual
        tested = scores if found[number] else beside
        estimate, stderr = float(tested.estimate[number]), float(tested.stderr[number])
        if number in rivals:
            cause, estimate, stderr = rivals[number]
            plausible = max(plausible, abs(estimate))
            meaning += f", which explains the misfit as well as {described[cause][1]}"
        shifts = dict(zip(fit.problem.space.names, scores.shift[number].tolist(), strict=False))
        if THRESHOLD_COLUMN in errors:
            shifts[THRESHOLD_COLUMN] = _onset_change(fit, onset, term, scores.shift[number])
        # What is of the rotor, and not of forces or of what is read.
        acts = term.kind in _ACTING if isinstance(term, Cause) else not isinstance(term, Offset | Gain)
        entries.append(
            Assumption(
                name=name,
                meaning=meaning,
                unit=unit,
                estimate=term.size if isinstance(term, Cause) and term.sizes else estimate,
                stderr=stderr * math.sqrt(fit.widening),
                plausible=plausible,
                shifts=shifts,
                errors=errors,
                implied=name.startswith("Ds[") and _coupled(fit) > 0,
                prior=fit.settings.assumptions.get(name, math.nan),
                acts=term if acts else None,
            )
        )
    return entries


def _beside(
    residuals: ComplexArray, jacobian: ComplexArray, columns: ComplexArray, prior: Float, found: Bool, largest: Float
) -> tuple[Scores, dict[int, tuple[int, float, float]]]:
    """Score tests of terms beside causes that were found; and those up to a size that explain the residuals as well as
    a cause, in its place: of which of the terms, and with which estimate and standard error."""

    def asked(some: Bool) -> Scores:
        wider = np.hstack([jacobian, columns[:, some]])
        return score_tests(residuals, wider, columns, np.concatenate([prior, np.zeros(int(some.sum()))]))

    rivals, some = {}, SIGNIFICANT_ERRORS**2
    for cause in np.flatnonzero(found).tolist():
        scores = asked(found & (np.arange(found.size) != cause))
        gain = (scores.estimate / scores.stderr) ** 2
        alike = (gain > max(gain[cause], 2 * some) - some) & (np.abs(scores.estimate) < largest)
        for term in np.flatnonzero(alike & ~found).tolist():
            rivals[term] = (cause, float(scores.estimate[term]), float(scores.stderr[term]))
    return asked(found), rivals


def _onset_change(fit: FitResult, onset: Threshold | None, term: Term, shift: Float) -> float:
    if onset is None:
        return math.nan
    change = float(fit.problem.space.pull_back(np.asarray(onset.gradient), 0) @ shift)
    if isinstance(term, LeftOut):
        return change + onset_shift(fit.model, fit.theta(), onset, term)
    if isinstance(term, Cause):
        if term.sizes:
            return (onset_with(fit, onset, term, shift) - onset.speed) / term.size
        part = term.parts[0]
        changed = onset.gradient @ changed_values(fit.model, fit.theta(), part.value)
        return change + float(beyond(part, np.abs(onset.speed)) * changed)
    return change + (float(onset.gradient[term]) if isinstance(term, int) else 0.0)


# ---- terms ---------------------------------------------------------------------------------------------------------


_Described = tuple[Term, str, str, str, float]
"""A term with its name, meaning, unit and plausible size."""


def _left_out(fit: FitResult, blocks: Sequence[Responses]) -> Iterator[_Described]:
    """Terms of linear motion that the model leaves out."""
    moving = any(base.frequency.any() for base in blocks)  # constant loads alone see no inertia
    for term in terms_left_out(fit.model) if blocks else ():
        _, power, speeds = term.terms[0]
        if not moving and power:
            continue
        stiffness, frequency, speed = _levels(fit)
        part = _PLAUSIBLE["gyroscopic" if term.name.startswith("g[") else "term"]
        share = part * stiffness / frequency**power / speed**speeds
        # What acts between the planes acts at the journal too, about as much.
        damper = max(_damper(fit), _coupled(fit)) if term.name.startswith("Ds") else 0.0
        yield term, term.name, term.meaning, term.unit, max(share, damper)


def _offsets(fit: FitResult, blocks: Sequence[Responses]) -> Iterator[_Described]:
    """Probes and forces that are not at their planes, towards the next plane."""
    planes, size = [c.plane for c in fit.model.coordinates], len(fit.model.planes)
    if size < 2 or fit.model.frame != "z":
        return
    read = {int(k) for base in blocks for k in np.unique(base.coordinate)}
    driven = {int(k) for base in blocks for k in np.flatnonzero(base.force.any(axis=0))}
    for kind, places in (("probe", read), ("force", driven)):
        for at in sorted(place for place in places if place < size):
            towards = at + 1 if at + 1 < size else at - 1
            meaning = f"offset towards {planes[towards]}"
            yield Offset(kind=kind, at=at, towards=towards), f"{kind}[{planes[at]}]", meaning, "1", _PLAUSIBLE["offset"]


def _known(fit: FitResult) -> Iterator[_Described]:
    """The clearance, where motion was divided by it, and values that were taken as known."""
    divided = any(isinstance(block, OrbitResponses | OffCentreResponses) for block in fit.problem.blocks)
    if divided and fit.model.clearance:
        meaning = "radial clearance, taken as known, as a share of it"
        yield Clearance(), "clearance", meaning, "1", _PLAUSIBLE["clearance"]
    for place, name in enumerate(fit.model.parameter_names):
        p = fit.params.get(name)
        if p is not None and not p.vary and p.value:
            size = max(_PLAUSIBLE["term"] * abs(p.value), _damper(fit) if name.startswith("Ds") else 0.0)
            yield place, name, f"{p.meaning}, taken as known", p.unit, size


def _rest(fit: FitResult) -> Iterator[_Described]:
    """A journal that rests off centre, by the model's law or a typical one: circular forces hardly show it."""
    model = fit.model
    shown = any(isinstance(block, OrbitResponses) or is_linear(block) for block in fit.problem.blocks)
    if not fluid_coordinates(model) or not shown:
        return
    name = f"rest[{model.coordinates[fluid_coordinates(model)[0]].plane}]"
    eccentricity = fit.settings.assumptions.get(name, 0.0) or _PLAUSIBLE["rest"]
    law = Muszynska().start(1.0, 1.0)
    factors = {"K0": (1 - eccentricity**2) ** law["n_K"], "D": (1 - eccentricity**2) ** law["n_D"]}
    factors |= dict.fromkeys(("lam", "lam_D", "lam_M"), (1 - eccentricity) ** -law["b"])
    factor = np.array([factors.get(name, 1.0) for name in model.parameter_names])
    rest = Rest(change=fit.theta() * (factor - 1) / eccentricity, eccentricity=eccentricity)
    yield rest, name, "eccentricity of the journal at rest, taken as centred", "1", _PLAUSIBLE["rest"]


def _gains(fit: FitResult) -> Iterator[_Described]:
    """Gains that nothing in the data tells: of a single run, and of planes with a single probe."""
    tests = [test for test in fit.experiments if isinstance(test, PerturbationTest)]
    if not tests or fit.model.frame != "z" or fit.settings.calibration is not None:
        return
    if len({name for test in tests for name in test.run.tolist()}) == 1:
        yield Gain(), "gain", "gain of the only run", "1", _PLAUSIBLE["gain"]
    read = {(plane, way) for t in tests for plane, way in zip(t.plane.tolist(), t.direction.tolist(), strict=True)}
    for number, place in enumerate(fit.model.coordinates):
        ways = {way for plane, way in read if plane == place.plane and way in "xyz"}
        if place.axis == "z" and ways in ({"x"}, {"y"}):
            yield Gain(at=number), f"gain[{place.plane}]", "gain of the only probe", "1", _PLAUSIBLE["gain"]


def _causes(fit: FitResult) -> Iterator[_Described]:
    """Causes that the data show, and values of the fluid that may change with speed, found or not."""
    found = [] if fit.noise is None else list(fit.noise.causes)
    there = {cause.name for cause in found}
    others = (c for c in (*uneven_supports(fit), *changes_with_speed(fit.problem)) if c.name not in there)
    yield from ((cause, *_described_cause(fit, cause)) for cause in (*found, *others))


def _described_cause(fit: FitResult, cause: Cause) -> tuple[str, str, str, float]:
    """Name, meaning, unit and plausible size of a smooth cause."""
    part, shown = cause.parts[0], ", shown by the data" if cause.sizes else ""
    if part.kind in (Kind.SPEED, Kind.BEND):
        otherwise = "" if part.kind is Kind.SPEED else " otherwise than in proportion"
        meaning = f"share by which {part.value} changes{otherwise} when the mean tested speed doubles{shown}"
        plausible = _WITH_SPEED[part.value]
        if part.kind is Kind.BEND:  # as of a power of the speed that begins with the fitted slope
            slope = fit.params[f"{part.value}_speed"].value
            plausible = abs(slope * (1 - slope)) / 2
        return cause.name, meaning, "1", max(plausible, abs(cause.size) if cause.sizes else 0.0)
    meaning, unit = MEANINGS[cause.kind]
    return cause.name, f"{meaning}{shown}", unit, abs(cause.size)


def _damper(fit: FitResult) -> float:
    """Damping beside the fluid's that may well be there, N s/m."""
    return _PLAUSIBLE["damper"] * abs(fit.params["D"].value) if "D" in fit.params else 0.0


def _coupled(fit: FitResult) -> float:
    """Largest coupling damping that the fit is sure of, N s/m."""
    if "coupling_damping" not in getattr(fit.model, "blocks", ()):
        return 0.0
    found = [fit.params[p.name] for p in block_parameters(("coupling_damping",), len(fit.model.planes))]
    return max((abs(p.value) for p in found if p.vary and abs(p.value) > SIGNIFICANT_ERRORS * p.stderr), default=0.0)


def _levels(fit: FitResult) -> tuple[float, float, float]:
    """Typical stiffness, N/m, highest frequency and speed, rad/s; at rest a shaft turning as fast as it was shaken."""
    blocks = fit.problem.responses
    force = np.concatenate([np.abs(b.force).max(axis=1)[b.line] for b in blocks])
    size = np.concatenate([np.abs(b.measured) for b in blocks])
    stiffness = float(np.median(force[size > 0] / size[size > 0]))
    frequency = max(float(np.abs(b.frequency).max()) for b in blocks)
    speed = max(float(b.speed.max()) for b in blocks)
    return stiffness, frequency, speed if speed > 1.0 else max(frequency, 1.0)


_NEAR_PEAK = math.sqrt(0.5)
"""Motion over the largest from which a reading counts as at the peak: half the power."""


def uneven_supports(fit: FitResult) -> list[Cause]:
    """Supports that differ in x and y, by what pairs of probes show against the direction of the force, those of the
    plane that shows most; none without pairs. Stiffness ``dK conj(z)`` couples w and -w: what appears against the force
    is of first order in dK and shows its size; what it takes from the motion with the force is of second order and
    moves an isotropic fit."""
    if fit.model.frame != "z" or any(c.axis != "z" for c in fit.model.coordinates):
        return []
    largest, found = 0.0, []
    for test, block in zip(fit.experiments, fit.problem.blocks, strict=True):
        base = responses_of(block)
        if base is None or not isinstance(test, PerturbationTest) or not is_linear(block) or test.linear.any():
            continue
        places = Places.of(fit.model, test)
        if places.coordinate.size != base.measured.size:
            continue  # readings that the model leaves out
        wrong = directional(test.response, places.rows, places.backward)[1]
        for at in np.unique(base.coordinate[np.isfinite(wrong)]).tolist():
            size = np.where(np.isfinite(wrong) & (base.coordinate == at), np.abs(base.measured), 0.0)
            peak = size > _NEAR_PEAK * size.max()
            against = float(np.sum(np.abs(wrong[peak]) ** 2 - 2 * base.sigma[peak] ** 2))  # less that of the noise
            share = against / float(np.sum(size[peak] ** 2))
            if share > largest:
                part = Part(kind=Kind.SUPPORT, at=at, plane=fit.model.coordinates[at].plane)
                unit = cause_change(block, fit.thetas, Cause(parts=(part,)))
                square = against / float(np.sum(np.abs(unit[peak]) ** 2))
                largest, found = share, [Cause(parts=(replace(part, kind=Kind.PAIR),), sizes=(square,))]
    return found
