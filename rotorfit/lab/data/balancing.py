"""Correction weights from influences: least squares over planes and speeds, limits, holes, errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import ROUND_OFF, ComplexArray, Float, Index
from rotorfit.base.digits import significant, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import quantile
from rotorfit.base.text_table import Printed, text_table
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.inference.correction_weights import Correction, confounded, correct, own_shares, remaining
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.synchronous import covered_speeds
from rotorfit.lab.data.weights import MOST_DWELLS, Influences, influence

Limits = float | Mapping[str, float]
"""Largest mass-radius product, kg m, of every plane or by plane."""
Holes = int | Sequence[float] | Mapping[str, int | Sequence[float]]
"""Number of holes, evenly spaced from the zero of the force's angle on, or their angles in degrees; by plane."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Balance(ByValue, Printed):
    """Correction weights (:func:`balance`).

    Attributes:
        planes: planes of the weights, P of them.
        weight: mass-radius products ``m r exp(j delta)`` to be added, kg m, shape ``(P,)``; delta is the angle that
            trial weights have in ``force_phase_deg``.
        covariance: of their real parts, then of their imaginary parts, shape ``(2P, 2P)``, NaN where no error is known.
        freedom: real degrees of freedom behind the errors, infinite where the noise was given.
        readings: plane and direction of the probe of each reading, C of them.
        speed: its speed, rad/s, shape ``(C,)``.
        before: vibration without the correction weights, m 0-peak, phase lead, shape ``(C,)``.
        expected: vibration with them, NaN where no run tells what they do.
        importance: weight of each reading in the sum of squares that is made small, one on average.
        stderr: standard error of each of its real and imaginary part, another mounting's scatter included, m.
        at_limit: planes whose weight is as large as it may be.
        holes: for each plane with holes, or with a smallest weight, the angle, rad, and the amount, kg m, of each
            weight to put in.
        remarks: sentences on what the weights rest on.
    """

    planes: tuple[str, ...]
    weight: ComplexArray
    covariance: Float
    freedom: float
    readings: tuple[tuple[str, str], ...]
    speed: Float
    before: ComplexArray
    expected: ComplexArray
    importance: Float
    stderr: Float
    at_limit: tuple[str, ...]
    holes: Mapping[str, tuple[tuple[float, float], ...]]
    remarks: tuple[str, ...]

    plot = Accessor()

    def interval(self, plane: str, level: float = 0.95) -> tuple[tuple[float, float], tuple[float, float]]:
        """Intervals of a weight's size and of its angle, each by itself.

        Args:
            plane: one of ``planes``.
            level: probability that an interval holds the weight which exact influences would give.

        Returns:
            size from and to, kg m; angle from and to, rad, a whole turn where the size may be zero.

        Raises:
            ValueError: no such plane.
        """
        if plane not in self.planes:
            raise ValueError(unknown_name("plane", plane, self.planes))
        place = self.planes.index(plane)
        size, angle = abs(self.weight[place]), float(np.angle(self.weight[place]))
        unit = self.weight[place] / size if size else 1.0 + 0j
        turned = np.array([[unit.real, unit.imag], [-unit.imag, unit.real]])
        rows = [place, place + len(self.planes)]
        variance = np.diag(turned @ self.covariance[np.ix_(rows, rows)] @ turned.T).tolist()
        along, across = (quantile(level, self.freedom) * math.sqrt(max(one, 0.0)) for one in variance)
        turn = across / size if not across >= size else np.pi
        return (max(size - along, 0.0), size + along), (angle - turn, angle + turn)

    @property
    def verdict(self) -> str:
        """The largest vibration without and with the weights, of readings of which runs tell what the weights do;
        empty where there are none."""
        known = np.isfinite(self.expected)
        if not known.any():
            return ""
        before = int(np.argmax(np.where(known, np.abs(self.before), -1.0)))
        after = int(np.nanargmax(np.abs(self.expected)))
        missing = (
            ""
            if known.all()
            else f" What becomes of {', '.join(map(self._probe, np.flatnonzero(~known).tolist()))} is open."
        )
        left = " ".join(told(abs(self.expected[after]) * 1e6, self.reaches[after] * 1e6))
        return (
            f"The largest vibration, {significant(abs(self.before[before]) * 1e6, 3)} um 0-pk ({self._probe(before)}), "
            f"is expected to become {left} um 0-pk ({self._probe(after)}).{missing}"
        )

    @property
    def reaches(self) -> Float:
        """Half of the 95 % interval of each expected vibration, m."""
        return quantile(0.95, self.freedom) * self.stderr

    def _probe(self, reading: int) -> str:
        return f"{' '.join(self.readings[reading])} at {self.speed[reading] * RPM_PER_RAD_S:.0f} rpm"

    def summary(self) -> str:
        """The largest vibration before and after, tables of the weights, with 95 % intervals, and of the vibration."""
        lines = [self.verdict, ""] if self.verdict else []
        lines += ["add (angles as force_phase_deg, lead, and as force_phase_lag_deg; +- are 95 % intervals):"]
        lines += text_table(self._weight_rows(), "<14 >12 <12 >10 <10 >10 <20")
        for plane, pair in self.holes.items():
            put = (f"{significant(mr * 1e6, 4)} g mm at {significant(np.degrees(at) % 360, 5)} deg" for at, mr in pair)
            lines.append(f"to mount in {plane}: {' and '.join(put) or 'nothing'}")
        rows = [["probe", "rpm", "before, um 0-pk", "expected", ""]]
        for k, (plane, direction) in enumerate(self.readings):
            known = np.isfinite(self.expected[k])
            left, reach = told(abs(self.expected[k]) * 1e6, self.reaches[k] * 1e6) if known else ("", "")
            sizes = (significant(abs(self.before[k]) * 1e6, 3), left)
            values = (
                f"{size} @ {np.degrees(np.angle(v)):.0f}" if np.isfinite(v) else "not known"
                for size, v in zip(sizes, (self.before[k], self.expected[k]), strict=True)
            )
            rows.append([f"{plane} {direction}", f"{self.speed[k] * RPM_PER_RAD_S:.0f}", *values, reach])
        return "\n".join([*lines, "", *text_table(rows, "<14 >8 >20 >20 <14"), *self.remarks])

    def __str__(self) -> str:
        return self.summary()

    def _weight_rows(self) -> list[list[str]]:
        rows = [["plane", "g mm", "", "deg", "", "deg lag", ""]]
        for place, plane in enumerate(self.planes):
            size, angle = abs(self.weight[place]) * 1e6, float(np.degrees(np.angle(self.weight[place])))
            (_, high), (_, late) = self.interval(plane)
            reach, turn = high * 1e6 - size, float(np.degrees(late)) - angle
            exact = plane in self.at_limit or not np.nan_to_num(self.covariance, nan=1.0).any()
            row = [
                plane,
                *((significant(size, 4), "") if exact else told(size, reach)),
                f"{angle % 360:.1f}",
                "" if exact and plane not in self.at_limit else _reach(turn, 180.0),
                f"{-angle % 360:.1f}",
            ]
            rows.append([*row, "at its limit" if plane in self.at_limit else ""])
        return rows


