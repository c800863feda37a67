"""Numbers on a surface as colours, and the legend that explains them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from html import escape

import numpy as np


@dataclass(frozen=True)
class ColourScale:
    """A fixed range of values and its colours: fixed, so that frames and trajectories compare.

    Args:
        title: what is shown, with its unit.
        low, high: values at the ends; what lies beyond takes the colour of the end.
        low_label, high_label: how the ends are written.
        colours: name of a matplotlib colour map.
    """

    title: str
    low: float
    high: float
    low_label: str
    high_label: str
    colours: str = "viridis"

    @cached_property
    def _table(self) -> np.ndarray:
        from matplotlib import colormaps

        return np.asarray(colormaps[self.colours](np.linspace(0.0, 1.0, 256)))[:, :3]

    @cached_property
    def _linear_table(self) -> np.ndarray:
        """(256, 4) uint8 linear RGB and full alpha, as glTF wants vertex colours."""
        srgb = self._table
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        return np.column_stack([np.round(255 * linear), np.full(256, 255)]).astype(np.uint8)

    def vertex_colours(self, values: np.ndarray) -> np.ndarray:
        """(vertices, 4) uint8 linear RGBA of `values` (vertices,); what is not finite is painted as the low end."""
        share = (np.nan_to_num(values, nan=self.low) - self.low) / (self.high - self.low)
        return self._linear_table[np.clip(255 * share, 0, 255).astype(np.uint8)]

    def legend(self, notes: tuple[str, ...] = ()) -> str:
        """HTML: title, bar, both ends and any notes."""
        stops = ", ".join(
            "#" + "".join(f"{round(255 * c):02x}" for c in self._table[i]) for i in np.linspace(0, 255, 12).astype(int)
        )
        below = "".join(f"<div style='margin-top:4px'>{escape(note)}</div>" for note in notes)
        return (
            f"<div data-legend style='padding:4px 12px 8px;font-size:0.8em'><div>{escape(self.title)}</div>"
            f"<div style='height:12px;border-radius:3px;margin:4px 0;background:linear-gradient(to right, {stops})'>"
            "</div><div style='display:flex;justify-content:space-between'>"
            f"<span>{escape(self.low_label)}</span><span>{escape(self.high_label)}</span></div>{below}</div>"
        )
