"""Materials of the cloth simulator ARCSim, as in the database of Wang, O'Brien and Ramamoorthi (2011)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError

_SECOND_STRETCH = 1.0 / 6.0
"""Stretch of the later rows of a table; between it and none ARCSim mixes them."""


def is_arcsim(record: Mapping[str, Any]) -> bool:
    """Whether a material file is one of ARCSim.

    Args:
        record: the object of the file.
    """
    return "stretching" in record


def arcsim_fields(record: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Fields of `Material` that ARCSim's file amounts to.

    Its u is the weft. The rows of `stretching` hold c11, c12, c22 and c33 [N/m]: at rest, and at a stretch of 1/6 along
    0, 22.5, 45, 67.5 and 90 degrees. As its code computes, the moduli are twice the first row, nothing below zero, and
    the shear is its fourth number. Threads stiffen so that the force at the second stretch is that of the later rows,
    in the mean of both threads. `bending` holds coefficients of hinges [J] with edges along the weft, at 45 degrees and
    along the warp, at five curvatures, which are averaged.

    Args:
        record: the object of the file.
        path: the file, for messages.

    Raises:
        InputError: it lacks a member, or one has another shape.
    """
    if unknown := sorted(set(record) - {"density", "stretching", "bending"}):
        raise InputError(f"The ARCSim material {path} has unknown entries {unknown}: use density, stretching, bending.")
    tables = {name: _table(record, name, shape, path) for name, shape in (("stretching", (6, 4)), ("bending", (3, 5)))}
    density = record.get("density")
    if isinstance(density, bool) or not isinstance(density, int | float):
        raise InputError(f'In the ARCSim material {path}, "density" must be a number, not {density!r}.')
    moduli = 2.0 * np.maximum(tables["stretching"], 0.0)
    weft, coupling, warp, _ = moduli[0]
    growth = 0.5 * (moduli[1, 0] - weft + moduli[5, 2] - warp)
    along_warp, bias, along_weft = 0.25 * tables["bending"].mean(axis=1)
    return {
        "density": float(density),
        "warp_stiffness": float(warp),
        "weft_stiffness": float(weft),
        "coupling_stiffness": float(coupling),
        "shear_stiffness": float(max(tables["stretching"][0, 3], 0.0)),
        "bending_stiffness": {"warp": float(along_warp), "weft": float(along_weft), "bias": float(bias)},
        "stiffening_stiffness": max(2.0 * float(growth) / _SECOND_STRETCH, 0.0),
        "source": f"{path.name}, of ARCSim",
    }


def _table(record: Mapping[str, Any], name: str, shape: tuple[int, int], path: Path) -> np.ndarray:
    try:
        table = np.array(record.get(name), dtype=np.float64)
    except (TypeError, ValueError):
        table = np.zeros(0)
    if table.shape != shape or not np.isfinite(table).all():
        rows, columns = shape
        raise InputError(f'In the ARCSim material {path}, "{name}" must be {rows} rows of {columns} numbers.')
    return table
