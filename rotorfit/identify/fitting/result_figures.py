"""Figures of a fit, a method each: what a user calls on a result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack

from rotorfit.lab.data.figure_keywords import PlotKeywords

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class FitFigures:
    """Figures of a fit; the plots are imported when one is drawn."""

    @property
    def _fit(self) -> Any:
        """The result, whose file knows this one and not the other way round."""
        return self

    def plot_dynamic_stiffness(self, *, against: str = "frequency", **look: Unpack[PlotKeywords]) -> Figure:
        """Direct and quadrature dynamic stiffness against signed frequency, data with error bars and fit.

        Args:
            against: ``"frequency"``, ``"square"`` (the direct part against the square of the frequency: straight lines,
                as in Figs 6, 25 and 36) or ``"ratio"`` (frequency over rotative speed).
            **look: ``ax`` and ``unit``, as for :meth:`plot_bode`.

        Raises:
            ValueError: no such abscissa or unit, or a ratio to a speed that is swept.

        Example:
            >>> fit.plot_dynamic_stiffness().savefig(folder / "stiffness.png")
        """
        from rotorfit.show.plots.dynamic_stiffness import plot_dynamic_stiffness

        return plot_dynamic_stiffness(self._fit, against=against, **look)

    def plot_bode(self, *, against: str = "frequency", mr: float | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Amplitude and phase of every response against frequency.

        Args:
            against: ``"frequency"``, signed; ``"ratio"``, that over the rotative speed (Fig. 9); ``"size"``, forward
                and backward over one another (Fig. 8).
            mr: an unbalance, kg m, for which amplitudes are drawn in place of those per unit force.
            **look: ``ax``: axes to draw in, one or as many as the figure has panels; one place for several panels is
                divided, and a figure or subfigure filled. ``unit``: of frequencies (``"rpm"``, ``"hz"``, ``"rad_s"``),
                of lengths (``"um"``, ``"mil_pp"``, ``"mm"``), or both, ``("hz", "mil_pp")``.

        Raises:
            ValueError: no such abscissa or unit, a ratio to a speed that is swept, or axes that are too many or few.

        Example:
            >>> fit.plot_bode(against="size", unit="hz").savefig(folder / "bode.png")
        """
        from rotorfit.show.plots.bode import plot_bode

        return plot_bode(self._fit, against=against, mr=mr, **look)

    def plot_drive_point(
        self, *, plane: str | None = None, mr: float | None = None, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Phase, amplitude and dynamic stiffness of a forced plane above one another, a colour a condition (Fig. 11).

        Args:
            plane: one that was forced and read, the last unless given.
            mr: an unbalance, kg m, for which amplitudes are drawn.
            **look: ``ax`` and ``unit``, as for :meth:`plot_bode`.

        Raises:
            ValueError: no such plane.

        Example:
            >>> len(fit.plot_drive_point(plane="journal").axes)
            4
        """
        from rotorfit.show.plots.bode import plot_drive_point

        return plot_drive_point(self._fit, plane=plane, mr=mr, **look)

    def plot_polar(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Responses in the complex plane; ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.responses import plot_polar

        return plot_polar(self._fit, **look)

    def plot_residuals(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Whitened residuals against frequency; ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.responses import plot_residuals

        return plot_residuals(self._fit, **look)

    def plot_lines(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Lines of an uneven shaft and its twist against frequency; ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.shaft_lines import plot_lines

        return plot_lines(self._fit, **look)

    def plot_stability(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Eigenvalues against speed, threshold with its interval; ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.stability import plot_stability

        return plot_stability(self._fit, **look)

    def plot_whirl(self, *, max_speed_rpm: float | None = None, group: int = 0, **look: Unpack[PlotKeywords]) -> Figure:
        """Radius and frequency of the whirl that the rotor keeps up beyond its threshold, against speed, with a band.

        ``max_speed_rpm`` ends the speeds, 2.5 times the threshold unless given; ``group`` is the number of a parameter
        group, from 0; ``ax`` and ``unit`` are as for :meth:`plot_bode`.

        Raises:
            ValueError: a fluid that does not change with eccentricity, or no threshold up to the end.
        """
        from rotorfit.show.plots.beyond_onset import plot_whirl

        return plot_whirl(self._fit, group=group, max_speed_rpm=max_speed_rpm, **look)

    def plot_side_load(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Threshold speed against static eccentricity and side load, with its 95 % band.

        ``ax`` and ``unit`` are as for :meth:`plot_bode`.

        Raises:
            ValueError: a fluid that does not change with eccentricity, parameters per attribute, or no threshold.
        """
        from rotorfit.show.plots.beyond_onset import plot_side_load

        return plot_side_load(self._fit, **look)

    def plot_law(self, **look: Unpack[PlotKeywords]) -> Figure:
        """K0, D and lam against eccentricity with their 95 % bands; ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.eccentricity import plot_law

        return plot_law(self._fit, **look)

    def plot_nonlinear_stiffness(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Nonlinear minus linear dynamic stiffness (Figs 13 to 15); ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.eccentricity import plot_nonlinear_stiffness

        return plot_nonlinear_stiffness(self._fit, **look)

    def plot_static_locus(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Locus of the journal under static load (Figs 26 to 28); ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.static_and_impulse import plot_static_locus

        return plot_static_locus(self._fit, **look)

    def plot_static_stiffness(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Static stiffness against eccentricity (Figs 27 and 28); ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.static_and_impulse import plot_static_stiffness

        return plot_static_stiffness(self._fit, **look)

    def plot_velocity_ratio(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Frequency over speed of free vibrations (Fig. 29); ``ax`` and ``unit`` as for :meth:`plot_bode`."""
        from rotorfit.show.plots.static_and_impulse import plot_velocity_ratio

        return plot_velocity_ratio(self._fit, **look)

    def plot_coefficients(
        self, speeds: Sequence[float] | None = None, *, plane: str | None = None, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Coefficients of ``fit.coefficient_table`` against speed, with their 95 % errors.

        ``speeds`` and ``plane`` are as there, ``ax`` and ``unit`` as for :meth:`plot_bode`.
        """
        from rotorfit.show.plots.coefficients import coefficients

        return coefficients(self._fit.coefficient_table(speeds, plane=plane), **look)

    def plot_frequency_coefficients(
        self, speeds: Sequence[float] | None = None, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Stiffness and damping against frequency as measured, with the fitted ones and their 95 % bands.

        ``speeds`` are rotative, rad/s, by default the tested ones; ``ax`` and ``unit`` as for :meth:`plot_bode`.
        """
        from rotorfit.show.plots.coefficients import frequency_coefficients

        return frequency_coefficients(self._fit.frequency_coefficients(speeds), **look)

    def plot_stabilisation(self, most: int | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Stabilisation diagram of a fit of ``Modal``: poles against how many are looked for, with the fitted modes.

        Args:
            most: pairs of poles that are looked for at most, by default five more than the model has modes.
            **look: ``ax`` and ``unit``, as for :meth:`plot_bode`.

        Raises:
            ValueError: a fit of another model.
        """
        from rotorfit.show.plots.modal import plot_stabilisation

        return plot_stabilisation(self._fit, most, **look)

    def plot_mode_shapes(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Gains of the probes in each mode of a fit of ``Modal``, with 95 % errors.

        ``ax`` and ``unit`` are as for :meth:`plot_bode`.

        Raises:
            ValueError: a fit of another model.
        """
        from rotorfit.show.plots.modal import plot_mode_shapes

        return plot_mode_shapes(self._fit, **look)
