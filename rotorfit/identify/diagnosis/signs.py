"""Errors of sign and direction: conjugated responses, exchanged probes, a reversed sense of rotation.

The local physics behind it (conventions: :mod:`rotorfit.lab.data.experiments`): at a drive point, where the force acts
and is measured, ``kappa = F / A`` and ``Im kappa`` is what the rotor dissipates. It is negative under any backward
force, positive under a forward force faster than the rotor, and negative under a slower one only as far as the fluid
drives the rotor (``D (w - lam Omega)``, eq. 13). A conjugated FRF turns all these signs round; a reversed sense of
rotation moves the drive of the fluid to the backward side.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import counted, significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.diagnosis.forces import BACKWARD_SHARES
from rotorfit.identify.diagnosis.orbits import FEWEST_READINGS, SYNCHRONOUS_DISTANCE, Orbits, mirrored, total_power
from rotorfit.lab.data.findings import Finding, listed

_SIGNIFICANT_DEVIATIONS = 3.5
"""Sum of signs over its standard deviation under random signs, beyond which a sign is taken as established."""


AGAINST_SHARE = 0.8
"""Share of the energy against the force that is an error; short of that it may be strong anisotropy."""


_DRIVE = ("run", "plane", "force_plane")
_SWEEP = ("plane", "force_plane", "speed")
_LINES_BESIDE = 3  # lines on either side that have to be smooth


def wrong_direction(orbits: Orbits) -> Iterator[Finding]:
    """Responses against the direction of the force: in some lines of a run, or in nearly all."""
    torn = np.zeros(orbits.frequency.size, dtype=bool)
    for _, at in orbits.groups("run", "speed", "force_plane", "plane"):
        torn[at] = turned(orbits.right[at], orbits.wrong[at])
    if torn.any():
        at = np.flatnonzero(torn)
        places = zip(orbits.run[at].tolist(), orbits.plane[at].tolist(), strict=True)
        named = listed(list(dict.fromkeys(f"{run} / {plane}" for run, plane in places)))
        text = (
            f"In {counted(at.size, 'line')} the rotor answers against the direction of the force, in the others of the "
            f"same runs along it, and nowhere between the two: {named}. Check whether a probe was turned round, or x "
            "and y exchanged, in these lines, and the sign of their frequency."
        )
        yield Finding("error", "turned-lines", text, orbits.rows_of(at))
    against: dict[tuple[str, str], bool] = {}
    hit = np.zeros(torn.size, dtype=bool)
    for key, at in orbits.groups("run", "plane"):
        paired = at[orbits.paired[at] & ~torn[at]]
        if paired.size:
            right, wrong = (total_power(part[paired]) for part in (orbits.right, orbits.wrong))
            against[key[0], key[1]] = wrong > AGAINST_SHARE * (right + wrong)
            hit[at] = against[key[0], key[1]]
    bad = [key for key, wrong in against.items() if wrong]
    if not bad:
        return
    planes = list(dict.fromkeys(plane for _, plane in bad))
    everywhere = all(against.values())
    cause = (
        "phase lag read as lead (use phase_lag_deg), x and y probes exchanged, or the sign of the frequency"
        if everywhere
        else f"the probes at {listed(planes)}: x and y exchanged, one of them inverted, or phases as lag"
        if len(planes) < len({plane for _, plane in against})
        else "the sign of the frequency in these runs, or phases given as lag"
    )
    where = "all runs" if everywhere else listed(list(dict.fromkeys(run for run, _ in bad)))
    text = f"The rotor answers mostly against the direction of the force, in {where}. Check {cause}."
    yield Finding("error", "wrong-direction", text, orbits.rows_of(np.flatnonzero(hit)))


def turned(along: ComplexArray, against: ComplexArray) -> NDArray[np.bool_]:
    """Lines that are clearly against the force, if of a run some are, some are clearly along it, and few are neither.
    Strong anisotropy turns orbits between two resonances too, but through lines that are neither, eight for each that
    is clearly against; noise makes mostly such lines."""
    wrong, both = np.abs(against) ** 2, np.abs(along) ** 2 + np.abs(against) ** 2
    known = np.isfinite(both) & (both > 0)
    share = np.divide(wrong, both, out=np.full(both.shape, np.nan), where=known)
    one_way_share = 0.9  # share of a line's energy from which it turns clearly one way, or the other
    clear, neither = share > one_way_share, (share <= one_way_share) & (share >= 1 - one_way_share)
    fewer = min(int(clear.sum()), int((share < 1 - one_way_share).sum()))
    torn_lines = 3  # lines of either kind from which a run is torn
    torn = fewer >= torn_lines and fewer > 2 * neither.sum()
    return np.asarray(clear & bool(torn and wrong[known].sum() > BACKWARD_SHARES[0] * both[known].sum()))


def signs(orbits: Orbits) -> Iterator[Finding]:
    """Conjugated FRFs, or else a reversed sense of rotation, from the sign of Im kappa at drive points."""
    drives = orbits.part(np.flatnonzero(orbits.driven & (orbits.right != 0)))
    if not drives.frequency.size:
        return
    kappa = drives.force / drives.right
    # Sign of the dissipation of each drive at |w| >= Omega, whatever lam < 1 is; 0: unknown.
    fast = np.abs(drives.frequency) >= np.abs(drives.speed) * (1 - SYNCHRONOUS_DISTANCE)
    sine = kappa.imag / np.abs(kappa) * np.sign(drives.frequency)
    small_sine = 0.1  # sine of the phase of kappa below which its sign says little
    # a phase of a few degrees may be an error of the reference: such readings hardly count
    sign = np.where(fast, sine / np.hypot(sine, small_sine), 0.0)
    total, square, count = (np.bincount(drives.number(*_DRIVE), values) for values in (sign, sign**2, fast))
    deviations = total / np.where(square > 0, np.sqrt(square), 1.0)
    known = (count >= FEWEST_READINGS) & (np.abs(deviations) > _SIGNIFICANT_DEVIATIONS)
    dissipates = np.where(known, np.sign(deviations), 0.0)
    hit = np.flatnonzero((dissipates < 0)[drives.number(*_DRIVE)])
    if not dissipates.any():
        planes = len(orbits.groups("plane"))
        falling = [sweep for _, sweep in drives.groups(*_SWEEP) if _quadrature_falls(drives, kappa, sweep, planes)]
        hit = np.concatenate([hit, *falling])
    if hit.size:
        yield _negative_damping(drives, kappa, hit)
        return
    score, hit = max(_drives_backward(drives, kappa), key=lambda one: one[0])
    if score > _SIGNIFICANT_DEVIATIONS:  # the fluid, which drives slow forward whirl, seems to drive backward whirl
        text = (
            f"Slow backward forces drive the rotor instead of damping it in {drives.runs(hit)}: lam would "
            "be negative. The sense of rotation is reversed, or x and y are exchanged together with the sign of the "
            "frequency; x has to turn towards y with the rotor."
        )
        undo, code = "count y the other way", "reversed-rotation"
        yield Finding("error", code, text, drives.rows_of(hit), remedy=undo, correction=code)


def _negative_damping(drives: Orbits, kappa: ComplexArray, hit: Index) -> Finding:
    begin = "Damping would be negative at the drive point (quadrature dynamic stiffness falls with frequency) in "
    begin += drives.runs(hit)
    slow = hit[np.abs(drives.frequency[hit]) <= np.quantile(np.abs(drives.frequency[hit]), 0.2)]
    both = bool(drives.paired[hit].all())
    code, undo = ("negative-damping", None) if both else ("conjugated", "phase_lag_deg, force_phase_lag_deg")
    correction = None if both else code
    if np.median(kappa.real[slow]) <= 0:
        undo, correction = "turn the forces by 180 degrees", "half-turn"
        cause = (
            ", and so would stiffness: phases are half a turn off. Check the angle of the force or of the weight, "
            "whether the probes are inverted, and whether the readings are accelerations."
        )
    elif both:
        cause = (
            ". As x and y follow the force's direction, phases of lag alone are not the cause. What turns both probes "
            "alike is: an inverted pair, a filter or a delay, perhaps from some frequency on, a wrong angle of the "
            "force; or phases of lag together with exchanged probes or the other sign of the frequency."
        )
    else:
        cause = (
            ": the FRF is conjugated. Give phases of lag as phase_lag_deg and force_phase_lag_deg, or check the sign "
            "convention of the analyser. One probe alone does not tell that from a filter, or from its sign being "
            "turned round."
        )
    return Finding("error", code, f"{begin}{cause}", drives.rows_of(hit), remedy=undo, correction=correction)


def _quadrature_falls(drives: Orbits, kappa: ComplexArray, sweep: Index, planes: int) -> bool:
    """True if quadrature falls from backward to forward in a sweep below the speed, by Spearman's correlation. One
    direction is enough if there is but one plane; else the other planes' motion turns the slope within a direction."""
    w, quadrature = drives.frequency[sweep], kappa.imag[sweep]
    if w.size < FEWEST_READINGS or np.ptp(w) == 0 or np.ptp(quadrature) == 0:
        return False
    if planes > 1 and not ((w > 0).any() and (w < 0).any()):
        return False
    least = 0.8  # rank correlation with frequency from which quadrature falls throughout
    return rank_correlation(w, quadrature) < -least


