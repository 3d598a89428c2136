"""Eigenvalues against rotative speed: where the margin of stability ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant, with_error
from rotorfit.base.matching import cheapest_rows
from rotorfit.identify.fitting.causes.slopes import eigenvalue_slopes
from rotorfit.identify.fitting.propagation import theta_at
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import eigenvalues
from rotorfit.models.motion.modes import OVERDAMPED
from rotorfit.models.motion.stability import whirl_sense
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import group_label, rig_of, speeds_of
from rotorfit.show.plots.shaft_lines import turning_stability

_LINEAR = 0.06
"""Damping ratio up to which its axis is about linear; beyond it is logarithmic."""

_READS = (
    "F forward, solid and warm; B backward, dashed and cool; thick: the mode that goes unstable. Numbers: frequency",
    "at the highest tested speed; in brackets, that at which the shaft bends: speed less signed frequency.",
    "Circles: fitted modes at tested speeds. Band at the threshold: its 95 % interval.",
)

_READS_SENSELESS = ("Sense unknown: no speed tells forward from backward here, each mode is drawn once.",)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Modes:
    """Modes of a group over speed, followed by continuity, and what stands beside them."""

    speeds: Float  # rad/s, shape ``(S,)``
    s: ComplexArray  # eigenvalues, shape ``(S, modes)``
    names: tuple[str, ...]  # 1F, 2F, ..., 1B, ... by frequency at the highest tested speed; 1, 2 without a sense
    named_at: int  # place of that speed
    tested: Float  # rad/s
    onset: Quantity | None  # rad/s

    @property
    def damping(self) -> Float:
        """Damping ratios, shape ``(S, modes)``."""
        return np.asarray(-self.s.real / np.where(np.abs(self.s) > 0, np.abs(self.s), np.nan))

    @property
    def critical(self) -> int | None:
        """The mode that goes unstable first; none where none does."""
        if self.onset is None:
            return None
        at = int(np.argmin(np.abs(self.speeds - self.onset.value)))
        ratios = np.where(np.isfinite(self.damping[at]), np.abs(self.damping[at]), np.inf)
        return int(np.argmin(ratios))

    @property
    def reads(self) -> tuple[str, ...]:
        """How to read the figure."""
        if not self.s.size:
            return ()
        return _READS if any(name[-1] in "FB" for name in self.names) else _READS_SENSELESS

    def look(self, mode: int) -> dict[str, Any]:
        """Colour, style and width of a mode's line."""
        number, way = int(self.names[mode].rstrip("FB")) - 1, self.names[mode].lstrip("0123456789")
        ahead = way != "B"
        if mode == self.critical:
            return {"color": style.CRITICAL, "lw": 2.6, "ls": "-" if ahead else (0, (4, 2)), "zorder": 3}
        others = [m for m, name in enumerate(self.names) if name.lstrip("0123456789") == way and m != self.critical]
        rank = others.index(mode) if mode in others else number
        colours = [c for c in (style.FORWARD if ahead else style.BACKWARD) if c != style.CRITICAL]
        colour = colours[rank % len(colours)]
        return {"color": colour, "lw": 1.5, "ls": "-" if ahead else (0, (4, 2)), "zorder": 2.5}


@style.on_sheet
def plot_stability(fit: FitResult, *, sheet: style.Sheet, group: int = 0, beside: FitResult | None = None) -> Figure:
    """Frequency and damping of the modes against rotative speed, with the threshold and its 95 % interval.

    The axis of damping ratios is linear near zero and logarithmic above; the logarithmic decrement is its second
    scale. ``beside`` is drawn dotted.
    """
    if fit.model.turns:
        return turning_stability(sheet, fit)
    modes = _followed(fit, group, beside)
    label = group_label(fit, group)
    title = f"{rig_of(fit)}: stability over speed" + (f", {style.literal(label)}" if label else "")
    figure, axes = sheet.grid(1, 2, title, size=(3.54, 2.75), reads=modes.reads)
    frequency, damping = axes[0]
    _campbell(sheet, frequency, modes)
    _damping(sheet, damping, modes)
    for axis in axes[0]:
        _beside(sheet, axis, modes)
    if beside is not None:
        other, _ = _modes(beside, group, modes.speeds, modes.named_at)
        _another(sheet, axes[0], modes.speeds * sheet.per_rad_s, other, _onset_shown(beside, group))
        style.legend_below(figure, {_beside_words(sheet, beside, group): {"color": style.INK, "lw": 1.1, "ls": ":"}})
    return figure


