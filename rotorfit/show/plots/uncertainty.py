"""Figures of the samples of a posterior, drawn from plain arrays."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from rotorfit.base.array_types import Float
from rotorfit.base.digits import with_error
from rotorfit.base.names import unknown_name
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.models.parameters import bare_name
from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.journal import rig_of
from rotorfit.show.plots.style import (
    COLOURS,
    CRITICAL,
    PAGE,
    REGIONS,
    SMALL_TYPE,
    TYPE,
    Sheet,
    few_ticks,
    literal,
    on_sheet,
)

_LABEL = SMALL_TYPE
_FLUID = ("D", "lam", "lam_D", "lam_M", "Mf", "K0")
_MOST = 6
"""Parameters that a corner plot shows on a page."""


def corner_names(names: Sequence[str], samples: Float) -> list[str]:
    """Parameters that a corner plot shows unless others are named, in their order: all or the fluid's where a page has
    room for them, else those most correlated with any other, the fluid's before."""
    if len(names) <= _MOST:
        return list(names)
    if 1 < len(of_fluid := [name for name in names if bare_name(name) in _FLUID]) <= _MOST:
        return of_fluid
    together = np.abs(np.corrcoef(samples, rowvar=False)) - np.eye(len(names))
    rank = {name: (bare_name(name) not in _FLUID, -together[i].max()) for i, name in enumerate(names)}
    chosen = sorted(names, key=rank.__getitem__)[:_MOST]
    return [name for name in names if name in chosen]


@on_sheet
def plot_corner(
    samples: Float,
    names: Sequence[str],
    truths: Mapping[str, float] | None = None,
    *,
    sheet: Sheet,
    title: str = "",
    reads: Sequence[str] = (),
) -> Figure:
    """Marginal densities with their 95 % interval, regions of 68 and 95 % of pairs below, correlations above."""
    count = len(names)
    side = min(PAGE[0] / count, 1.8)
    figure, axes = sheet.grid(count, count, title, size=(side, side), reads=reads)
    # Inches from panel to panel of a corner plot at least: of many parameters it is larger than a page.
    narrowest = 0.88
    width, height = np.maximum(figure.get_size_inches(), narrowest * count)
    figure.set_size_inches(width, height)
    marks = truths or {}
    # Points between the numbers along x and their label: the offset that the numbers share stands there
    room_for_offset = SMALL_TYPE + 4
    together = np.atleast_2d(np.corrcoef(samples, rowvar=False))
    for i, j in np.ndindex(count, count):
        axis = axes[i, j]
        axis.grid(visible=False)
        if j > i:
            _correlation(axis, float(together[i, j]))
            continue
        truth = (marks.get(names[j]), marks.get(names[i]))
        if i == j:
            _marginal(axis, samples[:, i], truth[0])
            mean, spread = float(samples[:, i].mean()), float(samples[:, i].std())
            bare, numbers = names[i].partition(",")[0], with_error(mean, spread)
            words = f"{literal(bare)}\n{numbers[0]} ± {numbers[1]}"
            axis.set_title(words, loc="center", fontsize=SMALL_TYPE)
        else:
            _density(axis, samples[:, j], samples[:, i])
            if None not in truth:
                axis.plot(*truth, "+", color=CRITICAL, ms=8, mew=1.5)
        axis.tick_params(labelsize=SMALL_TYPE, labelleft=j == 0 and i > 0, labelbottom=i == count - 1)
        few_ticks(axis.xaxis, 3)
        # Powers of ten that are written out: with a factor, what all numbers have in common is wider than a panel.
        axis.ticklabel_format(scilimits=(-8, 8))
        for side in (axis.xaxis, axis.yaxis):
            side.get_offset_text().set_fontsize(SMALL_TYPE)
        if i != j:
            few_ticks(axis.yaxis, 3)
        if j == 0 and i > 0:
            axis.set_ylabel(_in_lines(names[i], height / count), fontsize=_LABEL)
        if i == count - 1:
            axis.set_xlabel(_in_lines(names[j], width / count), fontsize=_LABEL, labelpad=room_for_offset)
            for number in axis.get_xticklabels() if count > _MOST else ():
                number.set(rotation=45, rotation_mode="anchor", horizontalalignment="right")
    return figure


def _in_lines(name: str, room: float) -> str:
    """A label in lines that fit beside a panel, parted where its words end."""
    letter = 0.62  # mean width of a letter, ems
    filled = 0.66  # share of the room from panel to panel that a label may take
    longest = max(int(filled * room * 72 / (letter * _LABEL)), 1)
    lines = [""]
    for word in re.findall(r"\[?[^\s,=\[_]*[\s,=_]*", name):
        for part in (word[k : k + longest] for k in range(0, len(word), longest)):
            if len(lines[-1] + part.rstrip()) > longest:
                lines.append("")
            lines[-1] += part
    return literal("\n".join(line.strip() for line in lines))