def rank_correlation(first: Float, second: Float) -> float:
    """Spearman's correlation; equal values have the mean of their ranks. SciPy's takes longer to load than a fit."""
    both = [(np.sort(values), values) for values in (first, second)]
    ranks = [np.searchsorted(*pair) + np.searchsorted(*pair, side="right") for pair in both]  # twice the mean rank
    return float(np.corrcoef(ranks)[0, 1])


def _drives_backward(drives: Orbits, kappa: ComplexArray) -> Iterator[tuple[float, Index]]:
    """Scores of a drive by slow backward forces, and the orbits behind each: by the sign of the quadrature, and by the
    part of it even in w, ``-D lam Omega`` in eq. (13), over its noise."""
    ratio = drives.frequency / np.where(drives.speed == 0, np.nan, np.abs(drives.speed))
    size, of = np.abs(drives.right), drives.number(*_DRIVE)
    largest = np.zeros(int(of.max()) + 1)
    np.maximum.at(largest, of, size)
    # slow unbalance moves the rotor little and noise turns its phase: weigh the sign by the response
    sign = kappa.imag / np.abs(kappa) * size / largest[of]
    # Fractions of the speed below which whirl may be slower than the fluid; the largest is more than any lam
    whirl_ratios = (0.1, 0.2, 0.3, 0.5)
    pairs = mirrored(drives, np.flatnonzero(np.abs(ratio) < whirl_ratios[-1]), *_SWEEP)
    noise = (np.abs(kappa) * (size.min(initial=np.inf) / size))[pairs]  # of kappa = F / A, up to a common factor
    even = kappa.imag[pairs].sum(axis=1) / np.hypot(noise[:, 0], noise[:, 1])
    for limit in whirl_ratios:
        slow = np.flatnonzero((ratio < 0) & (ratio > -limit))
        yield _established(sign[slow]), slow
        some = np.abs(ratio[pairs[:, 0]]) < limit
        yield _established(even[some]), np.unique(pairs[some])


