"""Curves over the frames, with a line at the frame that is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from viser import GuiApi, GuiFolderHandle

_COLOURS = ("#2a5c9e", "#d9730d")
_CURSOR = "#d33"


def chart_data(curves: list[np.ndarray], frame: float) -> tuple[np.ndarray, ...]:
    """Abscissa, one row a curve, and the line at `frame`, all of one length.

    Args:
        curves: (frames,) values each, all of one length; NaN where there is none.
        frame: where the line stands.
    """
    count = len(curves[0])
    known = np.concatenate(curves)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    if high <= low:
        low, high = low - 0.5 * abs(low) - 1e-9, high + 0.5 * abs(high) + 1e-9
    # The line is two points at one abscissa, which the curves pass in between.
    at = int(np.clip(np.ceil(frame), 0, count))
    abscissa = np.insert(np.arange(count, dtype=float), at, [frame, frame])
    rows = [np.insert(curve, at, [np.interp(frame, np.arange(count), curve)] * 2) for curve in curves]
    line = np.full(count + 2, np.nan)
    line[at : at + 2] = low, high
    return abscissa, *rows, line


class Chart:
    """A plot in a panel; made anew when the number of curves changes."""

    def __init__(self, gui: GuiApi, place: GuiFolderHandle) -> None:
        self._gui, self._place = gui, place
        self._plot: Any = None
        self._title = ""
        self._labels: tuple[str, ...] = ()

    def draw(self, title: str, labels: tuple[str, ...], curves: list[np.ndarray], frame: float) -> None:
        """Show curves (frames,), one a label, and the line at `frame`."""
        data = chart_data(curves, frame)
        if self._plot is not None and (title, labels) == (self._title, self._labels):
            self._plot.data = data
            return
        series: list[dict[str, Any]] = [{"label": "frame"}]
        for label, colour in zip(labels, _COLOURS, strict=False):
            series.append({"label": label, "stroke": colour, "width": 2, "spanGaps": False, "points": {"show": False}})
        series.append({"label": "now", "stroke": _CURSOR, "width": 1.5, "points": {"show": False}})
        self._title, self._labels = title, labels
        options: dict[str, Any] = {
            "title": title,
            "scales": {"x": {"time": False}},
            "axes": ({"label": "frame"}, {"size": 64}),
            "height": 240,
        }
        if self._plot is not None:
            self._plot.remove()
        with self._place:
            self._plot = self._gui.add_uplot(data, tuple(series), **options)  # type: ignore[arg-type]
