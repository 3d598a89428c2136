"""What pairs of probes give away: a wrong gain, a mounting angle, an exchange; and anisotropy beyond the noise.

On an isotropic rotor y follows x by 90 degrees in the direction of the force, ``Y = -j X`` forward and ``Y = +j X``
backward, at every frequency. A wrong gain multiplies one side by one number; anisotropy, whose shares change across
resonances, does not. A turn of both probes by an angle a leaves the orbits circular and multiplies every response by
``exp(-ja)``: it is found where the whole dynamic stiffness is measured (eq. 7), because inertia is real.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.orbits import ENOUGH, Orbits, Receptances, receptances_of, squared_norm, surely_inverse
from rotorfit.data.findings import Finding, listed
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers
from rotorfit.estimators.minimisation.least_squares import Options, minimise
from rotorfit.estimators.noise.reading_noise import noise_from_smoothness
from rotorfit.models.array_types import ComplexArray, Float, Index

AGREES = 1.5
"""Misfit over noise below which a statement explains the readings: the estimate of the noise is uncertain itself."""

ESTABLISHED = 8.0
"""Departures from what is expected, over their standard error, that are no accident among many planes."""

SMALLEST_GAIN = 0.03
"""Departure of the gains' ratio from one that is worth a warning: it moves parameters by half of it."""

DYNAMIC = 6.0
"""Ratio of largest to smallest response across a band in which anisotropy could not look like a constant gain."""

CLEAR = 6.0
"""Turn over its error beyond which it is there."""

CIRCULAR = 0.2
"""Part of the orbits against the force, of amplitude, beyond which they are no circles."""

BETTER = 0.5
"""Misfit of a trial fit with turned probes, over that without, in power, from which the turn is believed: what neither
explains, such as an anisotropic support, is no turn."""

MOST_LINES = 80
"""Frequencies that the search for turned probes looks at."""

MOST_SPEEDS = 3
"""Rotative speeds that it looks at."""

SMALLEST_TURN = 15.0
"""Turn of a pair of probes, degrees, beyond which it is no matter of calibration."""

_SHORT, _LONG = 30, 300  # evaluations of a trial fit: of one that looks for a turn, of one that may deny it
_BRIEFLY = Options(hessian="gauss-newton", max_iterations=_SHORT, tolerance=1e-3, acceptable=1e-2)
"""For a thousand readings a hundredth of the misfit is a third of a standard error, and a turn has to exceed six."""


def uneven_probes(orbits: Orbits) -> Iterator[Finding]:
    """Planes where x and y differ by more than their noise: by one factor, or as on an anisotropic rotor."""
    pairs = {plane: _pair(orbits, at) for (plane,), at in orbits.groups("plane")}
    told = {plane: pair for plane, pair in pairs.items() if pair is not None}
    good = [plane for plane, pair in told.items() if pair.even]
    uneven = []
    for plane, pair in told.items():
        if pair.even:
            continue
        if pair.constant and abs(pair.ratio - 1) >= SMALLEST_GAIN and (pair.dynamic or good):
            yield _gain(plane, pair)
        elif not pair.constant or abs(pair.ratio - 1) >= SMALLEST_GAIN:
            uneven.append(plane)
    if uneven:
        power = max(told[plane].share for plane in uneven) / 100
        part = 100 * (power / (1 - power)) ** 0.5  # share is below one half
        static = [plane for plane in uneven if told[plane].constant]
        doubt = (
            f" At {listed(static)} one factor explains it, which a wrong gain and an anisotropic stiffness share as "
            "long as no resonance lies in the band: these data cannot tell."
            if static
            else ""
        )
        text = (
            f"At {listed(uneven)} the motion against the direction of the force has up to {part:.2g} % of the "
            "amplitude of that along it, and is no noise: anisotropy, probes that differ, or a force that does not "
            f"turn (force_direction).{doubt} Compare with the model Anisotropic before trusting an isotropic one."
        )
        yield Finding("note", "anisotropy", text)