def _another(sheet: style.Sheet, axes: Any, x: Float, s: ComplexArray, onset: Quantity | None) -> None:
    """Modes and threshold of another rotor, in one colour."""
    zeta = -s.real / np.where(np.abs(s) > 0, np.abs(s), np.nan)
    for axis, values in zip(axes, (s.imag * sheet.per_rad_s, zeta), strict=True):
        axis.plot(x, values, ":", color=style.INK, lw=1.1, zorder=3.5)
        if onset is not None:
            axis.axvline(onset.value * sheet.per_rad_s, color=style.CRITICAL, lw=1.1, ls=":")


def _onset_shown(fit: FitResult | None, group: int) -> Quantity | None:
    """The threshold speed that is drawn, where there is one."""
    if fit is None or not fit.model.speed_dependent or not np.isfinite(fit.threshold_of(group).value):
        return None
    return fit.threshold_of(group)


def _beside_words(sheet: style.Sheet, beside: FitResult, group: int) -> str:
    onset = _onset_shown(beside, group)
    where = "" if onset is None else f": {_threshold_words(sheet, onset)} {sheet.rate_unit}"
    return style.literal(beside.message) + where


@style.on_sheet
def plot_damping(fit: FitResult, *, sheet: style.Sheet, group: int = 0) -> Figure:
    """Damping ratio of the whirl modes against speed, near the threshold: the half figure of a first screen.

    Modes beyond the tested frequencies are left out, as they are of the numbers beside it.
    """
    modes = _followed(fit, group)
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    axis.set_title("Damping ratio of the whirl modes")
    zeta, x = modes.damping, modes.speeds * sheet.per_rad_s
    top = 0.6  # largest damping ratio worth a place: what matters is near zero
    least = float(np.nanmin(zeta, initial=0.0))
    axis.set_ylim(min(-0.12, max(1.1 * least, -0.3)), top + 0.02)
    shown = np.flatnonzero(np.abs(modes.s[modes.named_at].imag) <= fit.band).tolist()
    for mode in sorted({*shown, *([] if modes.critical is None else [modes.critical])}):
        look = modes.look(mode)
        axis.plot(x, zeta[:, mode], **look)
        below = np.flatnonzero(zeta[:, mode] <= top)
        if below.size and zeta[-1, mode] > top:
            leaves = (x[below[-1]], zeta[below[-1], mode])
            axis.annotate(modes.names[mode], leaves, (-5, -1), textcoords="offset points", ha="right", va="top",
                          fontsize=style.SMALL_TYPE, fontweight="bold", color=look["color"],
                          path_effects=style.halo(), zorder=6)  # fmt: skip
    style.end_labels(axis, [(modes.names[i], zeta[-1, i], modes.look(i)["color"]) for i in shown])
    _unstable(axis)
    _beside(sheet, axis, modes)
    return figure


@lru_cache(maxsize=1)  # two figures of a report show them
def _followed(fit: FitResult, group: int, beside: FitResult | None = None) -> _Modes:
    onset, tested = _onset_shown(fit, group), _tested_speeds(fit, group)
    # Shows the threshold with some room, or the tested speeds where there is none.
    fastest = max(float(np.max(experiment.speed, initial=0.0)) for experiment in fit.experiments)
    top = 1.5 * max(fastest, 1.0) if onset is None else 1.25 * max(onset.value, fastest)
    other = _onset_shown(beside, group)
    top = top if other is None else max(top, min(1.1 * other.value, 2.5 * top))
    speeds = np.union1d(np.linspace(0.0, top, 400), tested)
    named_at = int(np.argmin(np.abs(speeds - tested.max(initial=0.0))))
    s, senses = _modes(fit, group, speeds, named_at)
    order = np.argsort(np.abs(s[named_at].imag))
    count, names = {"F": 0, "B": 0, "": 0}, [""] * s.shape[1]
    for mode in order.tolist():
        way = {1: "F", -1: "B", 0: ""}[int(senses[mode])]
        count[way] += 1
        names[mode] = f"{count[way]}{way}"
    return _Modes(speeds=speeds, s=s, names=tuple(names), named_at=named_at, tested=tested, onset=onset)


