"""Source of compiled kernels: the likelihood of many parameter vectors and its gradient, written from CasADi graphs.

For each way of reading a node (a *pattern*: which rows under which force directions) a small CasADi graph holds the
squared whitened residuals as functions of the coefficients of the equation of motion, ``|g adj(kappa) u - m
det(kappa)|^2 / |det(kappa)|^2``. Its instructions become the body of a loop over nodes that only sums, which
compilers turn into vector instructions. Structural zeros of a model vanish, derivatives come from CasADi.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from rotorfit.estimators.misfit.problem import LOSS_SCALE, Loss
from rotorfit.models import RotorModel
from rotorfit.models.compiled import statements
from rotorfit.models.motion.journal import at_frequency

LARGEST_UNROLLED = 2
"""Models with more coordinates are not unrolled: their kernels factorise numerically."""

Entry = tuple[int, int]
"""Row read, and the coordinate of the force or -1 for a force on several."""


@dataclass(frozen=True)
class Pattern:
    """How a node is read: its entries, whether readings carry a gain, and the loss."""

    entries: tuple[Entry, ...]  # what each reading of a node is of, see :data:`Entry`
    gains: bool  # whether readings carry a gain
    loss: Loss  # of the fit


def _coefficient_graph(model: RotorModel) -> tuple[ca.SX, ca.SX, ca.SX, list[int]]:
    """Parameters, speed, the coefficients that are not structurally zero, and their places."""
    theta, speed = ca.SX.sym("theta", len(model.parameters)), ca.SX.sym("speed")
    parts = model.functions.graph(ca.vertcat(theta, speed, 0.0))
    places = [i for i in range(parts.numel()) if not parts[i].is_zero()]
    return theta, speed, parts[places], places


def _kappa(model: RotorModel, c: ca.SX, places: Sequence[int], w: ca.SX) -> list[list[tuple[ca.SX, ca.SX]]]:
    """Dynamic stiffness from its coefficients by Horner's rule, ``s = j w``."""
    size, given = len(model.coordinates), {place: c[i] for i, place in enumerate(places)}
    block = size**2  # places of the real parts, and of the imaginary parts, of one power of s

    def entry(place: int) -> tuple[ca.SX, ca.SX]:
        powers = range(place, place + 2 * block * (model.order + 1), 2 * block)
        return at_frequency([(given.get(at, ca.SX(0)), given.get(at + block, ca.SX(0))) for at in powers], w)

    return [[entry(i * size + j) for j in range(size)] for i in range(size)]


