"""Figures of a recording, a method each: ``record.plot.orbit()``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Unpack

from matplotlib.figure import Figure

from rotorfit.lab.recordings import views
from rotorfit.lab.recordings.angle_track import speeds
from rotorfit.lab.recordings.recording import Recording
from rotorfit.show.plots.figure_keywords import PlotKeywords
from rotorfit.show.plots.recordings import (
    plot_bode,
    plot_cascade,
    plot_centreline,
    plot_full_spectrum,
    plot_orbit,
    plot_polar,
    plot_speed,
    plot_timebase,
    vectors_shown,
)
from rotorfit.show.plots.twist import plot_twist


class RecordingPlots:
    """Figures of a recording; ``record.plot()`` is the timebase."""

    def __init__(self, record: Recording) -> None:
        self._record = record

    def __call__(self, **look: Unpack[PlotKeywords]) -> Figure:
        """First look: :meth:`timebase`; ``ax`` and ``unit`` as for :meth:`rotorfit.FitResult.plot.bode`."""
        return self.timebase(**look)

    def timebase(
        self, plane: str | None = None, *, at: float | None = None, turns: float = 6.0, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """x and y over time with a dot at every mark.

        Args:
            plane: one of :attr:`rotorfit.Recording.planes`; None: all.
            at: middle of what is shown, s; None: of the recording.
            turns: of the slower mark that are shown.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such plane or time.
        """
        parts = [views.stretch(self._record, self._record.marks, each, at, turns) for each in self._of(plane)]
        return plot_timebase(parts, self._record.name, **look)

    def orbit(
        self,
        plane: str | None = None,
        *,
        at: float | None = None,
        turns: float = 4.0,
        clearance: float | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Orbits as recorded and filtered to the shaft (1x) and to the perturbator (w), with Keyphasor dots.

        Args:
            plane: one of :attr:`rotorfit.Recording.planes`; None: all with two probes.
            at: middle of what is shown, s; None: of the recording.
            turns: of the slower mark that are shown.
            clearance: radial, m, drawn as a circle; None: as ``[clearance_um]`` of the setup says, if it does.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such plane or time, or a plane with one probe.
        """
        parts = [
            views.stretch(self._record, self._record.marks, each, at, turns, clearance) for each in self._pairs(plane)
        ]
        return plot_orbit(parts, self._record.name, **look)

    def centreline(
        self, plane: str | None = None, *, clearance: float | None = None, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Mean position of the shaft over the recording, from the gap voltages.

        Args:
            plane: one of :attr:`rotorfit.Recording.planes`; None: all with two probes.
            clearance: radial, m, drawn as a circle; None: as ``[clearance_um]`` of the setup says, if it does.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such plane, one probe, or no gap voltages (AC-coupled).
        """
        if any(finding.code == "ac-coupled" for finding in self._record.findings):
            raise ValueError(f"{self._record.name} has no gap voltages (AC-coupled?): there is no centreline in it")
        lines = [
            views.centreline(self._record, self._record.marks, each, clearance=clearance) for each in self._pairs(plane)
        ]
        return plot_centreline(lines, self._record.name, **look)

    def bode(self, reference: str | None = None, *, turns: float | None = None, **look: Unpack[PlotKeywords]) -> Figure:
        """Amplitude and phase of every probe's vector over the speed of a mark.

        Of a sweep of a known weight these are the vectors that a fit gets, orders of the shaft left out; of others, as
        of a start-up's 1x, vectors by windows of some turns.

        Args:
            reference: ``"shaft"`` or ``"perturbator"``; None: the perturbator's where there is one.
            turns: of a window; None: no windows for a sweep, 8 turns for others.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such mark.
        """
        return plot_bode(self._vectors(reference, turns), self._record.name, **look)

    def polar(
        self, reference: str | None = None, *, turns: float | None = None, **look: Unpack[PlotKeywords]
    ) -> Figure:
        """Locus of every probe's vector, those of :meth:`bode`.

        Args:
            reference: ``"shaft"`` or ``"perturbator"``; None: the perturbator's where there is one.
            turns: of a window; None: no windows for a sweep, 8 turns for others.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such mark.
        """
        return plot_polar(self._vectors(reference, turns), self._record.name, **look)

    def full_spectrum(
        self,
        plane: str | None = None,
        *,
        start: float = 0.0,
        stop: float | None = None,
        limit_hz: float | None = None,
        marks: Mapping[str, float] | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Full spectrum: a circle of radius A has amplitude A at its signed frequency.

        Args:
            plane: one of :attr:`rotorfit.Recording.planes`; None: all.
            start, stop: of the stretch, s.
            limit_hz: largest frequency shown; None: what holds all that is worth seeing.
            marks: frequencies to mark, rad/s, signed, by name: modes of a fit, ``{"whirl": 62.0}``.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such plane, or an empty stretch.
        """
        spectra = {each: views.spectrum(self._record, each, start, stop) for each in self._of(plane)}
        lines = views.steady_lines(self._record.marks, start, self._record.duration if stop is None else stop)
        return plot_full_spectrum(spectra, lines, self._record.name, limit_hz, marks or {}, **look)

    def cascade(
        self,
        plane: str | None = None,
        *,
        over: str | None = None,
        spectra: int = 60,
        limit_hz: float | None = None,
        lines: Mapping[str, tuple[float, float]] | None = None,
        direction: str | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Full-spectrum cascade with order lines, or the cascade of one direction (Fig. 37).

        Args:
            plane: one of :attr:`rotorfit.Recording.planes`; None: the first.
            over: ``"time"``, ``"speed"`` or ``"perturbation"``; None: what changes in this recording.
            spectra: how many.
            limit_hz: largest frequency shown; None: what holds all that is worth seeing.
            lines: further lines to mark, factors of w and of the speed by name, ``{"2w − 1x": (2, -1)}``.
            direction: ``"x"`` or ``"y"``: spectra of the motion along it, as one probe there shows, without forward and
                backward; None: full spectra of x and y.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no such plane or direction, or no mark for what is asked.
        """
        found = views.cascade(
            self._record, self._record.marks, self._of(plane)[0], over=over, spectra=spectra, direction=direction
        )
        return plot_cascade(found, self._record.name, limit_hz, lines or {}, **look)

    def twist(
        self,
        *,
        over: str | None = None,
        spectra: int = 60,
        limit_hz: float | None = None,
        marks: Mapping[str, float] | None = None,
        **look: Unpack[PlotKeywords],
    ) -> Figure:
        """Overall torsional amplitude and a cascade of the twist with its combination lines.

        Args:
            over: ``"time"``, ``"speed"`` or ``"perturbation"``; None: what changes in this recording.
            spectra: how many.
            limit_hz: largest frequency shown; None: what holds all combination lines.
            marks: frequencies to mark, rad/s, by name, ``{"ν_t": 260.0}``.
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: no twist was measured, or no mark for what is asked.
        """
        found = views.twist_cascade(self._record, self._record.marks, over=over, spectra=spectra)
        return plot_twist(found, self._record.name, limit_hz, marks or {}, **look)

    def speed(self, **look: Unpack[PlotKeywords]) -> Figure:
        """Speed and sweep rate of every mark over time.

        Args:
            **look: ``ax`` and ``unit``, as for :meth:`rotorfit.FitResult.plot.bode`.

        Raises:
            ValueError: the recording has no marks.
        """
        if not self._record.marks.present:
            raise ValueError(f"{self._record.name} has no phase reference, so no speed")
        return plot_speed(speeds(self._record.marks), self._record.name, **look)

    def _vectors(self, reference: str | None, turns: float | None) -> views.OrderVectors:
        known = vars(self._record).setdefault("_known_vectors", {})
        key = (reference or self._record.marks.main, turns)
        if key not in known:
            self._of(None)
            known[key] = vectors_shown(self._record, self._record.marks, key[0], turns)
        return known[key]  # type: ignore[no-any-return]

    def _of(self, plane: str | None) -> tuple[str, ...]:
        if not self._record.planes:
            raise ValueError(f"{self._record.name}: none of its channels is known as a probe")
        return self._record.planes if plane is None else (plane,)

    def _pairs(self, plane: str | None) -> tuple[str, ...]:
        if plane is not None:
            self._record.motion(plane, 0, 0)  # refuses a plane that there is not
        chosen = tuple(pair for pair in self._record.pairs if plane in (None, pair))
        if not chosen:
            lacking = f"{plane} has one probe" if plane else "no plane has two probes"
            raise ValueError(f"{self._record.name}: {lacking}; an orbit or a centreline needs two")
        return chosen