def _reach(value: float, turn: float = np.inf) -> str:
    """Half of an interval, which says nothing where it is as large as ``turn``."""
    if not np.isfinite(value):
        return "+- ?"
    return f"+- {significant(value, 2)}" if value < turn else "any"


def told(value: float, reach: float) -> tuple[str, str]:
    """A value to the second digit of half of its 95 % interval, and that half; to few digits where none is known."""
    if not (np.isfinite(reach) and reach > 0):
        return significant(value, 3), "" if reach == 0 else _reach(reach)
    shown, half = with_error(value, reach)
    return shown, f"+- {half}"


def balance(
    influences: Influences,
    reference: str | PerturbationTest | None = None,
    *,
    planes: Sequence[str] | None = None,
    limits: Limits | None = None,
    holes: Holes | None = None,
    smallest: Limits | None = None,
    weights: Mapping[str, complex] | None = None,
) -> Balance:
    """Correction weights that make the vibration as small as they can, by least squares over all readings.

    A reading counts by the inverse square of the noise that was given with it (``sigma``), else all count alike. With
    limits the problem stays convex and is solved with them, which leaves less vibration than weights that are cut
    down. The weights come on top of those that are in during the reference.

    Args:
        influences: from :func:`influence`.
        reference: the state to be corrected: the name of a run that the influences came from, whose weights stay in;
            readings of the rotor as it is now, of the same probes at the same speeds; None is the rotor without any
            weight.
        planes: planes to put weights in, by default all that were tried.
        limits: largest mass-radius product, kg m, of each plane or by plane.
        holes: number of holes (the first at zero degrees of ``force_phase_deg``) or their angles, degrees, of each
            plane or by plane: weights are split over the two holes beside their angle.
        smallest: smallest mass-radius product that can be mounted, kg m, of each plane or by plane: weights are whole
            multiples of it. ``expected`` is then what remains with these.
        weights: mass-radius products ``m r exp(j delta)`` that are put in, kg m, by plane, in place of the best ones;
            ``expected`` is what remains with them.

    Returns:
        weights with intervals, vibration expected with its error, and remarks: planes that act alike, what no error is
        known of.

    Raises:
        ValueError: a run, plane or reading that is not there, more planes than readings, holes that do not surround
            the shaft.

    Example:
        >>> weighed = rf.influence(rf.read(rf.datasets.path("rk4_sync.csv")))
        >>> weights = rf.balance(weighed, planes=["disk2"], limits=40e-6)
        >>> weights.planes, weights.at_limit
        (('disk2',), ('disk2',))
    """
    if weights is not None and not (planes is None and limits is None and holes is None and smallest is None):
        raise ValueError(
            "weights that are given need no planes, limits, holes or smallest one: they are put in as they are"
        )
    planes = planes if weights is None else tuple(weights)
    chosen = tuple(influences.planes if planes is None else dict.fromkeys(planes))
    if not chosen:
        raise ValueError(f"no plane to put weights in; tried were {', '.join(influences.planes)}")
    for plane in chosen:
        if plane not in influences.planes:
            raise ValueError(unknown_name("plane of a trial weight", plane, influences.planes))
    whole = _state(influences, reference)
    kept = np.array([0, *[1 + influences.planes.index(plane) for plane in chosen]])  # the vibration first
    everything = whole.coefficients[:, kept]
    cells = np.flatnonzero(np.isfinite(everything).all(axis=1))
    places = (cells[:, None] * whole.coefficients.shape[1] + kept).reshape(-1)
    coefficients, covariance = everything[cells], whole.covariance[np.ix_(places, places)]
    if weights is None and len(cells) < len(chosen):
        raise ValueError(
            f"weights in {len(chosen)} planes, {', '.join(chosen)}, cannot be determined from {len(cells)} "
            f"reading{'s' * (len(cells) != 1)}; balance in fewer planes, or read more probes or speeds"
        )
    solved = influences.solved
    remarks = whole.remarks
    # All readings weigh the same where no noise was given. Estimated noise would not do: weights would follow the
    # readings that few mountings happened to leave alike, and intervals of 95 % hold 91 to 93 % then.
    given = whole.given[cells] if np.isfinite(whole.given[cells]).all() else np.ones(len(cells))
    importance = np.asarray(given**-2 / np.mean(given**-2))
    remarks += _alike(chosen, coefficients[:, 1:], importance)
    if weights is not None:
        found = _of_given(np.array([complex(weights[plane]) for plane in chosen]), coefficients, covariance)
    else:
        found = correct(coefficients, covariance, importance, _limits("limits", chosen, limits))
    mounting = np.nan_to_num(whole.mounting[cells])
    out, count = np.flatnonzero(np.isnan(everything).any(axis=1)), len(everything)
    remarks += (influences.run_out,) if "stays in" in influences.run_out else ()
    remarks += _uncontrolled(influences, whole, out, chosen)
    in_holes = _in_holes(chosen, found.weight, {} if holes is None else _by_plane("holes", holes, chosen))
    left, left_error = found.left, found.left_error
    if smallest is not None:
        pieces = _limits("smallest", chosen, smallest)
        in_holes = _of_pieces(chosen, found.weight, in_holes, pieces, coefficients, importance)
        mounted = np.array([sum(mr * np.exp(1j * at) for at, mr in in_holes[plane]) for plane in chosen], dtype=complex)
        left, left_error = remaining(coefficients, covariance, mounted)
        remarks += ("expected is what remains with these weights, whole multiples of the smallest one",)
    expected = np.where(np.abs(left) < ROUND_OFF * np.abs(coefficients[:, 0]).max(), 0.0, left)
    at_limit = tuple(plane for plane, there in zip(chosen, found.at_limit.tolist(), strict=True) if there)
    return Balance(
        planes=chosen,
        weight=found.weight,
        covariance=found.covariance,
        freedom=solved.freedom,
        readings=tuple(influences.channels[channel] for channel, _ in whole.cells),
        speed=solved.speed[[dwell for _, dwell in whole.cells]],
        before=everything[:, 0],
        expected=_at(cells, expected, count, np.nan),
        importance=_at(cells, importance, count, 0.0),
        stderr=_at(cells, np.hypot(left_error, mounting), count, np.nan),
        at_limit=at_limit,
        holes=in_holes,
        remarks=(*remarks, *_unknown(found, whole.mounting[cells])),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    """What is known of every reading: vibration first, then influences; NaN where it is not."""

    cells: tuple[tuple[int, int], ...]  # channel and dwell of each, C of them
    coefficients: ComplexArray  # shape ``(C, 1 + planes)``
    covariance: ComplexArray  # of these, cell by cell, shape ``(C (1 + planes), C (1 + planes))``
    given: Float  # noise that was given with each, m, NaN where it was not
    mounting: Float  # scatter of each between mountings, m, NaN where it is not known
    remarks: tuple[str, ...]


def run_up(test: PerturbationTest, weights: Mapping[str, complex] | Balance, reference: str | None = None) -> Balance:
    """Vibration over the speeds of start-ups as it is, and as it will be with weights, at every probe.

    Args:
        test: start-ups, not differenced, as for :func:`influence` with ``speeds``.
        weights: mass-radius products by plane, kg m, as for :func:`balance`, or what that found.
        reference: run whose weights stay in; None is the rotor without any weight.

    Returns:
        the weights as they were given, with the vibration at 64 speeds that all runs went through.

    Raises:
        ValueError: the runs have no speeds in common, or what :func:`influence` and :func:`balance` refuse.

    Example:
        >>> values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
        >>> def start_up(unbalance):
        ...     rpm = [300.0 + 50.0 * k for k in range(40)]
        ...     model = rf.models.OneMode()
        ...     return rf.simulate(model, values, "synchronous", speed_rpm=rpm, unbalance=unbalance, exact=True)
        >>> both = rf.join_runs([start_up(2e-5), start_up(3e-5)], difference=False)
        >>> found = rf.run_up(both, {"journal": 1e-5})
        >>> found.speed.size  # 64 speeds for each of two probes
        128
    """
    given = dict(zip(weights.planes, mounted_of(weights), strict=True)) if isinstance(weights, Balance) else weights
    points = 64  # speeds of a curve, as many as a figure shows
    of_runs = [test.speed[test.run == run] for run in test.runs]
    low, high = max(speed.min() for speed in of_runs), min(speed.max() for speed in of_runs)
    if not low < high:
        raise ValueError(f"{test.source or 'the test'}: its runs have no speeds in common")
    speeds = covered_speeds(test, np.linspace(low, high, points))
    parts = [
        balance(influence(test, speeds[k : k + MOST_DWELLS]), reference, weights=given)
        for k in range(0, speeds.size, MOST_DWELLS)
    ]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("speed", "before", "expected", "importance", "stderr")
    }
    return replace(
        parts[0],
        freedom=min(part.freedom for part in parts),
        readings=tuple(reading for part in parts for reading in part.readings),
        remarks=(),
        **joined,
    )