def _times(a: tuple[ca.SX, ca.SX], b: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _adjugate(kappa: list[list[tuple[ca.SX, ca.SX]]]) -> tuple[list[list[tuple[ca.SX, ca.SX]]], tuple[ca.SX, ca.SX]]:
    if len(kappa) == 1:
        return [[(ca.SX(1), ca.SX(0))]], kappa[0][0]
    (a, b), (c, d) = kappa
    ad, bc = _times(a, d), _times(b, c)
    return [[d, (-b[0], -b[1])], [(-c[0], -c[1]), a]], (ad[0] - bc[0], ad[1] - bc[1])


def robust_cost(loss: Loss, size2: Any) -> Any:
    """Robust cost of :func:`rotorfit.estimators.misfit.problem.robust_weights`, symbolically."""
    c2 = LOSS_SCALE**2
    if loss == "linear":
        return size2
    if loss == "soft_l1":
        return 2 * c2 * (ca.sqrt(1 + size2 / c2) - 1)
    if loss == "huber":
        return ca.fmin(size2, c2) + 2 * c2 * (ca.sqrt(ca.fmax(size2 / c2, 1)) - 1)
    return c2 * ca.log1p(size2 / c2)


def _pattern_graph(
    model: RotorModel, pattern: Pattern
) -> tuple[ca.SX, ca.SX, list[ca.SX], list[ca.SX], list[tuple[ca.SX, ca.SX]]]:
    """All symbols of one node, coefficients first, in the order of :func:`_spelling`; the coefficients, the gains (re,
    im of each entry), the squared residuals, and the residuals if a weight stands for its root."""
    _, _, coefficients, places = _coefficient_graph(model)
    c, w = ca.SX.sym("c", coefficients.numel()), ca.SX.sym("w")
    adj, det = _adjugate(_kappa(model, c, places, w))
    size = len(model.coordinates)
    inverse = 1 / (det[0] ** 2 + det[1] ** 2)
    data, gains, directions, rho, misses = [], [], [], [], []
    for row, column in pattern.entries:
        target, weight, gain = ca.SX.sym("t", 2), ca.SX.sym("wt"), ca.SX.sym("g", 2)
        u = ca.SX.sym("u", 2 * size)
        if column >= 0:
            value = adj[row][column]
        else:
            terms = [_times(adj[row][j], (u[2 * j], u[2 * j + 1])) for j in range(size)]
            value = sum((t[0] for t in terms), ca.SX(0)), sum((t[1] for t in terms), ca.SX(0))
        if pattern.gains:
            value = _times((gain[0], gain[1]), value)
        miss = _times((target[0], target[1]), det)
        size2 = ((value[0] - miss[0]) ** 2 + (value[1] - miss[1]) ** 2) * inverse * weight
        rho.append(robust_cost(pattern.loss, size2))
        ahead = _times(value, (det[0], -det[1]))
        misses.append(((ahead[0] * inverse - target[0]) * weight, (ahead[1] * inverse - target[1]) * weight))
        data.append(ca.vertcat(target, weight))
        gains.append(gain)
        directions.append(u)
    return ca.vertcat(c, w, *data, *gains, *directions), c, gains, rho, misses


def _spelling(model: RotorModel, pattern: Pattern, n_coefficients: int) -> tuple[list[str], list[str]]:
    """Names of a pattern's inputs in the generated loop, and statements that hoist out of it what does not change."""
    names = [f"c{i}" for i in range(n_coefficients)] + ["freq[l]"]
    hoisted = [f"c{i} = c[{i}]" for i in range(n_coefficients)] + ["freq = frequency[first:last]"]
    for e in range(len(pattern.entries)):
        names += [f"tr{e}[l]", f"ti{e}[l]", f"wt{e}[l]"]
        hoisted.append(f"q = datum[entry + {e}]")
        for short, array in (("tr", "target_re"), ("ti", "target_im"), ("wt", "weight")):
            hoisted.append(f"{short}{e} = {array}[q:q + last - first]")
    for e in range(len(pattern.entries)):
        names += [f"gr{e}", f"gi{e}"]
        if pattern.gains:
            hoisted += [f"gr{e} = gain_re[gain[entry + {e}]]", f"gi{e} = gain_im[gain[entry + {e}]]"]
    for e, (_, column) in enumerate(pattern.entries):
        for j in range(len(model.coordinates)):
            names += [f"ur{e}_{j}", f"ui{e}_{j}"]
            if column < 0:
                hoisted += [
                    f"u{s}{e}_{j} = direction_{p}[direction[entry + {e}], {j}]" for s, p in (("r", "re"), ("i", "im"))
                ]
    return names, hoisted


_DATA = (
    "frequency, first, last, entry, datum, gain, direction, direction_re, direction_im, target_re, target_im, weight, "
    "gain_re, gain_im"
)


def _pattern_source(model: RotorModel, pattern: Pattern, number: int) -> str:
    inputs, c, gains, rho, misses = _pattern_graph(model, pattern)
    names, hoisted = _spelling(model, pattern, c.numel())
    count = len(pattern.entries)

    def loop(name: str, arguments: str, results: list[ca.SX], sums: Sequence[str], to: Sequence[str] = ()) -> str:
        """A function that sums results over the nodes of a segment into the places given, or writes them ``to`` places
        from which on those of all nodes follow."""
        write = ("a{}[l] = {}" if to else "a{} += {}").format
        body = statements(ca.Function(name, [inputs], [ca.vertcat(*results)]), names.__getitem__, write)
        begin = [f"a{k} = out[{place}:]" for k, place in enumerate(to)] or [f"a{k} = 0.0" for k in range(len(sums))]
        text = [f"@inner\ndef {name}(c, {_DATA}, {arguments}):"]
        text += [f"    {line}" for line in (*hoisted, *begin)]
        text.append("    for l in range(last - first):")
        text += [f"        {line}" for line in body]
        text += [f"    {place} += a{k}" for k, place in enumerate(sums)]
        return "\n".join(text) + "\n"

    total = ca.sum1(ca.vertcat(*rho)) / 2
    slopes = [total, ca.densify(ca.gradient(total, c))]
    places = ["cost[0]", *(f"seed[{i}]" for i in range(c.numel()))]
    if pattern.gains:
        slopes += [ca.densify(ca.gradient(total, g)) for g in gains]
        places += [f"seed_{part}[gain[entry + {e}]]" for e in range(count) for part in ("re", "im")]
    values = [ca.densify(ca.vertcat(*rho))]
    parts = [f"place_{part}[entry + {e}]" for e in range(count) for part in ("re", "im")]
    return (
        loop(f"sums_{number}", "channel, out", values, [f"out[channel[entry + {e}]]" for e in range(count)])
        + loop(f"slopes_{number}", "cost, seed, seed_re, seed_im", slopes, places)
        + loop(f"misses_{number}", "place_re, place_im, out", [part for miss in misses for part in miss], (), parts)
    )


def _model_source(model: RotorModel) -> str:
    theta, speed, parts, _ = _coefficient_graph(model)
    seed, n = ca.SX.sym("seed", parts.numel()), theta.numel()

    def read(i: int) -> str:
        return f"theta[{i}]" if i < n else "speed" if i == n else f"seed[{i - n - 1}]"

    forward = ca.Function("forward", [theta, speed], [ca.densify(parts)])
    pulled = ca.densify(ca.jtimes(parts, theta, seed, True))
    backward = ca.Function("backward", [theta, speed, seed], [pulled])
    return (
        "@inner\ndef coefficients(theta, speed, out):\n    "
        + "\n    ".join(statements(forward, read, "out[{}] = {}".format) or ["pass"])
        + "\n@inner\ndef pull(theta, speed, seed, out):\n    "
        + "\n    ".join(statements(backward, read, "out[{}] = {}".format) or ["pass"])
        + "\n"
    )


_SHARED = (
    "x, template, index, group, speed, frequency, segments, pattern, datum, gain, direction, "
    "direction_re, direction_im, target_re, target_im, weight, gain_re, gain_im"
)

_DRIVER = """
@outer
def {name}({shared}, {results}):
    c = np.empty((group.size, {n}))
    theta = np.empty((group.size, template.shape[1]))
    {prepare}
    for m in range(x.shape[0]):
        for k in range(group.size):
            for i in range(template.shape[1]):
                at = index[group[k], i]
                theta[k, i] = x[m, at] if at >= 0 else template[group[k], i]
            coefficients(theta[k], speed[k], c[k])
        t = m if target_re.shape[0] > 1 else 0
        g = m if gain_re.shape[0] > 1 else 0
        {begin}
        for s in range(segments.shape[0]):
            first, last, k, entry = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
            {calls}
        {end}
"""

_CALL = (
    "{test} pattern[s] == {i}:\n                {kind}_{i}(c[k], frequency, first, last, entry, datum, gain, "
    "direction, direction_re, direction_im, target_re[t], target_im[t], weight, gain_re[g], gain_im[g], {results})"
)


_OWN_SLOPES = "cost[m:m + 1], seed[k], seed_re[g], seed_im[g]"

_PULLED = """for k in range(group.size):
            pull(theta[k], speed[k], seed[k], by_theta)
            for i in range(template.shape[1]):
                at = index[group[k], i]
                if at >= 0:
                    by_x[m, at] += by_theta[i]"""


@lru_cache(maxsize=16)
def source(model: RotorModel, patterns: tuple[Pattern, ...]) -> str:
    """Source of ``sums``, ``slopes`` and ``misses`` of a model read in given ways, for a module with decorators."""
    n = _coefficient_graph(model)[2].numel()
    parts = [_model_source(model), *(_pattern_source(model, p, i) for i, p in enumerate(patterns))]
    prepare = f"seed = np.empty((group.size, {n}))\n    by_theta = np.empty(template.shape[1])"
    for name, results, own, *more in (
        ("sums", "channel, out", "channel, out[m]", "", "", ""),
        ("slopes", "cost, by_x, seed_re, seed_im", _OWN_SLOPES, prepare, "seed[:] = 0.0", _PULLED),
        ("misses", "place_re, place_im, out", "place_re, place_im, out[m]", "", "", ""),
    ):
        texts = dict(zip(("prepare", "begin", "end"), more, strict=True))
        calls = "\n            ".join(
            _CALL.format(test="elif" if i else "if", i=i, kind=name, results=own) for i in range(len(patterns))
        )
        parts.append(_DRIVER.format(name=name, shared=_SHARED, results=results, n=n, calls=calls, **texts))
    return "\n".join(parts)