@dataclass(frozen=True)
class _Pair:
    """How y follows x at one plane.

    Attributes:
        even: as on an isotropic rotor, to within the noise.
        constant: by one factor at all frequencies, to within the noise.
        ratio: that factor, forward, complex; 1 for a perfect pair.
        mirrored: whether the factor of backward orbits is its conjugate, a mounting angle, rather than the same.
        share: part of the response's power against the force, %.
        dynamic: the band holds enough dynamics to tell a gain from an anisotropic stiffness.
        rows: rows of the test.
    """

    even: bool
    constant: bool
    ratio: complex
    mirrored: bool
    share: float
    dynamic: bool
    rows: tuple[int, ...]


def _pair(orbits: Orbits, at: Index) -> _Pair | None:
    at = at[np.isfinite(orbits.wrong[at]) & (np.abs(orbits.x[at]) > 0)]
    if at.size < ENOUGH:
        return None
    powers = [_power(part[at]) for part in (orbits.wrong, orbits.right)]
    share = powers[0] / sum(powers)
    if share > 0.5:  # that is the other check's business
        return None
    backward = orbits.frequency[at] < 0
    expected = np.where(backward, 1j, -1j) * orbits.x[at]
    seen = orbits.y[at]
    if _plainly_even(orbits, at, expected, seen):
        return _Pair(True, False, 1.0, False, 100 * share, False, ())
    noise = _noise(orbits, at)
    known = np.isfinite(noise).all(axis=1)
    at, noise, backward = at[known], noise[known], backward[known]
    expected, seen = expected[known], seen[known]
    if at.size < ENOUGH:
        return None
    even = _misfit(expected, seen, noise, 1.0)
    sides = {side: _ratio(expected[some], seen[some], noise[some]) for side, some in _sides(backward)}
    ratio, error = sides.get(False, sides.get(True, (1.0 + 0j, 1.0)))
    if False not in sides:
        ratio = ratio.conjugate()
    mirrored = False
    if len(sides) == 2:
        back = sides[True][0]
        mirrored = abs(back - ratio.conjugate()) < abs(back - ratio)
    of_line = np.where(backward & mirrored, np.conj(ratio), ratio)
    constant = _misfit(expected, seen, noise, of_line)
    size = np.abs(orbits.right[at] / orbits.force[at])
    clear = size[np.abs(orbits.x[at]) > 10 * noise[:, 0]]
    certain = abs(ratio - 1) > ESTABLISHED * error
    return _Pair(
        even=even < AGREES**2 and not (certain and constant < AGREES**2 and abs(ratio - 1) >= SMALLEST_GAIN),
        constant=constant < AGREES**2 and certain,
        ratio=ratio,
        mirrored=mirrored,
        share=100 * share,
        dynamic=clear.size >= ENOUGH and bool(clear.max() > DYNAMIC * clear.min()),
        rows=orbits.rows_of(at),
    )


def _plainly_even(orbits: Orbits, at: Index, expected: ComplexArray, seen: ComplexArray) -> bool:
    """Whether what departs from an isotropic rotor jumps from line to line, as noise does, sweep by sweep."""
    first, sweep = in_order(
        combined(
            numbers(orbits.run[at]), numbers(orbits.force_plane[at]), np.sign(orbits.frequency[at]).astype(int) + 1
        )
    )
    order = np.lexsort([orbits.frequency[at], sweep])
    for rows in np.split(order, np.cumsum(np.bincount(sweep, minlength=first.size))[:-1]):
        u, rest = expected[rows], seen[rows] - expected[rows]
        slope = np.vdot(u, rest) / np.vdot(u, u)  # what one factor more explains
        jumps = np.abs(np.diff(rest - slope * u)) ** 2 / 2
        level = float(np.mean(jumps)) if rows.size > 1 else 0.0
        certain = abs(slope) > ESTABLISHED * np.sqrt(level / np.vdot(u, u).real)
        if _power(rest) > AGREES**2 * level * rows.size or (certain and abs(slope) >= SMALLEST_GAIN):
            return False
    return True


