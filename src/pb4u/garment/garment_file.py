"""Garments from the user's own mesh files."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pb4u.body.built_in import DEFAULT_BODY
from pb4u.body.length_units import extent_of, garment_unit
from pb4u.body.library import body_names
from pb4u.errors import InputError, InputNote, InputWarning, unread_kind, warn
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.garment.pins import resolve_pins
from pb4u.garment.source_map import map_to_same, remeshed
from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.surface_faults import Fault, surface_faults
from pb4u.garment.thread_seams import with_sewn_threads
from pb4u.geometry.mesh_file import MOST_READ, READERS, PolygonMesh, read_mesh

MOST_SIMULATED = 1_000_000
"""Triangles that a garment may have as it is simulated, which bounds time and memory; more are refused."""


def read_garment(
    path: str | Path, material: Material, triangles: int | None = None, pins: str | Path | Sequence[int] | None = None
) -> Garment:
    """The garment in a mesh file; warns of ignored content and unusual meshes.

    Vertex order, polygons and UVs stay in `Garment.source`. Units and axes are never changed.

    Args:
        path: the file.
        material: its cloth.
        triangles: about how many triangles it is remeshed to; None, or as many as it has, for the author's own mesh.
        pins: which vertices follow the body, as for `resolve_pins`; None for none.

    Raises:
        InputError: the file cannot be used; the message gives the remedy.
    """
    garment = authors_garment(path, material, MOST_SIMULATED if triangles is None else MOST_READ)
    if unit := garment_unit(extent_of(garment.vertices)):
        raise InputError(f"{path} {unit}; scale it to metres with {fix_command(path)}.")
    garment = remeshed(garment, triangles)
    return garment if pins is None else garment.with_pins(resolve_pins(pins, garment))


def authors_garment(path: str | Path, material: Material, most_triangles: int = MOST_SIMULATED) -> Garment:
    """The garment in a mesh file with its author's vertices and faces, in any unit; otherwise as `read_garment`.

    Args:
        path: the file.
        material: its cloth.
        most_triangles: number of triangles above which it is refused.

    Raises:
        InputError: the file cannot be used; the message gives the remedy.
    """
    path = Path(path)
    source = read_source(path, most_triangles)
    surface = SourceSurface.of(source)
    _report_faults(path, surface)
    flip, _ = surface.flipped
    faces = np.where(flip[:, None], surface.faces[:, ::-1], surface.faces)
    corners = surface.corners[surface.kept]
    corners = np.where(flip[:, None], corners[:, ::-1], corners)
    simulated = np.unique(faces)
    vertices = source.vertices[simulated]
    faces = np.searchsorted(simulated, faces)
    uv_faces = None if source.polygon_uvs is None else np.concatenate(source.polygon_uvs)[corners]
    polygon, pieces = surface.polygon[surface.kept], source.piece_of_polygon
    looks = None if source.appearances is None else source.appearances.at(polygon)
    garment = Garment(
        path.stem, vertices, faces, material, uvs=source.uvs, uv_faces=uv_faces, appearances=looks,
        source=map_to_same(source, simulated, vertices, faces), pieces=source.pieces,
        piece_of_face=None if pieces is None else pieces[polygon],
    )  # fmt: skip
    return with_sewn_threads(garment, surface, simulated)


def fix_command(
    file: str | Path = "GARMENT.obj", body: str = DEFAULT_BODY, shape: Mapping[str, float] | None = None
) -> str:
    """The command that repairs a garment, for hints.

    Args:
        file: the garment's file.
        body: name or file of the body that wears it.
        shape: its shape parameters that are not at their default, by name.
    """
    is_given = body in body_names() or Path(body).exists()
    worn_by = "" if body == DEFAULT_BODY else f" --body {shlex.quote(body)}" if is_given else " --body BODY"
    if shape:
        worn_by += " --body-shape " + ",".join(f"{name}={value:g}" for name, value in shape.items())
    return f"`pb4u check {shlex.quote(str(file))}{worn_by} --fix OUT.obj`"


def read_source(path: Path, most_triangles: int = MOST_READ) -> PolygonMesh:
    """The mesh in a garment's file, polygons and UVs kept where the format has them (OBJ).

    Args:
        path: the file.
        most_triangles: number of triangles above which it is refused.

    Raises:
        InputError: the file is missing, of another kind, damaged, empty of faces or too large.
    """
    if path.suffix.lower() not in READERS:
        raise unread_kind(path, "garment", (*READERS, "and of sewing patterns .json, .toml, or .npz of `pb4u dress`"))
    if not path.is_file():
        raise InputError(f"There is no garment file {path}.")

    def refuse_large(count: int) -> None:
        if count > MOST_READ:
            raise InputError(
                f"{path} has {count:,} triangles or more; at most {MOST_READ:,} can be read; "
                "decimate it in the program it comes from."
            )
        if count > most_triangles:
            raise InputError(
                f"{path} has {count:,} triangles; at most {most_triangles:,} can be simulated; "
                "ask for fewer with `--triangles N`."
            )

    return read_mesh(path, refuse_large)


def _cure(fault: Fault, path: Path) -> str:
    return f"{fault.fix} with {fix_command(path)}" if fault.mendable else fault.fix


def _report_faults(path: Path, surface: SourceSurface) -> None:
    faults = surface_faults(surface)
    for fault in faults:
        if fault.is_refused:
            raise InputError(f"{path}: {fault.sentence[:-1]}; {_cure(fault, path)}.")
    for fault in faults:
        sentence = f"{path.name}: {fault.sentence[:-1]}; {fault.meanwhile or _cure(fault, path)}."
        warn(sentence, InputNote if fault.is_note else InputWarning)
    sentences = []
    if surface.many_sided:
        cut = "quads or n-gons are cut into triangles to simulate; `pb4u convert --on source` writes them whole"
        sentences.append(f"{surface.many_sided} {cut}.")
    uvs = surface.source.uvs
    if uvs is not None and not np.isfinite(uvs).all():
        sentences.append(f"{(~np.isfinite(uvs)).any(axis=1).sum()} texture coordinates are not finite.")
    for sentence in sentences:
        warn(f"{path.name}: {sentence}")
