"""Figures of a test before any fit, a method each: ``test.plot.bode()``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

from matplotlib.figure import Figure

from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.kinds.operating_test import OperatingTest
from rotorfit.show.plots.bode import plot_measured_bode
from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.measured_stiffness import plot_measured_stiffness
from rotorfit.show.plots.operating import plot_coherence, plot_measured_spectra
from rotorfit.show.plots.responses import plot_measured_polar


class MeasuredPlots:
    """Figures of a perturbation test, without a model; ``test.plot()`` is the Bode plot."""

    def __init__(self, test: PerturbationTest) -> None:
        self._test = test

    def __call__(self, **look: Unpack[PlotKeywords]) -> Figure:
        """First look: :meth:`bode`; ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`."""
        return self.bode(**look)

    def bode(self, *, against: str = "frequency", mr: float | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Amplitude and phase of every measured response, in the panels of a fit's Bode plot.

        Of each pair of probes it is the component in the direction of the force; a single probe is taken for one of a
        circular orbit.

        Args:
            against, mr: as for :meth:`rotorfit.FitResult.plot.bode`.
            **look: ``ax`` and ``unit``, as there.

        Raises:
            ValueError: no such abscissa or unit, a ratio to a speed that is swept, or no force.

        Example:
            >>> len(rig.plot.bode(unit="hz").axes)
            8
        """
        return plot_measured_bode(self._test, against=against, mr=mr, **look)

    def polar(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Measured responses in the complex plane; ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`."""
        return plot_measured_polar(self._test, **look)

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


class OperatingPlots:
    """Figures of a machine in operation, without a model; ``test.plot()`` is its spectra."""

    def __init__(self, test: OperatingTest) -> None:
        self._test = test

    def __call__(self, **look: Unpack[PlotKeywords]) -> Figure:
        """First look: :meth:`spectra`; ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`."""
        return self.spectra(**look)

    def spectra(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Two-sided spectra of every plane, forward and backward, with what was left out.

        ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.
        """
        return plot_measured_spectra(self._test, **look)

    def coherence(self, **look: Unpack[PlotKeywords]) -> Figure:
        """How much of the motion backward goes with that forward: supports or forces that are not round show.

        ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.
        """
        return plot_coherence(self._test, **look)