def _sides(backward: NDArray[np.bool_]) -> Iterator[tuple[bool, NDArray[np.bool_]]]:
    for side in (False, True):
        if (backward == side).any():
            yield side, backward == side


def _noise(orbits: Orbits, at: Index) -> Float:
    """Noise of x and of y at each orbit, from the smoothness of their sweeps, NaN where those are too short."""
    noise = np.full((at.size, 2), np.nan)
    place = {int(i): k for k, i in enumerate(at.tolist())}
    speeds = orbits.speed if np.unique(orbits.speed[at]).size <= ENOUGH else np.zeros(orbits.speed.size)
    sweeps: dict[tuple[str, float, str, bool], list[int]] = {}
    for i in at.tolist():
        key = (str(orbits.run[i]), float(speeds[i]), str(orbits.force_plane[i]), bool(orbits.frequency[i] < 0))
        sweeps.setdefault(key, []).append(i)
    for rows in sweeps.values():
        if len(rows) >= ENOUGH:
            w = np.abs(orbits.frequency[rows])
            where = [place[i] for i in rows]
            for k, readings in enumerate((orbits.x[rows], orbits.y[rows])):
                noise[where, k] = noise_from_smoothness(w, readings)
    return noise


def _misfit(expected: ComplexArray, seen: ComplexArray, noise: Float, ratio: complex | ComplexArray) -> float:
    """Mean square of ``seen - ratio expected`` over its noise, 1 for noise alone."""
    variance = noise[:, 1] ** 2 + np.abs(ratio) ** 2 * noise[:, 0] ** 2
    return float(np.mean(np.abs(seen - ratio * expected) ** 2 / (2 * variance)))


def _ratio(expected: ComplexArray, seen: ComplexArray, noise: Float) -> tuple[complex, float]:
    """Ratio of two noisy readings and its standard error; the noise's own power is taken out of the denominator."""
    ratio, power = 1.0 + 0j, 1.0
    for _ in range(5):
        weight = 1 / (noise[:, 1] ** 2 + abs(ratio) ** 2 * noise[:, 0] ** 2)
        power = float(np.sum(weight * (np.abs(expected) ** 2 - 2 * noise[:, 0] ** 2)))
        if power <= 0:
            return 1.0 + 0j, np.inf
        ratio = complex(np.sum(weight * expected.conj() * seen) / power)
    return ratio, float(np.sqrt(2 / power))


def _gain(plane: str, pair: _Pair) -> Finding:
    g, phase = abs(pair.ratio), np.degrees(np.angle(pair.ratio))
    # Motion is seen (1 + ratio)/2 times as large where x is right, that over the ratio where y is.
    if_x, if_y = (1 - 1 / factor for factor in (abs(1 + pair.ratio) / 2, abs(1 + 1 / pair.ratio) / 2))
    if abs(np.radians(phase)) > abs(g - 1) and pair.mirrored:
        what = f"The probes at {plane} are {90 - phase:.1f} degrees apart instead of 90, at every frequency"
        cure = f"give their angles, probe_angles, {plane} at 0 and {90 - phase:.1f}"
    elif abs(np.radians(phase)) > abs(g - 1):
        what = f"The y probe at {plane} is {phase:+.1f} degrees off in phase against the x probe, at every frequency"
        cure = "correct it with a complex gain or a delay (gains, delays)"
    else:
        what = f"The y probe at {plane} reads {g:.3g} times what the x probe does, at every frequency"
        cure = f"if x is right, divide y by it: gains, {plane}.y = {g:.3g}; if y is right, {plane}.x = {1 / g:.3g}"
    effect = (
        "Every stiffness, damping and mass that is seen there (K, D, M, Mf) comes out some "
        f"{_bias(if_x)} if the y probe is wrong, {_bias(if_y)} if the x probe is; lam, a ratio, hardly changes"
        if max(abs(if_x), abs(if_y)) >= 0.01
        else "Stiffness, damping and mass hardly change, quadrature parts and small cross terms do"
    )
    return Finding("warning", "probe-gain", f"{what}, as no rotor does. {effect}. Find out which probe is wrong: "
                   f"{cure}.", pair.rows)  # fmt: skip


