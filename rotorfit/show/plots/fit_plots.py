"""Figures of a fit, a method each: ``fit.plot.bode()``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

from matplotlib.figure import Figure

from rotorfit.base.units import in_rad_s
from rotorfit.identify.fitting.result import FitResult
from rotorfit.show.plots.beyond_onset import plot_side_load, plot_whirl
from rotorfit.show.plots.bode import plot_bode, plot_drive_point
from rotorfit.show.plots.budget import plot_budget
from rotorfit.show.plots.coefficients import coefficients, frequency_coefficients, whirl_ratio
from rotorfit.show.plots.dynamic_stiffness import plot_dynamic_stiffness, plot_quadrature
from rotorfit.show.plots.eccentricity import plot_law, plot_nonlinear_stiffness, plot_relative_law
from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.figure_table import figures_of
from rotorfit.show.plots.modal import plot_mode_shapes, plot_stabilisation
from rotorfit.show.plots.operating import plot_spectra, plot_spectrum, plot_spectrum_misfit
from rotorfit.show.plots.responses import plot_largest_response, plot_misfit, plot_polar, plot_residuals
from rotorfit.show.plots.shaft_lines import plot_growth, plot_line, plot_line_misfit, plot_lines
from rotorfit.show.plots.stability import plot_damping, plot_stability
from rotorfit.show.plots.static_and_impulse import plot_static_locus, plot_static_stiffness, plot_velocity_ratio


class FitPlots:
    """Figures of a fit; ``fit.plot()`` is the first that the report shows."""

    def __init__(self, fit: FitResult) -> None:
        self._fit = fit

    def __call__(self, **look: Unpack[PlotKeywords]) -> Figure:
        """First look: the first figure that a report shows; ``ax`` and ``unit`` as for :meth:`bode`."""
        first, *_ = [*(figure.name for figure in figures_of(self._fit)), "stability"]
        drawn: Figure = getattr(self, first)(**look)
        return drawn

    def dynamic_stiffness(
        self, *, against: str = "frequency", every: bool = False, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Direct and quadrature dynamic stiffness against signed frequency, data with error bars and fit.

        Args:
            against: ``"frequency"``, ``"square"`` (the direct part against the square of the frequency: straight lines,
                as in Figs 6, 25 and 36) or ``"ratio"`` (frequency over rotative speed).
            every: of more than three planes draw the whole matrix; otherwise its diagonal.
            **look: ``ax`` and ``unit``, as for :meth:`bode`.

        Raises:
            ValueError: no such abscissa or unit, or a ratio to a speed that is swept.

        Example:
            >>> fit.plot.dynamic_stiffness().savefig(folder / "stiffness.png")
        """
        return plot_dynamic_stiffness(self._fit, against=against, every=every, **look)

    def bode(
        self,
        *,
        against: str = "frequency",
        mr: float | None = None,
        beside: FitResult | None = None,
        every: bool = False,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Amplitude and phase of responses against frequency.

        Args:
            against: ``"frequency"``, signed; ``"ratio"``, that over the rotative speed (Fig. 9); ``"size"``, forward
                and backward over one another (Fig. 8).
            mr: an unbalance, kg m, for which amplitudes are drawn in place of those per unit force.
            beside: another rotor, of :meth:`rotorfit.FitResult.what_if`, whose lines are drawn dotted.
            every: of more than three planes draw all responses; otherwise those at the forces, and those of the planes
                in the fluid.
            **look: ``ax``: axes to draw in, one or as many as the figure has panels; one place for several panels is
                divided, and a figure or subfigure filled. ``unit``: of frequencies (``"rpm"``, ``"hz"``, ``"rad_s"``),
                of lengths (``"um"``, ``"mil_pp"``, ``"mm"``), or both, ``("hz", "mil_pp")``.

        Returns:
            a matplotlib figure: ``set_size_inches``, ``suptitle``, and of its ``axes`` ``set_xlim``, ``set_title`` and
            the like change it as any other.

        Raises:
            ValueError: no such abscissa or unit, a ratio to a speed that is swept, or axes that are too many or few.

        Example:
            >>> fit.plot.bode(against="size", unit="hz").savefig(folder / "bode.png")
        """
        return plot_bode(self._fit, against=against, mr=mr, beside=beside, every=every, **look)

    def drive_point(self, *, plane: str | None = None, mr: float | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Phase, amplitude and dynamic stiffness of a forced plane above one another, a colour a condition (Fig. 11).

        Args:
            plane: one that was forced and read, the last unless given.
            mr: an unbalance, kg m, for which amplitudes are drawn.
            **look: ``ax`` and ``unit``, as for :meth:`bode`.

        Raises:
            ValueError: no such plane.

        Example:
            >>> len(fit.plot.drive_point(plane="journal").axes)
            4
        """
        return plot_drive_point(self._fit, plane=plane, mr=mr, **look)

    def polar(self, *, every: bool = False, **look: Unpack[PlotKeywords]) -> Figure:
        """Responses in the complex plane; ``every``, ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_polar(self._fit, every=every, **look)

    def residuals(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Whitened residuals against frequency; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_residuals(self._fit, **look)

    def lines(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Lines of an uneven shaft and its twist against frequency; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_lines(self._fit, **look)

    def line(self, **look: Unpack[PlotKeywords]) -> Figure:
        """The line that an uneven shaft adds, with its fit, in one panel; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_line(self._fit, **look)

    def growth(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Growth rate of an uneven shaft's least damped mode; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_growth(self._fit, **look)

    def line_misfit(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Residuals of all lines over their noise; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_line_misfit(self._fit, **look)

    def spectra(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Two-sided spectra of a machine in operation, forward and backward, with those of the fit and its decrements.

        ``ax`` and ``unit`` are as for :meth:`bode`.

        Raises:
            ValueError: a fit without operating vibration.
        """
        return plot_spectra(self._fit, **look)

    def spectrum(self, *, plane: str | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """One of :meth:`spectra`, that of ``plane``, by default the last; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_spectrum(self._fit, plane, **look)

    def spectrum_misfit(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Residuals of all spectra over their noise; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_spectrum_misfit(self._fit, **look)

    def stability(self, *, beside: FitResult | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Eigenvalues against speed, threshold with its interval; ``beside``, of :meth:`rotorfit.FitResult.what_if`, is
        drawn dashed; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_stability(self._fit, beside=beside, **look)

    def quadrature(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Quadrature stiffness at the fluid's plane against frequency; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_quadrature(self._fit, **look)

    def damping(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Damping ratio of the whirl modes against speed; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_damping(self._fit, **look)

    def budget(self, **look: Unpack[PlotKeywords]) -> Figure:
        """What the error of each result is made of; ``ax`` and ``unit`` as for :meth:`bode`.

        Raises:
            ValueError: a fit without causes, whose errors are all noise.

        Example:
            >>> len(fit.plot.budget().axes)
            1
        """
        return plot_budget(self._fit, **look)

    def largest_response(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Amplitude of the largest response in one panel, with the fit; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_largest_response(self._fit, **look)

    def misfit(self, **look: Unpack[PlotKeywords]) -> Figure:
        """All residuals over their noise in one panel; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_misfit(self._fit, **look)

    def whirl_ratio(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Whirl frequency ratio of a seal or bearing against speed; ``ax`` and ``unit`` as for :meth:`bode`."""
        return whirl_ratio(self._fit.coefficient_table(), **look)

    def whirl(
        self,
        *,
        max_speed: float | None = None,
        max_speed_rpm: float | None = None,
        group: int = 0,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Radius and frequency of the whirl that the rotor keeps up beyond its threshold, against speed, with a band.

        ``max_speed``, rad/s, or ``max_speed_rpm`` ends the speeds, 2.5 times the threshold unless given; ``group`` is
        the number of a parameter group, from 0; ``ax`` and ``unit`` are as for :meth:`bode`.

        Raises:
            ValueError: a fluid that does not change with eccentricity, or no threshold up to the end.
        """
        top = in_rad_s("max_speed", max_speed, needed=False, rpm=max_speed_rpm)
        return plot_whirl(self._fit, group=group, max_speed=top, **look)

    def side_load(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Threshold speed against static eccentricity and side load, with its 95 % band.

        ``ax`` and ``unit`` are as for :meth:`bode`.

        Raises:
            ValueError: a fluid that does not change with eccentricity, parameters per attribute, or no threshold.
        """
        return plot_side_load(self._fit, **look)

    def law(self, **look: Unpack[PlotKeywords]) -> Figure:
        """K0, D and lam against eccentricity with their 95 % bands; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_law(self._fit, **look)

    def relative_law(self, **look: Unpack[PlotKeywords]) -> Figure:
        """K0, D and lam over their values in the centre; ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_relative_law(self._fit, **look)

    def nonlinear_stiffness(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Nonlinear minus linear dynamic stiffness (Figs 13 to 15); ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_nonlinear_stiffness(self._fit, **look)

    def static_locus(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Locus of the journal under static load (Figs 26 to 28); ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_static_locus(self._fit, **look)

    def static_stiffness(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Static stiffness against eccentricity (Figs 27 and 28); ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_static_stiffness(self._fit, **look)

    def velocity_ratio(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Frequency over speed of free vibrations (Fig. 29); ``ax`` and ``unit`` as for :meth:`bode`."""
        return plot_velocity_ratio(self._fit, **look)

    def coefficients(
        self,
        speeds: Sequence[float] | None = None,
        *,
        speed_rpm: Sequence[float] | None = None,
        plane: str | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Coefficients of ``fit.coefficient_table`` against speed, with their 95 % errors.

        ``speeds``, ``speed_rpm`` and ``plane`` are as there, ``ax`` and ``unit`` as for :meth:`bode`.
        """
        return coefficients(self._fit.coefficient_table(speeds, speed_rpm=speed_rpm, plane=plane), **look)

    def frequency_coefficients(
        self,
        speeds: Sequence[float] | None = None,
        *,
        speed_rpm: Sequence[float] | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Stiffness and damping against frequency as measured, with the fitted ones and their 95 % bands.

        ``speeds`` are rotative, rad/s, or ``speed_rpm``, by default the tested ones; ``ax`` and ``unit`` are as for
        :meth:`bode`.
        """
        return frequency_coefficients(self._fit.frequency_coefficients(speeds, speed_rpm=speed_rpm), **look)

    def stabilisation(self, most: int | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Stabilisation diagram of a fit of ``Modal``: poles against how many are looked for, with the fitted modes.

        Args:
            most: pairs of poles that are looked for at most, by default five more than the model has modes.
            **look: ``ax`` and ``unit``, as for :meth:`bode`.

        Raises:
            ValueError: a fit of another model.
        """
        return plot_stabilisation(self._fit, most, **look)

    def mode_shapes(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Gains of the probes in each mode of a fit of ``Modal``, with 95 % errors.

        ``ax`` and ``unit`` are as for :meth:`bode`.

        Raises:
            ValueError: a fit of another model.
        """
        return plot_mode_shapes(self._fit, **look)