def mounted_of(found: Balance) -> list[complex]:
    """Weights as they are mounted: those in holes, else as they were found."""
    weights = zip(found.planes, found.weight.tolist(), strict=True)
    put = found.holes
    return [sum((mr * np.exp(1j * at) for at, mr in put[p]), 0j) if p in put else own for p, own in weights]


def _state(influences: Influences, reference: str | PerturbationTest | None) -> _State:
    """What is known of every reading in the state that is to be corrected."""
    solved = influences.solved
    weights = np.zeros(len(influences.planes), dtype=complex)
    remarks: tuple[str, ...] = ()
    if isinstance(reference, str):
        test = influences.measured
        if reference not in test.runs:
            raise ValueError(f"{test.source or 'the test'}: {unknown_name('reference run', reference, test.runs)}")
        row = int(np.argmax(test.run == reference))
        by_plane = dict(zip(test.force_planes, test.forces_by_plane[row] / test.speed[row] ** 2, strict=True))
        weights = np.array([by_plane[plane] for plane in influences.planes])
        stay = [
            f"{significant(abs(u) * 1e6, 4)} g mm at {np.degrees(np.angle(u)):.1f} deg in {plane}"
            for u, plane in zip(weights.tolist(), influences.planes, strict=True)
            if u
        ]
        remarks = (f"the weights of run {reference} stay in: {', '.join(stay)}",) if stay else ()
    share = np.eye(weights.size + 1, dtype=complex)
    share[0, 1:] = weights
    full = np.kron(np.eye(solved.channel.size), share)
    parts = [one.combined(share) for one in solved.partly]
    lost = np.full(len(parts), np.nan)
    state = _State(
        cells=(
            *zip(solved.channel.tolist(), solved.dwell.tolist(), strict=True),
            *((one.channel, one.dwell) for one in solved.partly),
        ),
        coefficients=np.concatenate(
            [np.column_stack([solved.residual, solved.influence]) @ share.T, *(values[None] for values, _ in parts)]
        ),
        covariance=_in_blocks([full @ solved.whole @ full.conj().T, *(own for _, own in parts)]),
        given=np.concatenate([solved.given, lost]),
        mounting=np.concatenate([solved.mounting, lost]),
        remarks=remarks,
    )
    return state if reference is None or isinstance(reference, str) else _read_now(influences, reference, state)