def _campbell(sheet: style.Sheet, axis: Any, modes: _Modes) -> None:
    """Signed frequency of each mode."""
    x, w = modes.speeds * sheet.per_rad_s, modes.s.imag * sheet.per_rad_s
    span = 1.25 * np.nanmax(np.abs(w), initial=1e-9)
    axis.set(
        title=f"Whirl frequency, {sheet.rate_unit}", ylim=(0.0 if modes.reads == _READS_SENSELESS else -span, span)
    )
    labels = []
    for mode, name in enumerate(modes.names):
        look = modes.look(mode)
        axis.plot(x, w[:, mode], **look)
        axis.plot(_at_tested(modes) * sheet.per_rad_s, _values(modes, w[:, mode]), **_circle(look))
        own = modes.damping[modes.named_at, mode]
        words = significant(abs(w[modes.named_at, mode]), 4) if own < OVERDAMPED else "overdamped"
        bends = x[modes.named_at] - w[modes.named_at, mode]
        words += f" ({significant(abs(bends), 4)})" if name[-1] in "FB" and own < OVERDAMPED else ""
        labels.append((f"{name} {words}", w[-1, mode], look["color"]))
    inside = x[x < span]
    axis.plot(inside, inside, ":", color=style.GREY, lw=1.0, zorder=2)
    style.end_labels(axis, labels)
    edge = min(x[-1], span)
    axis.annotate(
        "1×", (0.86 * edge, 0.86 * edge), (-3, 2), textcoords="offset points", ha="right", va="bottom",
        fontsize=style.SMALL_TYPE, color=style.GREY, path_effects=style.halo(),
    )  # fmt: skip


def _damping(sheet: style.Sheet, axis: Any, modes: _Modes) -> None:
    """Damping ratio of each mode, and the decrement as a second scale."""
    x, zeta = modes.speeds * sheet.per_rad_s, modes.damping
    axis.set_title("Damping ratio")
    axis.set_yscale("asinh", linear_width=_LINEAR)
    low = float(np.nanmin(zeta, initial=0.0))
    axis.set_ylim(min(-0.1, 1.25 * low), 1.3)
    shown = [tick for tick in (-1, -0.5, -0.2, -0.1, -0.05, 0, 0.05, 0.1, 0.2, 0.5, 1) if tick >= axis.get_ylim()[0]]
    axis.set_yticks(shown, [f"{tick:g}".replace("-", "−") for tick in shown])
    axis.set_yticks([], minor=True)
    labels = []
    for mode, name in enumerate(modes.names):
        look = modes.look(mode)
        axis.plot(x, zeta[:, mode], **look)
        axis.plot(_at_tested(modes) * sheet.per_rad_s, _values(modes, zeta[:, mode]), **_circle(look))
        labels.append((name, zeta[-1, mode], look["color"]))
    style.end_labels(axis, labels, inside=True)
    _unstable(axis)
    _decrements(axis)


def _decrements(axis: Any) -> None:
    """The logarithmic decrement as a second scale, and its usual limit."""
    beside = axis.twinx()
    beside.set_yscale("asinh", linear_width=_LINEAR)
    beside.set_ylim(axis.get_ylim())
    ticks = [(d, _ratio(d)) for d in (-0.5, -0.2, 0, 0.2, 0.5, 1, 2, 5)]
    shown = [(d, at) for d, at in ticks if axis.get_ylim()[0] <= at <= axis.get_ylim()[1]]
    beside.set_yticks([at for _, at in shown], [f"{d:g}".replace("-", "−") for d, _ in shown])
    beside.set_yticks([], minor=True)
    beside.tick_params(labelsize=style.SMALL_TYPE)
    beside.spines[["top", "left"]].set_visible(False)
    beside.set_ylabel("logarithmic decrement")
    limit = 0.1  # decrement that is usually asked for
    axis.axhline(_ratio(limit), color=style.GREY, lw=0.8, ls=(0, (6, 2)), zorder=1.5)
    axis.text(
        0.015, _ratio(limit), f"limit δ = {limit:g}", transform=axis.get_yaxis_transform(), va="bottom",
        fontsize=style.SMALL_TYPE, color=style.GREY, path_effects=style.halo(),
    )  # fmt: skip


def _ratio(decrement: float) -> float:
    """Damping ratio of a logarithmic decrement."""
    return decrement / float(np.hypot(2 * np.pi, decrement))


def _unstable(axis: Any) -> None:
    """The half where motion grows."""
    low = axis.get_ylim()[0]
    axis.axhspan(low, 0, color=style.UNSTABLE, lw=0, zorder=0)
    axis.axhline(0, color=style.INK, lw=0.9, zorder=2)
    axis.text(
        0.015, 0.03, "unstable", transform=axis.transAxes, fontsize=style.SMALL_TYPE, color=style.CRITICAL,
        va="bottom", path_effects=style.halo(style.UNSTABLE),
    )  # fmt: skip


