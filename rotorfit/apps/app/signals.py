"""Signals of a recording: the whole of it, a stretch to scroll through, and what belongs to the time of a cursor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn
from bokeh.events import RangesUpdate, Tap
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, HoverTool, Range1d, RangeTool, Span
from bokeh.plotting import figure

from rotorfit.apps.app.parts import WIDE, figures_beside, framed, message, small_legend
from rotorfit.apps.study_files.wording import sentence
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.recordings.views import Cascade, OrderVectors, Stretch, cascade, envelope, spectrum, stretch
from rotorfit.show.plots.recordings import vectors_shown
from rotorfit.show.plots.style import COLOURS

if TYPE_CHECKING:
    from rotorfit.lab.recordings.angle_track import AngleTrack
    from rotorfit.lab.recordings.recording import Recording

_POINTS = 1000
"""Pieces of a curve over time: one a pixel."""
_TURNS, _SPECTRUM_TURNS = 6.0, 64.0
"""Turns about the cursor that an orbit and a spectrum show. Chosen."""


class SignalsView:
    """Figures of one plane of a recording, and the cursor that they share."""

    def __init__(self, record: Recording, plane: str, at: float | None = None) -> None:
        self.record, self._plane = record, plane
        self.at = record.duration / 2 if at is None else at
        seconds = 1.0  # length of the time base at first
        half = min(record.duration / 2, seconds / 2)
        probes = [probe for probe in record.probes if probe.plane == plane]
        self._time = _TimeFigure(record, probes, max(self.at - half, 0.0), min(self.at + half, record.duration))
        self._time.mark(self.at)
        self._time.on_tap(self.move)
        self._parts: Sequence[Any] = ()
        self._linked = pn.Column(message("finding the pulses of the marks ..."), **WIDE)
        figures = (self._time.overview, self._time.figure)
        self.view = pn.Column(*[pn.pane.Bokeh(figure, **WIDE) for figure in figures], self._linked, **WIDE)

    def complete(self) -> None:
        """Draw what takes seconds of a long recording: the whole of it, and what needs the marks."""
        self._time.show_whole()
        try:
            parts = list(self._figures())
        except ValueError as problem:  # no mark, or none that can be followed
            self._linked.objects = [message(sentence(problem), "warning")]
            return
        for part in parts:
            part.move(self.at)
        self._parts = parts
        self._linked.objects = [figures_beside([figure for part in parts for figure in part.figures])]

    def _figures(self) -> Iterator[Any]:
        record, marks = self.record, self.record.marks
        if np.iscomplexobj(record.motion(self._plane, 0, 1)):
            yield _OrbitFigure(record, self._plane)
        yield _SpectrumFigure(record, self._plane)
        if marks.present:
            vectors, mark = vectors_shown(record, marks, marks.main, None), marks.named(marks.main, record)
            yield VectorFigures(vectors, self._plane, mark)
            yield _CascadeFigure(record, cascade(record, marks, self._plane))

    def move(self, at: float) -> None:
        """Move the cursor to a time, s."""
        self.at = float(np.clip(at, 0.0, self.record.duration))
        self._time.mark(self.at)
        for part in self._parts:
            part.move(self.at)


class _TimeFigure:
    """The time base, which scrolls, below the whole recording."""

    def __init__(self, record: Recording, probes: Sequence[Any], start: float, stop: float) -> None:
        self._record, self._probes = record, probes
        self.figure = framed(
            f"{record.name}: time base", 230, "time, s", "µm", tools="xpan,xwheel_zoom,xbox_zoom,reset,tap,save",
            active_drag="xpan", active_scroll="xwheel_zoom", x_range=Range1d(start, stop, bounds=(0, record.duration)),
        )  # fmt: skip
        self.overview = figure(
            height=90, sizing_mode="stretch_width", tools="tap", toolbar_location=None, y_axis_label="µm",
            x_range=Range1d(0, record.duration), title="all of it: drag the window",
        )  # fmt: skip
        self.overview.add_tools(RangeTool(x_range=self.figure.x_range, start_gesture="none"))
        self._sources: list[Any] = []
        self._whole: list[Any] = []
        for number, probe in enumerate(probes):
            colour, angle = COLOURS[number % len(COLOURS)], np.degrees(float(probe.angle or 0.0))
            source, whole = (ColumnDataSource({"t": [], "x": []}) for _ in range(2))
            self._sources.append(source)
            self._whole.append(whole)
            self.figure.line("t", "x", source=source, color=colour, legend_label=f"{probe.plane} at {angle:g}°")
            self.overview.line("t", "x", source=whole, color=colour)
        self.figure.legend.orientation = "horizontal"
        small_legend(self.figure)
        self.overview.yaxis.ticker.desired_num_ticks = 2
        self.overview.yaxis.minor_tick_line_color = None
        self._cursors = [Span(dimension="height", line_color=COLOURS[1], line_width=1.5) for _ in range(2)]
        for plot, cursor in zip((self.figure, self.overview), self._cursors, strict=True):
            plot.add_layout(cursor)
        self._show(start, stop)
        for part, whole in zip(self._sources, self._whole, strict=True):
            whole.data = dict(part.data)  # until all of it has been gone through
        self.figure.on_event(RangesUpdate, lambda event: self._show(event.x0, event.x1))

    def show_whole(self) -> None:
        """Draw the whole recording, from a thread that is not the server's."""
        for probe, source in zip(self._probes, self._whole, strict=True):
            curve = self._curve(probe, 0.0, self._record.duration)
            pn.state.execute(partial(setattr, source, "data", curve), schedule=True)

    def on_tap(self, call: Any) -> None:
        """Call with the time that is tapped on."""
        for plot in (self.figure, self.overview):
            plot.on_event(Tap, lambda event: call(event.x))

    def mark(self, at: float) -> None:
        """Draw the cursor at a time."""
        for cursor in self._cursors:
            cursor.location = at

    def _show(self, start: float, stop: float) -> None:
        for probe, source in zip(self._probes, self._sources, strict=True):
            source.data = self._curve(probe, start, stop)

    def _curve(self, probe: Any, start: float, stop: float) -> dict[str, Any]:
        t, x = envelope(self._record, probe, start, stop, _POINTS)
        return {"t": t, "x": x * 1e6}