def _bias(share: float) -> str:
    return f"{100 * abs(share):.2g} % too {'small' if share > 0 else 'large'}"


# ---- turned, exchanged and inverted pairs ------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pose:
    """How a pair of probes stands: turned by an angle, its error, degrees, and whether the damping seen is positive."""

    turn: float
    error: float
    damped: bool


def turned_probes(orbits: Orbits) -> Iterator[Finding]:
    """Pairs of probes that sit at another angle than they are said to."""
    paired = orbits.paired
    if not paired.any() or _power(orbits.wrong[paired]) > CIRCULAR**2 * _power(orbits.right[paired]):
        return  # anisotropic, of which inertia as seen by circular orbits says nothing
    if surely_straight(orbits, orbits.right):
        return
    found = {
        plane: pose
        for plane, pose in poses(orbits, ()).items()
        if abs(pose.turn) > max(SMALLEST_TURN, CLEAR * pose.error)
    }
    if not found or not _turn_pays(orbits):
        return
    for plane, pose in found.items():
        a = pose.turn
        what = (
            f"The pair of probes at {plane} is inverted, both x and y, or the force there has the wrong sign"
            if abs(abs(a) - 180) < SMALLEST_TURN
            else f"The probes at {plane} read as if they sat at {a:.0f} and {a + 90:.0f} degrees instead of 0 and 90"
        )
        text = (
            f"{what}: with any other angle the rotor's inertia would not be real. Give their angles (probe_angles), or "
            "check the angle of the force. Stiffness and damping are mixed by it: D, lam and K0 are all wrong."
        )
        yield Finding("error", "probe-angle", text, orbits.rows_of(np.flatnonzero(orbits.plane == plane)))


def _upright(measured: Receptances | None) -> NDArray[np.bool_]:
    """Whether straight lines through the dynamic stiffness show every pair far from turned, shape ``(...)``."""
    found = np.ones((), dtype=bool)
    for _, turn, error, _ in _inertia(measured, trial=False):
        found = found & (np.abs((turn + 180) % 360 - 180) + CLEAR * error < SMALLEST_TURN / 2)
    return found


def surely_straight(orbits: Orbits, right: ComplexArray) -> NDArray[np.bool_]:
    """Whether :func:`turned_probes` has surely nothing to say, of one test or many of one plan, shape ``(...)``.

    There is no pair, or straight lines through the dynamic stiffness show every pair far from turned.

    Args:
        orbits: what was read where.
        right: responses in the direction of the force, shape ``(..., N)``.
    """
    found = np.ones(right.shape[:-1], dtype=bool)
    if not orbits.paired.any():
        return found
    alone = right is orbits.right
    speeds = orbits.groups("speed")[:MOST_SPEEDS]
    told = orbits.receptances(MOST_SPEEDS) if alone else [receptances_of(orbits, right, at) for _, at in speeds]
    for measured in told:
        if measured is not None and not alone and not measured.regular.all():
            return np.zeros(right.shape[:-1], dtype=bool)  # each has to be looked at by itself
        found = found & _upright(measured)
    return found


def _turn_pays(orbits: Orbits) -> bool:
    """Whether turned probes explain what straight ones do not, at one speed at least."""
    for measured in orbits.receptances(MOST_SPEEDS):
        lines = _some_lines(measured)
        if lines is not None:
            free, upright = (_unexplained(lines, upright=kept) for kept in (False, True))
            if np.isfinite(free) and (np.isnan(upright) or free < BETTER * upright):
                return True
    return False