def _in_blocks(blocks: Sequence[ComplexArray]) -> ComplexArray:
    from scipy.linalg import block_diag  # late: loading it takes longer than a fit

    return np.asarray(block_diag(*blocks))


def _at(cells: Index, values: Any, count: int, otherwise: float) -> Any:
    """Values of some cells among those of all."""
    found = np.full(count, otherwise, dtype=values.dtype)
    found[cells] = values
    return found


def _uncontrolled(influences: Influences, state: _State, out: Index, planes: Sequence[str]) -> tuple[str, ...]:
    """A sentence on readings of which the weights do what no run tells."""
    places: dict[str, list[str]] = {}
    for at in out.tolist():
        known = state.coefficients[at]
        put = [plane for plane in planes if np.isnan(known[1 + influences.planes.index(plane)])]
        why = f"no run that reads it tells the influence of {' and '.join(put)}" if put else "its level is not known"
        places.setdefault(why, []).append(influences.place(*state.cells[at]))
    return tuple(f"NOT CONTROLLED, because {why}: {', '.join(at)}" for why, at in places.items())


def _read_now(influences: Influences, now: PerturbationTest, state: _State) -> _State:
    """Vibration as it was read anew, with influences as they were found."""
    solved = influences.solved
    kept, values, errors, missed = [], [], [], []
    for cell, (channel, dwell) in enumerate(state.cells):
        plane, direction = influences.channels[channel]
        speed = solved.speed[dwell]
        rows = (now.plane == plane) & (now.direction == direction)
        rows &= np.abs(now.speed - speed) <= SPEED_TOLERANCE * speed
        if not rows.any():
            missed.append(influences.place(channel, dwell))
            continue
        given = float(np.sqrt(np.mean(now.sigma[rows] ** 2)))
        repeat = float(solved.repeat[cell]) if cell < solved.repeat.size else np.nan
        kept.append(cell)
        values.append(complex(now.response[rows].mean()))
        errors.append((given if np.isfinite(given) else repeat) / np.sqrt(rows.sum()))
    if not kept:
        raise ValueError(
            f"{now.source or 'the reference'} has no reading of the probes and speeds of the influences; these are "
            f"{', '.join(' '.join(channel) for channel in influences.channels)}"
        )
    size = state.coefficients.shape[1]
    places = (np.array(kept)[:, None] * size + np.arange(size)).reshape(-1)
    covariance = state.covariance[np.ix_(places, places)].copy()
    first = np.arange(len(kept)) * size
    covariance[first, :] = covariance[:, first] = 0.0
    covariance[first, first] = np.square(errors)
    remarks = (f"left out, because the reference has no reading of them: {', '.join(missed)}",) if missed else ()
    return _State(
        cells=tuple(state.cells[cell] for cell in kept),
        coefficients=np.column_stack([values, state.coefficients[kept, 1:]]),
        covariance=covariance,
        given=state.given[kept],
        mounting=state.mounting[kept],
        remarks=remarks,
    )


