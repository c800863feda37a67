"""The folder of a run: scene file, garments, pins and body as files that `pb4u simulate` and `pb4u check` read."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .baking import BakedBody, BakedGarment

SCENE = "scene.toml"
BODY = "body.npz"
LIVE = "live"
RESULT = "result.npz"
LOG = "pb4u.log"
MADE_BY = "made_by.txt"
"""Name of the .blend that made the run, as seen from the folder of the run."""


@dataclass(frozen=True)
class GarmentFiles:
    """Where a garment was written.

    Args:
        mesh: OBJ.
        pins: list of vertices, or "none" where a garment is to be held by nothing; None leaves it to the simulation.
    """

    mesh: Path
    pins: Path | None


def file_names(names: Iterable[str]) -> list[str]:
    """A name for each object that every file system takes and no other of them has.

    Args:
        names: of the objects.
    """
    made: list[str] = []
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "garment"
        taken = [other.lower() for other in made]
        number = next(k for k in range(1, len(taken) + 2) if (stem if k == 1 else f"{stem}_{k}").lower() not in taken)
        made.append(stem if number == 1 else f"{stem}_{number}")
    return made


def new_run_folder(parent: Path) -> Path:
    """A folder of its own for a run, numbered after those that are there."""
    parent.mkdir(parents=True, exist_ok=True)
    numbers = [int(each.name[4:]) for each in parent.glob("run_*") if each.name[4:].isdecimal()]
    folder = parent / f"run_{max(numbers, default=0) + 1:04d}"
    folder.mkdir()
    return folder


def write_garments(folder: Path, garments: Sequence[BakedGarment]) -> list[GarmentFiles]:
    """Write an OBJ and the pins of each garment."""
    files = []
    for name, garment in zip(file_names(garment.name for garment in garments), garments, strict=True):
        # Nine digits give back every float32 as it was.
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in garment.vertices.tolist()]
        lines += ["f " + " ".join(str(corner + 1) for corner in polygon.tolist()) for polygon in garment.polygons]
        mesh = folder / f"{name}.obj"
        mesh.write_text("\n".join(lines) + "\n", encoding="ascii")
        pins = None
        if garment.pins is not None:
            pins = folder / f"{name}_pins.txt"
            pins.write_text("\n".join(map(str, garment.pins.tolist())) + "\n", encoding="ascii")
        files.append(GarmentFiles(mesh, pins))
    return files


def write_body(folder: Path, body: BakedBody, fps: float) -> Path:
    """Write the body over the frames."""
    path = folder / BODY
    np.savez(path, vertices=body.positions, faces=body.faces, fps=np.float64(fps))
    return path


def write_scene(
    folder: Path,
    scene: dict[str, Any],
    garments: Sequence[dict[str, Any]],
    run: dict[str, Any],
    environment: dict[str, Any],
) -> Path:
    """Write the scene file; entries that are None are left out.

    Args:
        folder: of the run.
        scene: entries of its first section.
        garments: entries of each garment, inner first.
        run: entries of the section of that name.
        environment: entries of the section of that name.
    """
    sections = [
        ("[scene]", scene),
        *(("[[garments]]", each) for each in garments),
        ("[run]", run),
        ("[environment]", environment),
    ]
    lines = ["format_version = 1"]
    for title, entries in sections:
        lines += ["", title, *(f"{key} = {_toml(value)}" for key, value in entries.items() if value is not None)]
    path = folder / SCENE
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_toml(key)} = {_toml(each)}" for key, each in value.items()) + " }"
    if isinstance(value, Path):
        return json.dumps(value.as_posix(), ensure_ascii=False)
    return json.dumps(value, ensure_ascii=False)