def _power(amplitude: ComplexArray) -> float:
    return float(np.sum(np.abs(amplitude) ** 2))


def pose_in_words(orbits: Orbits, mirrored: tuple[str, ...]) -> str:
    """What is wrong with pairs of probes whose orbits turn the wrong way round; empty where that is not known."""
    found = poses(orbits, mirrored)
    words = []
    for plane in mirrored:
        if plane not in found:
            return ""
        pose = found[plane]
        nearest = min((0, 90, 180, -90), key=lambda a, turn=pose.turn: abs((turn - a + 180) % 360 - 180))  # type: ignore[misc]
        if abs((pose.turn - nearest + 180) % 360 - 180) > SMALLEST_TURN:
            return ""
        if nearest == 0 and not pose.damped:
            words.append("lag")
        else:
            words.append(
                {0: "y inverted", 90: "x and y exchanged", 180: "x inverted"}.get(
                    nearest, "x and y exchanged, both inverted"
                )
            )
    if words and set(words) == {"lag"}:
        return "phases of lag were given as lead (use phase_lag_deg and force_phase_lag_deg)"
    return "; ".join(f"at {plane} {word}" for plane, word in zip(mirrored, words, strict=True) if word != "lag")


def poses(orbits: Orbits, mirrored: tuple[str, ...]) -> dict[str, _Pose]:
    """Turn of every pair of probes that is certain: that which makes the inertia of eq. (7) real and positive.

    Args:
        orbits: orbits of a test.
        mirrored: planes whose orbits turn the wrong way round, and are turned back first.
    """
    found: dict[str, list[tuple[float, float, bool]]] = {}
    measured = orbits.receptances(MOST_SPEEDS)
    if mirrored:
        amplitude = np.where(np.isin(orbits.plane, mirrored), orbits.wrong.conj(), orbits.right)
        speeds = islice(orbits.groups("speed"), MOST_SPEEDS)
        measured = [receptances_of(orbits, amplitude, at) for _, at in speeds]
    for at_speed in measured:
        for plane, *told in _inertia(at_speed):
            angle, uncertain, damping = (np.asarray(value).item() for value in told)
            found.setdefault(plane, []).append((angle, uncertain, damping))
    result = {}
    speeds_tried = sum(_some_lines(at_speed) is not None for at_speed in measured)
    for plane, values in found.items():
        if len(values) < speeds_tried:
            continue  # probes stand as they do at every speed: what explains one of them only is no explanation
        turns, errors = np.array([v[0] for v in values]), np.maximum([v[1] for v in values], 0.1)
        weight = errors**-2
        apart = (turns - turns[np.argmin(errors)] + 180) % 360 - 180
        error = float(np.sum(weight) ** -0.5)
        turn = float(turns[np.argmin(errors)] + np.sum(weight * apart) / np.sum(weight))
        agree = (np.abs(apart) < SMALLEST_TURN + CLEAR * errors).all()
        if agree and error < SMALLEST_TURN / 2:
            result[plane] = _Pose((turn + 180) % 360 - 180, error, values[int(np.argmin(errors))][2])
    return result


@dataclass(frozen=True, eq=False, kw_only=True)
class _Lines:
    """Lines that the search for turned probes looks at.

    Attributes:
        u: frequencies over the highest, shape ``(L,)``.
        H, kappa: responses to unit forces and their inverses, shape ``(..., L, n, n)``.
    """

    u: Float
    H: ComplexArray
    kappa: ComplexArray