def _by_plane(option: str, given: Any, planes: Sequence[str]) -> Mapping[str, Any]:
    """What was given for all planes or by plane, by plane."""
    found = given if isinstance(given, Mapping) else dict.fromkeys(planes, given)
    for plane in found:
        if plane not in planes:
            raise ValueError(f"{option}: {unknown_name('plane', plane, planes)}")
    return found


def _of_given(weight: ComplexArray, coefficients: ComplexArray, covariance: ComplexArray) -> Correction:
    """Weights that are put in, which have no error."""
    left, left_error = remaining(coefficients, covariance, weight)
    return Correction(
        weight=weight,
        covariance=np.zeros((2 * weight.size, 2 * weight.size)),
        left=left,
        left_error=left_error,
        at_limit=np.zeros(weight.size, dtype=bool),
    )


def _in_holes(
    planes: Sequence[str], weight: ComplexArray, holes: Mapping[str, Any]
) -> dict[str, tuple[tuple[float, float], ...]]:
    own = dict(zip(planes, weight.tolist(), strict=True))
    return {plane: _over_holes(plane, own[plane], _angles(plane, some)) for plane, some in holes.items()}


def _of_pieces(
    planes: Sequence[str],
    weight: ComplexArray,
    holes: Mapping[str, tuple[tuple[float, float], ...]],
    pieces: Float,
    coefficients: ComplexArray,
    importance: Float,
) -> dict[str, tuple[tuple[float, float], ...]]:
    """Amounts in the holes, or at the angle of a plane without, that are whole multiples of the smallest one, each
    rounded up or down so that together they leave least."""
    places: list[tuple[int, float, float]] = []  # plane, angle and amount of each
    for at, (plane, own) in enumerate(zip(planes, weight.tolist(), strict=True)):
        places += [(at, turn, mr) for turn, mr in holes.get(plane, ((float(np.angle(own)), abs(own)),))]
    choices = []
    for at, _, mr in places:
        piece = pieces[at]
        down = np.floor(mr / piece) * piece if np.isfinite(piece) else mr
        choices.append((down, down + piece) if np.isfinite(piece) else (mr,))
    best, least = tuple(own[0] for own in choices), np.inf
    for amounts in product(*choices):
        mounted = np.zeros(len(planes), dtype=complex)
        for (at, turn, _), mr in zip(places, amounts, strict=True):
            mounted[at] += mr * np.exp(1j * turn)
        left = float(importance @ np.abs(coefficients @ np.concatenate([[1.0], mounted])) ** 2)
        if left < least:
            best, least = amounts, left
    found: dict[str, tuple[tuple[float, float], ...]] = dict.fromkeys(planes, ())
    for (at, turn, _), mr in zip(places, best, strict=True):
        if mr > 0:
            found[planes[at]] += ((turn, float(mr)),)
    return found


