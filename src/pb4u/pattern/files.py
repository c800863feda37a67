"""Garments of pattern files (`.json`, `.toml`), and of dressed garments kept with their pattern (`.npz`)."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.errors import InputError, warn
from pb4u.export.panels import seam_edges
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import group_name, write_obj
from pb4u.io.array_archive import read_arrays
from pb4u.io.atomic_file import json_text, replace_file
from pb4u.io.cache_folder import cache_folder
from pb4u.io.reading_limits import parse_json
from pb4u.io.stored_numbers import Layout, read_members, require_places
from pb4u.pattern.drawing import draw_pattern
from pb4u.pattern.dressing import DEFAULT_TRIANGLES, Dressed, dress, passed_on
from pb4u.pattern.garmentcode import pattern_of, read_specification, record_of
from pb4u.pattern.mesh import PatternMesh
from pb4u.pattern.pattern import Pattern
from pb4u.pattern.svg import read_drawn

FORMAT_VERSION = 1
"""Format of a dressed garment's file."""

ALGORITHM = 9
"""To be raised whenever `dress` gives different garments: those that are kept are then dressed again."""

_LAYOUT: Layout = {
    "format_version": ("iu", ()),
    "pattern": ("U", ()),
    "body": ("U", ()),
    "body_key": ("U", ()),
    "points": ("f", ("points", 2)),
    "panel": ("iu", ("points",)),
    "faces": ("iu", ("faces", 3)),
    "vertex": ("iu", ("points",)),
    "vertices": ("f", ("vertices", 3)),
}


def load_worn(
    path: str | Path, body: ShapedBody | VertexSequence, material: Material, triangles: int | None = None
) -> Garment:
    """The garment of a pattern or of a dressed garment, on a body.

    A pattern is dressed first, and cached; a dressed garment is dressed again if it was made on another body, and only
    meshed again for another number of triangles.

    Args:
        path: a pattern (`.json`, `.toml`) or a dressed garment (`.npz`).
        body: the body that wears it.
        material: the cloth.
        triangles: wanted number of triangles; None means 5,000, or the number of the dressed garment.

    Raises:
        InputError: the file cannot be read, or the pattern cannot be dressed on this body.
    """
    path = Path(path)
    if not isinstance(body, ShapedBody):
        raise InputError(
            f"{path.name} is a sewing pattern, which is dressed on a body with bones; {body.name} is a sequence of "
            "vertices: dress it on the body that the sequence was made with, and give that as an OBJ."
        )
    if path.suffix.lower() != ".npz":
        return dressed_once(read_pattern(path), body, material, triangles or DEFAULT_TRIANGLES)
    mesh, places, made_on = read_dressed(path)
    if made_on[1] != body_key(body):
        warn(f"{path.name} was dressed on {made_on[0]}; it is dressed again on {body.name}.")
        return dressed_once(mesh.pattern, body, material, triangles or len(mesh.faces))
    return passed_on(mesh, places, body, material, triangles)


def dressed_once(pattern: Pattern, body: ShapedBody, material: Material, triangles: int) -> Garment:
    """The result of `dress`, read from the user's cache if it exists.

    Args:
        pattern: as for `dress`, as the other arguments.
        body: the body.
        material: the cloth.
        triangles: wanted number.
    """
    text = f"{ALGORITHM} {triangles} {material} {body_key(body)} {json.dumps(record_of(pattern))}"
    path = cache_folder() / "dressed" / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"
    with contextlib.suppress(InputError, OSError):
        mesh, places, _ = read_dressed(path)
        # Its name is no part of the address.
        return passed_on(replace(mesh, pattern=pattern), places, body, material, None)
    dressed = dress(pattern, body, triangles, material)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_dressed(path, dressed, body)
    return dressed.garment


def body_key(body: ShapedBody) -> str:
    """Key that differs between resting bodies.

    Args:
        body: the resting body.
    """
    digest = hashlib.sha256(np.ascontiguousarray(body.vertices).tobytes())
    digest.update(np.ascontiguousarray(body.faces).tobytes())
    return digest.hexdigest()[:32]


