"""Spectra of a machine in operation, forward and backward, with the fit, and how the two are related."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.digits import plus_minus
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.operating import OperatingSpectra, unpacked
from rotorfit.identify.fitting.headline import decrement_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.modes import Mode
from rotorfit.lab.kinds.operating_test import OperatingTest
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import rig_of

_POINTS = (
    "Two-sided spectra of x + jy, forward right of zero, backward left. Points: averages over cells of frequencies."
)
_LINES = "Lines: fit, in a pale band that 95 % of the points lie in; δ: logarithmic decrement of its modes."
_MASKED = "Grey: left out, as orders of the shaft or lines that stand out."
_COHERENCE = (
    "Share of the motion backward at −w that goes with that forward at w, times the degrees of freedom: 1 where a",
    "round rotor is shaken alike in x and y. Points: means of 20 cells; pale: 95 % of such means by chance alone.",
)
_CELLS = 20  # cells that a point of the coherence averages
_NAMED = 0.4  # damping ratio up to which a mode has a peak that can be named


@dataclass(frozen=True, eq=False, kw_only=True)
class _Spectra:
    """Spectra of one recording, and those of the fit."""

    run: str
    speed: float  # rad/s
    planes: tuple[str, ...]
    frequency: Float  # of cells, rad/s, positive, shape ``(C,)``
    measured: ComplexArray  # of ``[z(w); conj z(-w)]``, m^2/Hz, shape ``(C, 2n, 2n)``
    freedom: Float  # shape ``(C,)``
    fitted: ComplexArray | None = None

    def root(self, power: ComplexArray, plane: str) -> Float:
        """Root of a plane's spectrum over signed frequency, m per root Hz, shape ``(2C,)``."""
        n, at = len(self.planes), self.planes.index(plane)
        forward, backward = power[:, at, at].real, power[:, n + at, n + at].real
        return np.asarray(np.sqrt(np.concatenate([backward[::-1], forward])))

    @property
    def signed(self) -> Float:
        """Signed frequencies, rad/s, ascending."""
        return np.concatenate([-self.frequency[::-1], self.frequency])

    @property
    def masked(self) -> list[tuple[float, float]]:
        """Frequencies between cells from and to which there is none, rad/s."""
        step = np.diff(self.frequency)
        width = float(np.median(step))
        gaps = np.flatnonzero(step > 1.5 * width)
        return [(float(self.frequency[k] + width / 2), float(self.frequency[k + 1] - width / 2)) for k in gaps]


@style.on_sheet
def plot_measured_spectra(test: OperatingTest, *, sheet: style.Sheet) -> Figure:
    """Two-sided spectra of every plane of a test."""
    return _spectra(sheet, list(_of_test(test)), "Operating vibration", (_POINTS, _MASKED))