def _limits(option: str, planes: Sequence[str], limits: Limits | None) -> Float:
    given = _by_plane(option, np.inf if limits is None else limits, planes)
    for plane, limit in given.items():
        if not limit > 0:
            raise ValueError(f"{option}: the mass-radius product at {plane} must be above zero, kg m; got {limit}")
    return np.array([float(given.get(plane, np.inf)) for plane in planes])


def _alike(planes: Sequence[str], influence: ComplexArray, importance: Float) -> tuple[str, ...]:
    """A sentence on planes that act alike."""
    some = np.flatnonzero(confounded(influence, importance))
    if not some.size:
        return ()
    names = [planes[k] for k in some.tolist()]
    own = float(own_shares(influence, importance)[some].min())
    listed = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
    return (
        f"planes {listed} act alike on these readings: what one does, the others do to {100 * (1 - own):.0f} %. "
        "Their weights may come out large and against one another; where their intervals are wide, balance without one "
        "of them, or read another probe or speed",
    )


def _unknown(found: Correction, mounting: Float) -> tuple[str, ...]:
    """A sentence on errors that are not known."""
    if not np.isfinite(found.covariance).all():
        return (
            "no error of the weights is known: give sigma_um, repeat the runs, or mount a weight at one angle more",
        )
    if np.isnan(mounting).any():
        return (
            "the intervals hold the noise of the readings alone: how far mounting a weight again moves vectors is not "
            "known without one more angle or weight than there are unknowns",
        )
    return ()


