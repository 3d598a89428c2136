"""Figures of the samples of a posterior, drawn from plain arrays."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.style import COLOURS, SMALL_TYPE, Sheet, few_ticks, literal, on_sheet

_LABEL = SMALL_TYPE


@on_sheet
def plot_corner(
    samples: Float, names: Sequence[str], truths: Mapping[str, float] | None = None, *, sheet: Sheet
) -> Figure:
    """Marginal histograms and pairwise densities with 68 and 95 % contours."""
    count = len(names)
    figure, axes = sheet.grid(count, count, "", size=(1.25, 1.2))
    # Inches from panel to panel of a corner plot at least: of many parameters it is larger than a page.
    narrowest = 0.88
    width, height = np.maximum(figure.get_size_inches(), narrowest * count)
    figure.set_size_inches(width, height)
    marks = truths or {}
    # Points between the numbers along x and their label: the offset that the numbers share stands there
    room_for_offset = SMALL_TYPE + 4
    for i in range(count):
        for j in range(count):
            axis = axes[i, j]
            if j > i:
                axis.set_visible(False)
                continue
            axis.grid(visible=False)
            if i == j:
                _marginal(axis, samples[:, i])
            else:
                _density(axis, samples[:, j], samples[:, i])
            if names[j] in marks:
                axis.axvline(marks[names[j]], color=COLOURS[1], lw=0.9)
            if i != j and names[i] in marks:
                axis.axhline(marks[names[i]], color=COLOURS[1], lw=0.9)
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
                for number in axis.get_xticklabels():
                    number.set(rotation=45, rotation_mode="anchor", horizontalalignment="right")
    return figure


def _in_lines(name: str, room: float) -> str:
    """A label in lines that fit beside a panel, parted where its words end."""
    letter = 0.62  # mean width of a letter, ems
    filled = 0.75  # share of the room from panel to panel that a label may take
    longest = max(int(filled * room * 72 / (letter * _LABEL)), 1)
    lines = [""]
    for word in re.findall(r"\[?[^\s,=\[_]*[\s,=_]*", name):
        for part in (word[k : k + longest] for k in range(0, len(word), longest)):
            if len(lines[-1] + part.rstrip()) > longest:
                lines.append("")
            lines[-1] += part
    return literal("\n".join(line.strip() for line in lines))


def _marginal(axis: Any, values: Float) -> None:
    axis.hist(values, bins=40, density=True, color=COLOURS[0], alpha=0.6, histtype="stepfilled")
    axis.set_yticks([])
    for q in np.quantile(values, [0.025, 0.975]):
        axis.axvline(q, color="0.4", lw=0.7, ls=":")


def _density(axis: Any, x: Float, y: Float) -> None:
    counts, xe, ye = np.histogram2d(x, y, bins=28)
    order = np.sort(counts.ravel())[::-1]
    mass = np.cumsum(order) / order.sum()
    levels = sorted({float(order[np.searchsorted(mass, level)]) for level in (0.68, 0.95)})
    centres = (xe[1:] + xe[:-1]) / 2, (ye[1:] + ye[:-1]) / 2
    axis.pcolormesh(xe, ye, counts.T, cmap="Blues", rasterized=True)
    if levels[0] > 0:
        axis.contour(*centres, counts.T, levels=levels, colors="0.25", linewidths=0.7)


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
            var_names: parameters that are drawn, all by default.
            truths: values by name that are marked in place of the optimum.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            KeyError: a name that the posterior has not; the message names the nearest.
        """
        posterior, fit = self._posterior, self._posterior.fit
        shown = list(posterior.names if var_names is None else var_names)
        marked = dict(zip(fit.var_names, fit.x.tolist(), strict=True)) if truths is None else truths
        for name in (*shown, *(truths or {})):
            if name not in posterior.names:
                raise KeyError(unknown_name("parameter of the posterior", name, posterior.names))
        units = {name: posterior.unit(name) for name in shown}
        labels = {name: name if unit == "1" else f"{name}, {unit}" for name, unit in units.items()}
        samples = posterior.samples[:, [posterior.names.index(name) for name in shown]]
        marks = {labels[name]: float(value) for name, value in marked.items() if name in labels}
        return plot_corner(samples, list(labels.values()), marks, **look)

    def traces(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Walkers against the step.

        Args:
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.
        """
        return plot_traces(self._posterior.chain, self._posterior.names, **look)