def _correlation(axis: Any, value: float) -> None:
    """A correlation as a number on a tint of its sign."""
    axis.set(xticks=[], yticks=[], facecolor=(CRITICAL if value < 0 else COLOURS[0], 0.35 * abs(value)))
    axis.spines[:].set_visible(False)
    axis.text(0.5, 0.5, f"{value:+.2f}".replace("-", "−"), ha="center", va="center", transform=axis.transAxes,
              fontsize=TYPE)  # fmt: skip


_SMOOTHED = 1.2
"""Standard deviation of what smooths counts, bins: chosen, narrow beside the 10 bins or so of a standard deviation."""


def _marginal(axis: Any, values: Float, truth: float | None) -> None:
    """A smoothed histogram, darker where 95 % lie."""
    counts, edges = np.histogram(values, bins=60)
    height, centres = gaussian_filter1d(counts.astype(float), 2 * _SMOOTHED), (edges[1:] + edges[:-1]) / 2
    low, high = np.quantile(values, [0.025, 0.975])
    axis.fill_between(centres, height, color=COLOURS[0], alpha=0.15, lw=0)
    axis.fill_between(centres, height, where=(centres >= low) & (centres <= high), color=COLOURS[0], alpha=0.3, lw=0)
    axis.plot(centres, height, color=COLOURS[0], lw=1.3)
    axis.set(yticks=[], ylim=(0, None))
    axis.spines["left"].set_visible(False)
    if truth is not None:
        axis.axvline(truth, color=CRITICAL, lw=1.2, ls="--")


def _density(axis: Any, x: Float, y: Float) -> None:
    """Regions of 68 and 95 %."""
    counts, xe, ye = np.histogram2d(x, y, bins=36)
    counts = gaussian_filter(counts, _SMOOTHED)
    order = np.sort(counts.ravel())[::-1]
    mass = np.cumsum(order) / order.sum()
    outer, inner = (float(order[np.searchsorted(mass, level)]) for level in (0.95, 0.68))
    centres = (xe[1:] + xe[:-1]) / 2, (ye[1:] + ye[:-1]) / 2
    if 0 < outer < inner < order[0]:
        axis.contourf(*centres, counts.T, levels=[outer, inner, order[0]], colors=REGIONS)
        axis.contour(*centres, counts.T, levels=[outer, inner], colors=COLOURS[0], linewidths=0.8)


@on_sheet
def plot_traces(chain: Float, names: Sequence[str], *, sheet: Sheet) -> Figure:
    """Walkers of a chain against the step, one row a parameter."""
    figure, axes = sheet.grid(len(names), 1, "Chains", size=(7.5, 0.9))
    shown = chain[:, :: max(1, chain.shape[1] // 24)]
    for i, name in enumerate(names):
        axes[i, 0].plot(shown[:, :, i], lw=0.3, color=COLOURS[0], alpha=0.5)
        axes[i, 0].set_ylabel(literal(name), fontsize=7, rotation=0, ha="right", va="center")
        axes[i, 0].tick_params(labelsize=SMALL_TYPE, labelbottom=i == len(names) - 1)
    axes[-1, 0].set_xlabel("step", fontsize=8)
    return figure


class PosteriorPlots:
    """Figures of a posterior, a method each; ``posterior.plot()`` is the corner plot."""

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def __call__(self, **look: Unpack[PlotKeywords]) -> Figure:
        """First look: :meth:`corner`; ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`."""
        return self.corner(**look)

    def corner(
        self,
        *,
        var_names: Sequence[str] | None = None,
        truths: Mapping[str, float] | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Marginal and pairwise densities, the optimum of the fit marked.

        Args:
            var_names: parameters that are drawn, by default up to six: all, the fluid's, or those most correlated.
            truths: values by name that are marked in place of the optimum.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            KeyError: a name that the posterior has not; the message names the nearest.
        """
        posterior, fit = self._posterior, self._posterior.fit
        shown = list(corner_names(posterior.names, posterior.samples) if var_names is None else var_names)
        marked = dict(zip(fit.var_names, fit.x.tolist(), strict=True)) if truths is None else truths
        for name in (*shown, *(truths or {})):
            if name not in posterior.names:
                raise KeyError(unknown_name("parameter of the posterior", name, posterior.names))
        units = {name: posterior.unit(name) for name in shown}
        labels = {name: name if unit == "1" else f"{name}, {unit}" for name, unit in units.items()}
        samples = posterior.samples[:, [posterior.names.index(name) for name in shown]]
        marks = {labels[name]: float(value) for name, value in marked.items() if name in labels}
        beside = "causes beside the model included" if posterior.settings.causes else "noise alone"
        reads = (
            f"Regions: 68 and 95 %. Red: {'the optimum of the fit' if truths is None else 'values given'}. "
            f"Numbers: mean ± standard deviation, {beside}. Above the diagonal: correlation.",
            f"{len(shown)} of {len(posterior.names)} fitted values; the others are left out, not fixed."
            if len(shown) < len(posterior.names)
            else "",
        )
        title = f"{rig_of(fit)}: posterior"
        return plot_corner(samples, list(labels.values()), marks, title=title, reads=reads, **look)

    def traces(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Walkers against the step.

        Args:
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.
        """
        return plot_traces(self._posterior.chain, self._posterior.names, **look)
