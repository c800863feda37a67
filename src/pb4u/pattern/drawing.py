"""A picture of a pattern: panels laid out to scale, edges by number, seams in one colour on both their sides."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from pb4u.io.atomic_file import replace_file
from pb4u.pattern.layout import laid_out
from pb4u.pattern.pattern import Pattern

_INWARDS = 0.012
"""Distance [m] of the number of an edge from it."""

_FINE = np.linspace(0.0, 1.0, 33)


def draw_pattern(pattern: Pattern, path: Path) -> None:
    """Draw a pattern; a seam has one number and colour on both its edges, hems and other open edges are black.

    Each panel shows the numbers of its edges, as used in messages and seams.

    Args:
        pattern: to draw.
        path: `.svg` or `.png` file.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    outlines = [[panel.edge_points(k, _FINE) for k in range(panel.edge_count)] for panel in pattern.panels]
    loops = [np.concatenate(edges) for edges in outlines]
    moves, side = laid_out([(loop.min(axis=0), loop.max(axis=0)) for loop in loops])
    sewn = {at: number for number, seam in enumerate(pattern.seams) for at in (seam.first, seam.second)}
    figure = Figure(figsize=(10, 10), layout="constrained")
    axes = figure.add_subplot()
    for panel, edges, loop, move in zip(pattern.panels, outlines, loops, moves, strict=True):
        axes.fill(*(loop + move).T, color="0.93", linewidth=0)
        axes.annotate(panel.name, np.median(loop, axis=0) + move, ha="center", color="0.4", fontsize=8)
        for k, edge in enumerate(edges):
            number = sewn.get((panel.name, k))
            colour = "black" if number is None else colormaps["tab20"](number % 20)
            axes.plot(*(edge + move).T, color=colour, linewidth=1.0 if number is None else 2.0)
            middle, way = edge[len(edge) // 2], edge[len(edge) // 2 + 1] - edge[len(edge) // 2 - 1]
            inwards = np.sign(panel.area) * np.array([-way[1], way[0]]) / np.hypot(*way)
            axes.annotate(str(k), middle + move + _INWARDS * inwards, ha="center", va="center", color="0.5", fontsize=5)
            if number is not None:
                axes.annotate(str(number), edge[len(edge) // 2] + move, color=colour, fontsize=6)
    axes.set(xlim=(0.0, side), ylim=(0.0, side), aspect="equal", title=pattern.name, xlabel="m", ylabel="m")
    stream = io.BytesIO()
    figure.savefig(stream, format=path.suffix[1:].lower(), dpi=150)
    replace_file(path, stream.getvalue())