def _established(values: Float) -> float:
    """Sum over its standard deviation under random signs; noise cannot make it large, few values cannot either."""
    size = float(np.sqrt(values @ values))
    return float(values.sum()) / size if size > 0 else 0.0


def half_turns(orbits: Orbits) -> Iterator[Finding]:
    """Planes whose readings change their sign between two lines of a sweep, as no rotor's do.

    A response changes its sign in one step where it passes zero, at an antiresonance, or through infinity, at a
    resonance that hardly is damped: it then changes by as much as its own size between the lines beside that too.
    Readings that are smooth on both sides, and of one size, were inverted on one of them.
    """
    found: dict[tuple[str, float, float], list[Index]] = {}
    for (_, plane, _, _), at in orbits.groups("run", "plane", "force_plane", "speed"):
        for side in (at[orbits.frequency[at] > 0], at[orbits.frequency[at] < 0]):
            sweep = side[np.argsort(np.abs(orbits.frequency[side]), kind="stable")]
            w = np.abs(orbits.frequency[sweep])
            if sweep.size < 2 * _LINES_BESIDE or (np.diff(w) == 0).any():
                continue
            for k in _jumps(w, orbits.right[sweep] / orbits.force[sweep]).tolist():
                found.setdefault((plane, float(w[k]), float(w[k + 1])), []).append(sweep)
    for (plane, low, high), sweeps in found.items():
        hit = np.concatenate(sweeps)
        text = (
            f"At {plane} the readings turn by half a turn between {significant(low * RPM_PER_RAD_S, 4)} and "
            f"{significant(high * RPM_PER_RAD_S, 4)} rpm, and are smooth on both sides, as no rotor's are, in "
            f"{orbits.runs(hit)}. Either side may be the inverted one: check "
            "range, polarity and filters of the probes there, and the angle of the force."
        )
        yield Finding("warning", "half-turn", text, orbits.rows_of(np.sort(hit)))


def _jumps(w: Float, response: ComplexArray) -> Index:
    """Lines of a sweep after which the response goes on with the other sign."""
    step, size = np.abs(np.diff(response)), np.abs(response)
    at = np.arange(_LINES_BESIDE - 1, w.size - _LINES_BESIDE)
    jump = np.diff(w)[at]
    smooth = np.ones(at.size, dtype=bool)
    # Change from line to line, over the response and scaled to the step of frequency at the jump, of a smooth response:
    # at a resonance or an antiresonance between two lines it is one half at least
    largest_step = 0.3
    for k in range(1, _LINES_BESIDE):
        for near, end in ((at - k, at - k + 1), (at + k, at + k)):  # steps before and behind, and where they end
            smooth &= step[near] * np.maximum(jump / np.diff(w)[near], 1.0) < largest_step * size[end]
    opposite = np.abs(response[at] + response[at + 1]) < largest_step * step[at]
    return np.asarray(at[smooth & opposite])