def _some_lines(measured: Receptances | None) -> _Lines | None:
    if measured is None or measured.H.shape[-3] < ENOUGH:
        return None
    every = max(1, measured.H.shape[-3] // MOST_LINES)
    w = measured.frequency[measured.regular][::every]
    u = w / np.abs(measured.frequency).max()
    return _Lines(u=u, H=measured.H[..., ::every, :, :], kappa=measured.kappa[..., ::every, :, :])


def _inertia(
    measured: Receptances | None, *, trial: bool = True
) -> Iterator[tuple[str, Float, Float, NDArray[np.bool_]]]:
    """Plane, turn of its probes and its error, degrees, and whether its damping is positive, shape ``(...)`` each, from
    ``kappa = a + b w + c w^2``.

    Args:
        measured: responses at one speed.
        trial: fit responses, as noisy data need; otherwise draw straight lines through the dynamic stiffness.
    """
    lines = _some_lines(measured)
    if measured is None or lines is None:
        return
    planes = measured.planes
    found = _polynomial(lines) if trial else _straight_lines(lines)
    if found is None:
        return
    terms, values, errors = found
    directions, uncertain = _sure(values, errors)
    for q, plane in enumerate(planes):
        inertia, damping = terms.index((q, q, 2)), terms.index((q, q, 1))
        if not values[..., inertia].any():
            continue
        turn, error = -directions[..., inertia], uncertain[..., inertia]
        for k in range(len(planes)):  # coupling is real as well, and better known, but may have either sign
            i = terms.index((k, q, 0))
            if k == q or not values[..., i].any():
                continue
            along, own = directions[..., i], uncertain[..., i]
            better = (own < error) & (error < 1)
            turn = np.where(better, along * np.sign((along / turn).real), turn)
            error = np.where(better, own, error)
        damped = (values[..., damping] / turn).imag > 0
        yield plane, np.degrees(np.angle(turn)), np.degrees(error), damped


def _sure(value: ComplexArray, error: Float) -> tuple[ComplexArray, Float]:
    """Direction of complex numbers, and their error over their size; of a zero nothing is known."""
    size = np.abs(value)
    known = size > 0
    over = 1 / np.where(known, size, 1.0)
    return np.where(known, value * over, 1.0), np.where(known, error * over, np.inf)


def _polynomial(lines: _Lines) -> tuple[list[tuple[int, int, int]], ComplexArray, Float] | None:
    """Polynomials ``kappa(u)`` whose inverse is H: row, column and power of each term, its factor and that one's error.

    The diagonal is quadratic in u, the rest constant: a chain of lumped masses, dampers and springs, each complex.
    """
    terms, start, _ = _straight_lines(lines)
    trial = _Trial(lines, terms)
    try:
        solved = minimise(trial, start.view(float), options=_BRIEFLY)
    except np.linalg.LinAlgError:  # a singular matrix on the way: no verdict
        return None
    if not solved.success:
        return None
    values = solved.x[::2] + 1j * solved.x[1::2]
    variance = 2 * solved.cost / max(2 * lines.H.size - solved.x.size, 1)
    covariance = np.linalg.pinv(trial.gauss_newton(solved.x)[2]) * variance
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0).reshape(-1, 2).mean(axis=1))
    return terms, values, errors


