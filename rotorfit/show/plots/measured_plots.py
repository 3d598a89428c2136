"""Figures of a perturbation test before any fit, a method each: ``test.plot.bode()``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

from matplotlib.figure import Figure

from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.measured_stiffness import plot_measured_stiffness


class MeasuredPlots:
    """Figures of a perturbation test, without a model; ``test.plot()`` is the dynamic stiffness."""

    def __init__(self, test: PerturbationTest) -> None:
        self._test = test

    def __call__(self, **look: Unpack[PlotKeywords]) -> Figure:
        """First look: :meth:`dynamic_stiffness`; ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`."""
        return self.dynamic_stiffness(**look)

    def dynamic_stiffness(
        self, planes: Sequence[str] | None = None, *, against: str = "frequency", **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Measured dynamic stiffness, direct and quadrature, without a model: eq. (7), or force over response.

        Force over response at each forced plane, the others free, is drawn where not all planes were forced.

        Args:
            planes: in the order of the rows, by default all.
            against: ``"frequency"``, ``"square"`` or ``"ratio"``, as for a fit's plot of the same name.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no plane that was both forced and read, or no such abscissa.

        Example:
            >>> len(rig.plot.dynamic_stiffness(["disk", "journal"], against="square").axes)
            8
        """
        return plot_measured_stiffness(self._test, planes, against, **look)