def _angles(plane: str, holes: int | Sequence[float]) -> Float:
    """Angles of the holes, rad, ascending within a turn."""
    if isinstance(holes, int):
        angles = 2 * np.pi * np.arange(holes) / max(holes, 1)
    else:
        angles = np.unique(np.radians(np.asarray(holes, dtype=float)) % (2 * np.pi))
    gaps = np.diff(angles, append=angles[:1] + 2 * np.pi)
    if angles.size < 3 or (gaps >= np.pi).any():
        raise ValueError(
            f"holes at {plane}: three or more are needed, less than 180 degrees from one to the next; got "
            f"{', '.join(f'{significant(a, 4)}' for a in np.degrees(angles)) or 'none'}"
        )
    return np.asarray(angles)


def _over_holes(plane: str, weight: complex, angles: Float) -> tuple[tuple[float, float], ...]:
    """The two holes beside a weight's angle and the amounts, none negative, whose sum it is."""
    turn = float(np.angle(weight)) % (2 * np.pi)
    for low, high in pairwise([*angles.tolist(), angles[0] + 2 * np.pi]):
        for at in (turn, turn + 2 * np.pi):
            if low <= at <= high:
                gap = np.sin(high - low)
                return (low, abs(weight) * np.sin(high - at) / gap), (high, abs(weight) * np.sin(at - low) / gap)
    raise ValueError(f"no holes at {plane} on either side of {significant(np.degrees(turn), 4)} degrees")
