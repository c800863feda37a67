"""Energies and strains over the frames: measured beside everything else the page does, and drawn as curves."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from pb4u.measures.metrics import ENERGIES, Ruler
from pb4u.viewer.clip import Clip
from pb4u.viewer.panel import Panel, notice
from pb4u.viewer.worker import Worker, plain_sentence

QUANTITIES: dict[str, str] = {
    **{name: f"{name} energy [J]" for name in ENERGIES},
    "strain_p95": "strain, 95th percentile",
    "penetration_percent": "vertices inside the body [%]",
    "visible_skin_percent": "skin that shows through cloth [%]",
}
"""What can be plotted, and how it is written."""

_COLOURS = ("#2a5c9e", "#d9730d")
_CURSOR = "#d33"


class Measurement(Worker):
    """Measures every frame of a clip.

    Args:
        clip: with all of its frames.

    Attributes:
        failure: sentence on why it could not be measured; None without an error.
    """

    def __init__(self, clip: Clip) -> None:
        super().__init__("measurement")
        self.clip = clip
        self.failure: str | None = None
        self._frames = clip.frame_count
        # Written by the worker alone, one whole row at a time; readers take a copy.
        self._rows: list[dict[str, float]] = []

    @property
    def done(self) -> int:
        """Frames measured so far."""
        return len(self._rows)

    def series(self, quantity: str) -> np.ndarray:
        """Values (frames,) of one of `QUANTITIES`, in its unit; NaN for frames that are not measured yet, or not
        finite.

        Args:
            quantity: its name.
        """
        values = [row.get(quantity, np.nan) for row in list(self._rows)]
        return np.pad(np.array(values, dtype=float), (0, self._frames - len(values)), constant_values=np.nan)

    def _work(self) -> None:
        try:
            ruler = Ruler(self.clip.trajectory())
            for t in range(self._frames):
                if self._cancelled.is_set():
                    return
                self._rows.append(ruler.frame(t)[0])
        except Exception as error:
            self.failure = plain_sentence(error)


class PlotPanel(Panel):
    """Curves of one quantity over the frames, one for each clip."""

    _EVERY = 0.2
    """Seconds between redraws: each sends all curves again."""

    def _add_controls(self) -> None:
        gui = self._gui
        self._last = 0.0
        self._drawn: object = None
        self._names = {line: name for name, line in QUANTITIES.items()}
        self._quantity = gui.add_dropdown("Quantity", list(self._names), initial_value=QUANTITIES["stretch"])
        self._place = gui.add_folder(None)
        self._plot: Any = None
        self._heading: tuple[str, ...] = ()
        self._status = gui.add_html("")

    def refresh(self, measurements: tuple[Measurement, ...], frame: int) -> None:
        """Redraw where the values, the quantity or the frame have changed.

        Args:
            measurements: of every clip that is shown.
            frame: frame of the timeline for the vertical line.
        """
        if not measurements:
            self._clear()
            return
        now, title = time.monotonic(), self._quantity.value
        progress = [(measurement, measurement.done, measurement.failure) for measurement in measurements]
        state = (title, frame, progress)
        if now - self._last < self._EVERY or state == self._drawn:
            return
        self._last, self._drawn = now, state
        name, fps = self._names.get(title, "stretch"), measurements[0].clip.header.fps
        curves = [on_timeline(m.series(name), m.clip.header.fps / fps) for m in measurements]
        length = max(len(curve) for curve in curves)
        curves = [np.pad(curve, (0, length - len(curve)), constant_values=np.nan) for curve in curves]
        self._draw(title, tuple(measurement.clip.label for measurement in measurements), curves, float(frame))
        failures = [failure for _, _, failure in progress if failure]
        done, total = sum(done for _, done, _ in progress), sum(m.clip.frame_count for m in measurements)
        text = failures[0] if failures else "" if done >= total else f"Measured {done} of {total} frames."
        self._status.content = notice(text)

    def _clear(self) -> None:
        """Leave no curves of a clip that is not shown any more."""
        if self._plot is not None:
            self._plot.remove()
            self._plot, self._heading, self._drawn = None, (), None
            self._status.content = notice("Measured once the simulation has ended.")

    def _draw(self, title: str, labels: tuple[str, ...], curves: list[np.ndarray], frame: float) -> None:
        """Send the curves; a new plot is made where its labels change, since a plot cannot change them."""
        data = chart_data(curves, frame)
        # A range has to be given: the page finds none itself where a row begins with NaN, and then draws nothing.
        low, high = float(np.nanmin(data[-1])), float(np.nanmax(data[-1]))
        room = 0.05 * (high - low)
        scales: dict[str, Any] = {"x": {"time": False}, "y": {"range": (low - room, high + room)}}
        if self._plot is not None and self._heading == (title, *labels):
            self._plot.data = data
            if self._plot.scales != scales:
                self._plot.scales = scales
            return
        series: list[dict[str, Any]] = [{"label": "frame"}]
        for label, colour in zip(labels, _COLOURS, strict=False):
            series.append({"label": label, "stroke": colour, "width": 2, "spanGaps": False, "points": {"show": False}})
        series.append({"label": "now", "stroke": _CURSOR, "width": 1.5, "points": {"show": False}})
        options: dict[str, Any] = {"scales": scales, "axes": ({"label": "frame"}, {"size": 64}), "height": 240}
        self._heading = (title, *labels)
        if self._plot is not None:
            self._plot.remove()
        with self._place:
            self._plot = self._gui.add_uplot(data, tuple(series), title=title, **options)  # type: ignore[arg-type]


def on_timeline(curve: np.ndarray, rate: float) -> np.ndarray:
    """Values at the frames of another clip shown beside this one, at the same times.

    Args:
        curve: (frames,) values at the frames of a clip.
        rate: frames of that clip for each of the other's.
    """
    if rate == 1.0 or not len(curve):
        return curve
    last = len(curve) - 1
    return curve[np.minimum(np.rint(np.arange(int(last / rate + 1e-6) + 1) * rate).astype(int), last)]


def chart_data(curves: list[np.ndarray], frame: float) -> tuple[np.ndarray, ...]:
    """Data of a chart: abscissa, one row a curve, and the vertical line at `frame`.

    Args:
        curves: (frames,) values each, in one unit, all of one length; NaN where there is none.
        frame: position of the line on the abscissa [frames].

    Returns:
        Arrays of one length, (frames + 2,) each: abscissa [frames], the curves, and the line in their unit.
    """
    count = len(curves[0])
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    if high <= low:
        # A curve of one value has no range; the line still needs a length, however small the value is.
        low, high = low - 0.5 * abs(low) - 1e-9, high + 0.5 * abs(high) + 1e-9
    # The line is two points at one abscissa, which the curves pass in between.
    at = int(np.clip(np.ceil(frame), 0, count))
    abscissa = np.insert(np.arange(count, dtype=float), at, [frame, frame])
    rows = [np.insert(curve, at, [np.interp(frame, np.arange(count), curve)] * 2) for curve in curves]
    line = np.full(count + 2, np.nan)
    line[at : at + 2] = low, high
    return abscissa, *rows, line