class _OrbitFigure:
    """Orbit about the cursor, as recorded and filtered to each mark, with a dot at every pulse."""

    def __init__(self, record: Recording, plane: str) -> None:
        self._record, self._plane = record, plane
        self.figure = framed("orbit", 340, "x, µm", "y, µm", match_aspect=True)
        names = ["as recorded", *(f"turning with the {name}" for name in record.marks.present)]
        self._sources = {name: ColumnDataSource({"x": [], "y": []}) for name in names}
        for number, (name, source) in enumerate(self._sources.items()):
            self.figure.line("x", "y", source=source, color=COLOURS[number], legend_label=name)
        self._dots = ColumnDataSource({"x": [], "y": []})
        self.figure.scatter("x", "y", source=self._dots, size=6, color="black", legend_label="pulse of a mark")
        small_legend(self.figure)
        self.figures = [self.figure]

    def move(self, at: float) -> None:
        """Show the time of the cursor."""
        part: Stretch = stretch(self._record, self._record.marks, self._plane, at, _TURNS)
        curves = [part.z, *part.filtered.values()]
        for source, z in zip(self._sources.values(), curves, strict=True):
            values = np.asarray(z, dtype=complex) * 1e6
            source.data = {"x": values.real, "y": values.imag}
        times = np.concatenate([np.zeros(0), *part.dots.values()])
        z = np.asarray(part.z, dtype=complex) * 1e6
        self._dots.data = {"x": np.interp(times, part.t, z.real), "y": np.interp(times, part.t, z.imag)}
        self.figure.title.text = f"orbit at {significant(at, 4)} s"


class _SpectrumFigure:
    """Full spectrum about the cursor."""

    def __init__(self, record: Recording, plane: str) -> None:
        self._record, self._plane = record, plane
        self.figure = framed("full spectrum", 340, "frequency, Hz (backward < 0 < forward)", "µm 0-peak")
        self._source = ColumnDataSource({"f": [], "a": []})
        drawn = self.figure.line("f", "a", source=self._source, color=COLOURS[0])
        tips = [("", "@f{0.00} Hz"), ("", "@a{0.000} µm")]
        self.figure.add_tools(HoverTool(tooltips=tips, renderers=[drawn], mode="vline"))
        turning = [
            abs(float(angle.speed(np.array([record.duration / 2]))[0])) for angle in record.marks.present.values()
        ]
        slowest = min((speed for speed in turning if speed), default=2 * np.pi / record.duration * _SPECTRUM_TURNS)
        self._half = min(_SPECTRUM_TURNS * np.pi / slowest, record.duration / 2)
        reach = 4 * max(turning, default=np.pi * record.sample_rate / 4) / (2 * np.pi)
        self.figure.x_range.start, self.figure.x_range.end = -reach, reach
        self.figures = [self.figure]

    def move(self, at: float) -> None:
        """Show the time of the cursor."""
        begin = float(np.clip(at - self._half, 0.0, self._record.duration - 2 * self._half))
        frequency, amplitude = spectrum(self._record, self._plane, begin, begin + 2 * self._half)
        self._source.data = {"f": frequency, "a": amplitude * 1e6}
        self.figure.title.text = f"full spectrum, {significant(begin, 4)} to {significant(begin + 2 * self._half, 4)} s"