class _Trial:
    """Misfit of such polynomials, over the largest response; the vector holds real and imaginary parts in turn."""

    def __init__(self, lines: _Lines, terms: Sequence[tuple[int, int, int]], *, upright: bool = False):
        """Take the data.

        Args:
            lines: responses.
            terms: row, column and power of each term.
            upright: keep inertia real, as probes see it that are not turned; its imaginary parts are left out.
        """
        self.u, self.H, self.terms, self.scale = lines.u, lines.H, terms, np.abs(lines.H).max()
        real = [2 * i + 1 for i, (*_, power) in enumerate(terms) if power == 2] if upright else []
        self.free = np.delete(np.arange(2 * len(terms)), real)

    def response(self, x: Float) -> ComplexArray:
        """Responses at a vector."""
        parts = np.zeros(2 * len(self.terms))
        parts[self.free] = x
        kappa = np.zeros(self.H.shape, dtype=complex)
        for (q, k, power), value in zip(self.terms, parts[::2] + 1j * parts[1::2], strict=True):
            kappa[:, q, k] += value * self.u**power
        return np.asarray(np.linalg.inv(kappa))

    def residuals(self, x: Float) -> Float:
        """Real and imaginary parts in turn."""
        return np.asarray(((self.response(x) - self.H) / self.scale).ravel().view(float))

    def jacobian(self, x: Float) -> Float:
        """Their derivatives."""
        G = self.response(x)
        columns = []
        for q, k, power in self.terms:
            slope = -G[:, :, q, None] * G[:, None, k, :] * (self.u**power)[:, None, None] / self.scale
            columns += [slope.ravel().view(float), (1j * slope).ravel().view(float)]
        return np.stack(columns, axis=1)[:, self.free]

    def cost(self, x: Float) -> float:
        """Half the sum of squares."""
        return float(np.sum(self.residuals(x) ** 2)) / 2

    def gauss_newton(self, x: Float) -> tuple[float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix."""
        r, J = self.residuals(x), self.jacobian(x)
        return float(r @ r) / 2, J.T @ r, J.T @ J

    def hessian(self, x: Float) -> Float:
        """The Gauss-Newton matrix in its place."""
        return self.gauss_newton(x)[2]


def _unexplained(lines: _Lines, *, upright: bool) -> float:
    """Half the sum of squares that polynomials leave, with probes free to be turned or not; NaN where none were found.

    Args:
        lines, upright: as for :class:`_Trial`.
    """
    from scipy.optimize import least_squares  # late: loading it takes longer than a fit

    terms, start, _ = _straight_lines(lines)
    trial = _Trial(lines, terms, upright=upright)
    try:
        solved = least_squares(
            trial.residuals, start.view(float)[trial.free], jac=trial.jacobian, x_scale="jac", ftol=1e-4, xtol=1e-4,
            max_nfev=_LONG if upright else _SHORT,
        )  # fmt: skip
    except (ValueError, np.linalg.LinAlgError):  # a singular matrix on the way: no verdict
        return float("nan")
    return float(solved.cost)


def _straight_lines(lines: _Lines) -> tuple[list[tuple[int, int, int]], ComplexArray, Float]:
    """What :func:`_polynomial` answers by linear least squares on the inverse of each response matrix."""
    kappa, n = lines.kappa, lines.kappa.shape[-1]
    weight = 1 / squared_norm(kappa)  # d kappa = -kappa dH kappa
    entries = (kappa * weight[..., None, None]).reshape(*weight.shape, n * n)
    own = np.arange(n * n) % (n + 1) == 0
    parts = [_least_squares(weight[..., None] * lines.u[:, None] ** np.arange(3), entries[..., own])]
    terms = [(q, q, order) for q in range(n) for order in range(3)]
    if n > 1:
        parts.append(_least_squares(weight[..., None], entries[..., ~own]))
        terms += [(q, k, 0) for q in range(n) for k in range(n) if q != k]
    values, errors = (np.concatenate(found, axis=-1) for found in zip(*parts, strict=True))
    return terms, values, errors


def _least_squares(design: Float, readings: ComplexArray) -> tuple[ComplexArray, Float]:
    """Factors of ``k`` columns, and their errors, for each of some readings, the factors of one following one another.

    Args:
        design: shape ``(..., L, k)``.
        readings: shape ``(..., L, m)``.

    Returns:
        both, shape ``(..., m k)``.
    """
    across = np.swapaxes(design, -1, -2)
    normal = across @ design
    inverse = surely_inverse(normal)
    if inverse is None:
        inverse = np.linalg.pinv(normal)
    factors = inverse @ (across @ readings)
    miss = readings - design @ factors
    variance = (miss.real**2 + miss.imag**2).sum(axis=-2) / (2 * max(design.shape[-2] - design.shape[-1], 1))
    known = np.maximum(np.diagonal(inverse, axis1=-2, axis2=-1).real, 0.0)
    errors = np.sqrt(variance[..., :, None] * known[..., None, :])
    return np.swapaxes(factors, -1, -2).reshape(*errors.shape[:-2], -1), errors.reshape(*errors.shape[:-2], -1)