def _beside(sheet: style.Sheet, axis: Any, modes: _Modes) -> None:
    """Tested speeds and the threshold."""
    x = modes.speeds[-1] * sheet.per_rad_s
    axis.set(xlabel=f"shaft speed, {sheet.rate_unit}", xlim=(0, x))
    style.tested_speeds(axis, (modes.tested * sheet.per_rad_s).tolist())
    onset = modes.onset
    if onset is None:
        return
    at = onset.value * sheet.per_rad_s
    axis.axvline(at, color=style.CRITICAL, lw=1.2, zorder=2)
    words = _threshold_words(sheet, onset)
    if np.isfinite(onset.stderr):
        low, high = (end * sheet.per_rad_s for end in onset.interval(0.95))
        axis.axvspan(low, high, color=style.CRITICAL, alpha=0.15, lw=0)
    side = "left" if at < 0.25 * x else "right" if at > 0.75 * x else "center"
    axis.set_title(axis.get_title(loc="left"), pad=14)  # above the words
    axis.annotate(
        words, (at, 1), (0, 3), xycoords=("data", "axes fraction"), va="bottom",
        textcoords="offset points", ha=side, fontsize=style.SMALL_TYPE, fontweight="bold", color=style.CRITICAL,
        path_effects=style.halo(), zorder=5,
    )  # fmt: skip


def _threshold_words(sheet: style.Sheet, onset: Quantity) -> str:
    at, error = onset.value * sheet.per_rad_s, onset.stderr * sheet.per_rad_s
    return f"threshold {' ± '.join(with_error(at, error)) if np.isfinite(error) else significant(at, 4)}"


def _at_tested(modes: _Modes) -> Float:
    return modes.tested if modes.tested.size else np.zeros(0)


def _values(modes: _Modes, along: Float) -> Float:
    """What a curve has at the tested speeds."""
    return np.asarray(along[np.searchsorted(modes.speeds, modes.tested)])


def _circle(look: dict[str, Any]) -> dict[str, Any]:
    return {"marker": "o", "ls": "", "ms": 3.6, "mfc": "white", "mec": look["color"], "mew": 1.1, "zorder": 4}


def _tested_speeds(fit: FitResult, group: int) -> Float:
    """Tested speeds, rad/s, at which a group has readings."""
    if not fit.speeds.size:
        return fit.speeds
    near = [_nearest(fit.speeds, speeds_of(block, group)) for block in fit.problem.blocks]
    return np.asarray(fit.speeds[np.unique(np.concatenate(near))])


def _nearest(speeds: Float, to: Float) -> Index:
    """Which of the speeds, in ascending order, is nearest to each of others."""
    return np.searchsorted((speeds[1:] + speeds[:-1]) / 2, to)


def _modes(fit: FitResult, group: int, speeds: Float, at: int) -> tuple[ComplexArray, Index]:
    """Eigenvalues of the rotor with the causes that were found, up to the band, at each speed, and the senses of the
    modes: each column those of one mode, with the sign of its whirl at one of the speeds, in x and y one of each
    conjugate pair. A mode that does not swing there, as at rest, has the sense of its whirl at the highest speed."""
    s = eigenvalues(fit.model, np.array([theta_at(fit, group, speed) for speed in speeds.tolist()]), speeds)
    for k in range(1, len(s)):
        guess = s[k - 1] if k == 1 else 2 * s[k - 1] - s[k - 2]
        s[k] = s[k][cheapest_rows(np.nan_to_num(np.abs(s[k][:, None] - guess), nan=1e12))]
    s = np.where(np.abs(s) <= fit.stability_band, s, complex(np.nan, np.nan))
    s = s[:, np.isfinite(s).any(axis=0)]
    s = s + _shifts(fit, group, speeds, s, at)
    senseless = not (fit.model.speed_dependent or fit.model.at_one_speed)
    if fit.model.frame == "xy" or senseless:
        s = s[:, s[at].imag >= 0]
    if senseless:
        s = s[:, np.sort(np.unique(s[at].round(9), return_index=True)[1])]
    there, last = (
        whirl_sense(fit.model, theta_at(fit, group, float(speeds[k])), float(speeds[k]), s[k]) for k in (at, -1)
    )
    senses = np.where(there == 0, last, there)
    if fit.model.frame == "xy":
        s = np.asarray(s.real + 1j * np.where(senses < 0, -1.0, 1.0) * np.abs(s.imag))
    return s, senses


def _shifts(fit: FitResult, group: int, speeds: Float, s: ComplexArray, at: int) -> ComplexArray:
    """What causes beside the values of the model change of eigenvalues, as the tables of modes have it: worked out at
    some speeds, and along straight lines between them."""
    solved = fit.settings.solved
    found = np.zeros_like(s)
    if solved is None:
        return found
    places = np.unique([at, *np.linspace(0, speeds.size - 1, 21).astype(int)])
    for mode in range(s.shape[1]):
        some = places[np.isfinite(s[places, mode])]
        if some.size:
            moved = [
                eigenvalue_slopes(fit.model, theta_at(fit, group, v), v, value, solved) @ solved.errors.value
                for v, value in zip(speeds[some].tolist(), s[some, mode].tolist(), strict=True)
            ]
            found[:, mode] = np.interp(speeds, speeds[some], moved)
    return found