@style.on_sheet
def plot_spectra(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Two-sided spectra of every plane with those of the fit."""
    spectra = _of_fit(fit)
    title = f"{rig_of(fit)}: operating vibration"
    return _spectra(sheet, spectra, title, (_POINTS, _LINES, _MASKED), _modes(fit, spectra))


@style.on_sheet
def plot_spectrum(fit: FitResult, plane: str | None = None, *, sheet: style.Sheet) -> Figure:
    """The spectrum of one plane, by default the last: the half figure of a first screen."""
    spectra = _of_fit(fit)
    planes = _planes(spectra)
    if plane is not None and plane not in planes:
        raise ValueError(unknown_name("plane", plane, planes))
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    style.panel_title(axis, style.literal(f"Spectrum at the {plane or planes[-1]}"))
    _panel(sheet, axis, spectra, plane or planes[-1], _modes(fit, spectra))
    axis.set_xlabel(f"frequency, {sheet.rate_unit} (negative: backward)")
    return figure


@style.on_sheet
def plot_spectrum_misfit(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Spectra of all planes less those of the fit, over their noise: the half figure of a fit that is not good."""
    spectra = _of_fit(fit)
    figure, ((axis,),) = sheet.grid(1, 1, "", size=style.HALF)
    labels = []
    for number, plane in enumerate(_planes(spectra)):
        shown = [one for one in spectra if plane in one.planes]
        off = [_off(one, plane) for one in shown]
        x = np.concatenate([one.signed for one in shown]) * sheet.per_rad_s
        colour, marker = style.colour_of(number, len(_planes(spectra))), style.MARKERS[number % len(style.MARKERS)]
        axis.plot(x, np.concatenate(off), marker, color=colour, ms=2.2, alpha=0.6, mew=0)
        labels.append((style.literal(plane), float(np.median(np.concatenate(off))), colour))
    style.misfit_panel(axis)
    style.end_labels(axis, labels if labels[1:] else [])
    axis.set_xlabel(f"frequency, {sheet.rate_unit} (negative: backward)")
    return figure


def _off(one: _Spectra, plane: str) -> Float:
    """A plane's spectrum less that of the fit, over the noise of its cells."""
    if one.fitted is None:
        raise ValueError("these spectra have no fit")
    freedom = np.concatenate([one.freedom[::-1], one.freedom])
    measured, fitted = one.root(one.measured, plane) ** 2, one.root(one.fitted, plane) ** 2
    return np.asarray((measured / fitted - 1) * np.sqrt(freedom))


@style.on_sheet
def plot_coherence(test: OperatingTest, *, sheet: style.Sheet) -> Figure:
    """Coherence of motion forward and backward at every plane against frequency."""
    spectra = list(_of_test(test))
    planes = _planes(spectra)
    figure, axes = sheet.grid(len(planes), 1, "Rotary coherence", size=(7.08, 1.9), one_abscissa=True, reads=_COHERENCE)
    for axis, plane in zip(axes[:, 0], planes, strict=True):
        style.panel_title(axis, style.literal(plane))
        half = 1.96 / np.sqrt(_CELLS)  # of means of numbers that are exponential by chance
        axis.axhspan(1 - half, 1 + half, color=style.GRID, lw=0, zorder=0)
        axis.axhline(1.0, color=style.INK, lw=0.8)
        for k, one in enumerate(spectra):
            if plane in one.planes:
                x, shared = _coherence(one, plane)
                axis.plot(x * sheet.per_rad_s, shared, "o", ms=3, color=style.colour_of(k, len(spectra)))
        axis.set_ylim(0, None)
        axis.set_ylabel("freedom × coherence")
    axes[-1, 0].set_xlabel(f"frequency, {sheet.rate_unit}")
    _name_runs(sheet, figure, spectra)
    return figure


def _coherence(one: _Spectra, plane: str) -> tuple[Float, Float]:
    """Frequencies, rad/s, and the coherence there times the degrees of freedom, each a mean of some cells."""
    n, at, count = len(one.planes), one.planes.index(plane), one.frequency.size // _CELLS
    forward, backward = one.measured[:, at, at].real, one.measured[:, n + at, n + at].real
    shared = one.freedom * np.abs(one.measured[:, at, n + at]) ** 2 / (forward * backward)
    kept = np.arange(count * _CELLS).reshape(count, _CELLS)
    return one.frequency[kept].mean(axis=1), shared[kept].mean(axis=1)


def _planes(spectra: Sequence[_Spectra]) -> list[str]:
    return list(dict.fromkeys(plane for one in spectra for plane in one.planes))


def _of_test(test: OperatingTest) -> Iterator[_Spectra]:
    for run, speed in dict.fromkeys(zip(test.run.tolist(), test.speed.tolist(), strict=True)):
        own = test.select(np.flatnonzero((test.run == run) & (test.speed == speed)))
        first, matrix = own.matrices(own.planes)
        order = np.argsort(own.frequency[first])
        yield _Spectra(
            run=run,
            speed=speed,
            planes=own.planes,
            frequency=own.frequency[first][order],
            measured=matrix[order],
            freedom=own.freedom[first][order],
        )


def _of_fit(fit: FitResult) -> list[_Spectra]:
    found = []
    for block, predicted in zip(fit.problem.blocks, fit.problem.predict(fit.x), strict=True):
        if not isinstance(block, OperatingSpectra):
            continue
        planes = tuple(fit.model.coordinates[at].plane for at in block.coordinate)
        measured, fitted = unpacked(block.measured, block.m), unpacked(predicted, block.m)
        runs = block.run[:: block.m**2 // 2]
        for run, speed in dict.fromkeys(zip(runs.tolist(), block.speed.tolist(), strict=True)):
            own = np.flatnonzero((runs == run) & (block.speed == speed))
            own = own[np.argsort(block.frequency[own])]
            found.append(
                _Spectra(
                    run=run,
                    speed=speed,
                    planes=planes,
                    frequency=block.frequency[own],
                    measured=measured[own],
                    freedom=block.nu[own],
                    fitted=fitted[own],
                )
            )
    if not found:
        raise ValueError("this fit has no spectra of a machine in operation; fit.plot() draws what it has")
    return found


def _modes(fit: FitResult, spectra: Sequence[_Spectra]) -> Sequence[Mode]:
    """Modes whose decrements are written, the least damped first; at several speeds there are too many."""
    if len(spectra) > 1:
        return ()
    return sorted(fit.modes(spectra[0].speed), key=lambda mode: mode.damping_ratio.value)


def _spectra(
    sheet: style.Sheet, spectra: Sequence[_Spectra], title: str, reads: Sequence[str], modes: Sequence[Mode] = ()
) -> Figure:
    planes = _planes(spectra)
    figure, axes = sheet.grid(len(planes), 1, title, size=(7.08, 2.5), one_abscissa=True, reads=reads)
    for axis, plane in zip(axes[:, 0], planes, strict=True):
        style.panel_title(axis, style.literal(plane))
        _panel(sheet, axis, spectra, plane, modes)
    axes[-1, 0].set_xlabel(f"frequency, {sheet.rate_unit} (negative: backward)")
    _name_runs(sheet, figure, spectra)
    return figure


def _panel(sheet: style.Sheet, axis: Any, spectra: Sequence[_Spectra], plane: str, modes: Sequence[Mode]) -> None:
    """The spectra of a plane."""
    factor, unit = sheet.position_unit
    shown = {k: one for k, one in enumerate(spectra) if plane in one.planes}
    for k, one in shown.items():
        _curve(sheet, axis, one, plane, style.colour_of(k, len(spectra)))
    axis.set_yscale("log")
    style.decade_ticks(axis.yaxis)
    sizes = np.concatenate([_typical(one, plane) for one in shown.values()]) * factor
    axis.set_ylim(sizes.min() / 1.6, 4.0 * sizes.max())
    end = max(one.frequency[-1] for one in shown.values()) * sheet.per_rad_s
    axis.set_xlim(-1.01 * end, 1.01 * end)
    axis.set_ylabel(f"{unit} per root Hz")
    if len(spectra) == 1:
        _mark_masked(sheet, axis, spectra[0])
        _name_modes(sheet, axis, spectra[0], plane, modes)


def _typical(one: _Spectra, plane: str) -> Float:
    """What the limits of a panel are made of: the fit, or the measured spectra smoothed."""
    if one.fitted is not None:
        return one.root(one.fitted, plane)
    cells = min(_CELLS, one.frequency.size)
    return np.convolve(one.root(one.measured, plane), np.full(cells, 1 / cells), "valid")


def _curve(sheet: style.Sheet, axis: Any, one: _Spectra, plane: str, colour: str) -> None:
    factor, x = sheet.position_unit[0], one.signed * sheet.per_rad_s
    axis.scatter(x, one.root(one.measured, plane) * factor, s=5, lw=0, color=colour, alpha=0.35, zorder=2)
    if one.fitted is None:
        return
    fitted = one.root(one.fitted, plane) * factor
    chance = 1.96 / np.sqrt(np.concatenate([one.freedom[::-1], one.freedom]))
    gaps = np.flatnonzero(np.diff(one.signed) > 3 * np.median(np.diff(one.frequency))) + 1
    for part in np.split(np.arange(x.size), gaps):
        low = fitted[part] * np.sqrt(np.maximum(1 - chance[part], 0))
        axis.fill_between(x[part], low, fitted[part] * np.sqrt(1 + chance[part]), color=colour, alpha=0.15, lw=0)
        axis.plot(x[part], fitted[part], color=style.INK if colour == style.COLOURS[0] else colour, lw=1.3, zorder=3)


def _mark_masked(sheet: style.Sheet, axis: Any, one: _Spectra) -> None:
    """What is left out, orders of the shaft by their number."""
    for low, high in one.masked:
        order = (low + high) / 2 / one.speed
        number = round(order)
        for way in (1, -1):
            axis.axvspan(way * low * sheet.per_rad_s, way * high * sheet.per_rad_s, color=style.GRID, lw=0, zorder=1)
            if number and abs(order - number) * one.speed < high - low:
                side = "left" if way > 0 else "right"
                axis.annotate(
                    f"{number}×", (way * (low + high) / 2 * sheet.per_rad_s, 1), (3 * way, -2),
                    xycoords=("data", "axes fraction"), textcoords="offset points", ha=side, va="top",
                    fontsize=style.SMALL_TYPE, color=style.GREY,
                )  # fmt: skip


def _name_modes(sheet: style.Sheet, axis: Any, one: _Spectra, plane: str, modes: Sequence[Mode]) -> None:
    """Logarithmic decrements at the peaks of modes, of the least damped where several share one."""
    if one.fitted is None:
        return
    curve, named = one.root(one.fitted, plane) * sheet.position_unit[0], list[float]()
    for mode in modes:
        ratio, w = mode.damping_ratio, mode.frequency.value
        near = np.abs(one.signed - w) < 0.1 * one.frequency[-1]
        beside = any(abs(w - other) < 0.2 * one.frequency[-1] for other in named)
        if beside or not (0 < ratio.value < _NAMED and near.any()):
            continue
        named.append(w)
        decrement, top = decrement_of(ratio), np.argmax(np.where(near, curve, 0))
        words = plus_minus(decrement.value, decrement.stderr)
        axis.annotate(
            f"δ {words.replace('+-', '±')}", (one.signed[top] * sheet.per_rad_s, curve[top]), (0, 5),
            textcoords="offset points", ha="center", va="bottom", fontsize=style.SMALL_TYPE, color=style.INK,
            path_effects=style.halo(), zorder=5,
        )  # fmt: skip


def _name_runs(sheet: style.Sheet, figure: Figure, spectra: Sequence[_Spectra]) -> None:
    """Recordings by their speeds, or by their names where speeds are the same."""
    if len(spectra) < 2:
        return
    speeds = [sheet.rate_words(one.speed) for one in spectra]
    names = speeds if len(set(speeds)) == len(speeds) else [style.literal(one.run) for one in spectra]
    looks = style.in_colours(names)
    entries = [(name, look["color"], "o") for name, look in looks.items()]
    if len(names) > len(style.COLOURS) or not style.key_beside_title(figure, entries):
        style.legend_below(figure, {name: {**look, "marker": "o", "ls": ""} for name, look in looks.items()})