def write_dressed(path: str | Path, dressed: Dressed, body: ShapedBody) -> None:
    """Write a dressed garment with its pattern to an `.npz`, written beside and moved into place.

    Args:
        path: the file.
        dressed: the garment.
        body: the body that it was dressed on.

    Raises:
        OSError: it cannot be written.
    """
    mesh, stream = dressed.mesh, io.BytesIO()
    np.savez_compressed(
        stream,
        format_version=np.array(FORMAT_VERSION),
        pattern=np.array(json.dumps({"name": mesh.pattern.name, **record_of(mesh.pattern)})),
        body=np.array(body.name),
        body_key=np.array(body_key(body)),
        points=mesh.points,
        panel=mesh.panel,
        faces=mesh.faces,
        vertex=mesh.vertex,
        vertices=dressed.garment.vertices,
    )
    replace_file(Path(path), stream.getvalue())


def read_dressed(path: str | Path) -> tuple[PatternMesh, np.ndarray, tuple[str, str]]:
    """The mesh of a dressed garment, its vertices (vertices, 3) [m], and the name and key of the body it was made on.

    Args:
        path: the `.npz` file.

    Raises:
        InputError: it is not a file of a dressed garment, or a damaged one.
    """
    path = Path(path)
    members = read_arrays(path, _LAYOUT)

    def refuse(what: str) -> InputError:
        return InputError(
            f"{path} is not a dressed garment: {what}; make one with `pb4u dress PATTERN.json --out FILE`."
        )

    counts = read_members(members, _LAYOUT, refuse)[1]
    if int(members["format_version"]) != FORMAT_VERSION:
        raise InputError(f"{path} is of a newer format; update pb4u to read it.")
    require_places(members, {"faces": "points", "vertex": "vertices"}, counts, refuse)
    if not all(np.isfinite(members[name]).all() for name in ("points", "vertices")):
        raise refuse("it holds numbers that are not finite")
    try:
        record = parse_json(str(members["pattern"]))
        pattern = pattern_of(record, str(record["name"]))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError):
        raise refuse("its pattern cannot be read") from None
    if counts["points"] and not 0 <= members["panel"].min() <= members["panel"].max() < len(pattern.panels):
        raise refuse("it names panels that its pattern does not have")
    numbers = {name: members[name].astype(np.int64) for name in ("panel", "faces", "vertex")}
    mesh = PatternMesh(pattern, members["points"].astype(np.float64), **numbers, sides=())
    return mesh, members["vertices"].astype(np.float64), (str(members["body"]), str(members["body_key"]))


def read_pattern(path: str | Path) -> Pattern:
    """The pattern of a file.

    Args:
        path: a specification of GarmentCode (`.json`), a drawn pattern (`.toml`, which names its SVG) or a dressed
            garment (`.npz`).

    Raises:
        InputError: it cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no pattern {path}.")
    kind = path.suffix.lower()
    if kind not in (".toml", ".npz", ".json"):
        raise InputError(f"{path} is not a sewing pattern; those are .json, .toml or the .npz of `pb4u dress`.")
    if kind == ".toml":
        return read_drawn(path)
    return read_dressed(path)[0].pattern if kind == ".npz" else read_specification(path)


def write_worn(path: Path, dressed: Dressed, body: ShapedBody) -> None:
    """Write a dressed garment, or its pattern, in the kind of file that the name says.

    Args:
        path: `.npz` has the garment with its pattern, `.obj` its mesh with the pattern as UVs; `.json` is the pattern,
            `.svg` and `.png` are pictures of it.
        dressed: the garment.
        body: the body that wears it.

    Raises:
        InputError: a file of another kind.
    """
    kind, garment = path.suffix.lower(), dressed.garment
    if kind == ".npz":
        write_dressed(path, dressed, body)
    elif kind == ".obj":
        mesh = PolygonMesh(garment.vertices, tuple(garment.faces), garment.uvs, tuple(dressed.mesh.faces))
        groups = [group_name(garment.panels[k]) for k in dressed.mesh.face_panel]
        write_obj(path, mesh, groups, seam_edges(garment.faces, dressed.mesh.faces))
    elif kind == ".json":
        replace_file(path, json_text(record_of(dressed.mesh.pattern), indent=1).encode())
    elif kind in (".svg", ".png"):
        draw_pattern(dressed.mesh.pattern, path)
    else:
        raise InputError(f"A dressed garment is written as .npz, .obj, .json, .svg or .png; {path} has another suffix.")