class VectorFigures:
    """Vectors of the probes of a plane: amplitude and phase, and their locus, counted from the probe."""

    def __init__(self, vectors: OrderVectors, plane: str, mark: AngleTrack) -> None:
        self._vectors, self._mark = vectors, mark
        own = [(angle, row) for (at, angle), row in zip(vectors.probes, vectors.phasors, strict=True) if at == plane]
        self.rpm = np.abs(vectors.speed) * RPM_PER_RAD_S
        changes = bool(np.ptp(self.rpm) > 0.05 * self.rpm.max())
        self._across = self.rpm if changes else vectors.t
        self._rows = {f"probe at {np.degrees(angle):g}°": row * 1e6 for angle, row in own}
        self.cursor = ColumnDataSource({"x": [], "a": [], "p": [], "re": [], "im": []})
        what = "1x" if vectors.reference == "shaft" else "at the perturbation frequency"
        label = f"speed of the {vectors.reference}, rpm" if changes else "time, s"
        top = framed(f"vectors {what}", 180, "", "µm 0-peak")
        bottom = framed("", 160, label, "phase lead, °", x_range=top.x_range)
        bottom.y_range.start, bottom.y_range.end = -190, 190
        polar = framed("polar", 340, "in phase, µm", "quadrature, µm", match_aspect=True)
        for number, (name, row) in enumerate(self._rows.items()):
            colour = COLOURS[number % len(COLOURS)]
            top.line(self._across, np.abs(row), color=colour, legend_label=name)
            bottom.scatter(self._across, np.degrees(np.angle(row)), color=colour, size=2.5)
            polar.line(row.real, row.imag, color=colour, legend_label=name)
        for plot, x, y in ((top, "x", "a"), (bottom, "x", "p"), (polar, "re", "im")):
            plot.scatter(x, y, source=self.cursor, size=9, color=None, line_color="black", line_width=2)
        small_legend(top)
        small_legend(polar)
        bottom.toolbar_location = None
        self.figures = [column(top, bottom, sizing_mode="stretch_width"), polar]

    def move(self, at: float) -> None:
        """Show the time of the cursor."""
        vectors = self._vectors
        apart = np.abs(vectors.t - at)
        if np.isnan(vectors.t).all():  # of a sweep, whose vectors have no times: that of the mark's speed then
            apart = np.abs(np.abs(vectors.speed) - abs(float(self._mark.speed(np.array([at]))[0])))
        there = np.flatnonzero(np.isfinite(list(self._rows.values())).all(axis=0))
        i = int(there[np.argmin(apart[there])]) if there.size else 0
        values = np.array([row[i] for row in self._rows.values()])
        self.cursor.data = {
            "x": np.full(values.size, self._across[i]),
            "a": np.abs(values),
            "p": np.degrees(np.angle(values)),
            "re": values.real,
            "im": values.imag,
        }


class _CascadeFigure:
    """Full spectra one above the other, as levels of grey, with the orders of the marks."""

    def __init__(self, record: Recording, found: Cascade) -> None:
        self._record, self._found = record, found
        scale, label = (1.0, "time, s") if found.over == "time" else (RPM_PER_RAD_S, f"{_NAMES[found.over]}, rpm")
        position, order = found.position * scale, np.argsort(found.position)
        turning = np.abs(np.concatenate([found.shaft, found.perturbation]))
        fastest = float(turning[np.isfinite(turning)].max(initial=0.0)) / (2 * np.pi)
        edge = min(3 * fastest or np.inf, float(found.frequency.max()))
        low, high = float(position.min()), float(position.max())
        self.figure = framed("cascade, darker is larger", 340, "frequency, Hz (backward < 0 < forward)", label)
        self.figure.image(
            [_levels(found.amplitude[order][:, np.abs(found.frequency) <= edge])],
            x=-edge, y=low, dw=2 * edge, dh=max(high - low, 1e-9),
            palette=[f"#{level:02x}{level:02x}{level:02x}" for level in range(255, 30, -1)],
        )  # fmt: skip
        for name, at in (("1x", found.shaft), ("1x", -found.shaft), ("w", found.perturbation)):
            if np.isfinite(at).any():
                look = {"color": COLOURS[name == "w"], "line_dash": "dashed", "legend_label": name}
                self.figure.line(at[order] / (2 * np.pi), position[order], **look)
        self.figure.x_range.start, self.figure.x_range.end = -edge, edge
        small_legend(self.figure)
        self._cursor = Span(dimension="width", line_color=COLOURS[1], line_width=1.5)
        self.figure.add_layout(self._cursor)
        self.figures = [self.figure]

    def move(self, at: float) -> None:
        """Show the time of the cursor."""
        if self._found.over == "time":
            self._cursor.location = at
            return
        mark = self._record.marks.named("shaft" if self._found.over == "speed" else "perturbator", self._record)
        self._cursor.location = abs(float(mark.speed(np.array([at]))[0])) * RPM_PER_RAD_S


def _levels(amplitude: Any) -> Any:
    """Logarithms of amplitudes, thinned out along the frequency by the largest, three decades of them."""
    edges = np.arange(0, amplitude.shape[1], max(amplitude.shape[1] // _POINTS, 1))
    thinned = np.maximum.reduceat(amplitude, edges, axis=1)
    return np.log10(np.maximum(thinned, 1e-3 * thinned.max(initial=1e-12)))


_NAMES = {"speed": "speed of the shaft", "perturbation": "perturbation frequency"}
