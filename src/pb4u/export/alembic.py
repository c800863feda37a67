"""Alembic (.abc): garments and body, each a polygon mesh sampled at every frame, through the "abc" extra."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pb4u.errors import extra
from pb4u.export.incomplete_file import incomplete
from pb4u.export.pieces import names_apart, part_of_polygon, pieces
from pb4u.export.shading import cloth_parts, unit_normals
from pb4u.progress import Progress, no_progress
from pb4u.scene.author_mesh import Polygons

if TYPE_CHECKING:
    from pb4u.scene.trajectory import Trajectory


def check_alembic(path: Path) -> None:
    """Refuse Alembic where its library is not installed.

    Args:
        path: file to write, for the message.

    Raises:
        MissingExtraError: the "abc" extra is not installed.
    """
    with extra("abc", f"Writing {path.suffix}"):
        import alembic3d  # noqa: F401
        import imath  # noqa: F401


def write_alembic(trajectory: Trajectory, path: Path, progress: Progress = no_progress) -> None:
    """Write one Ogawa archive: /Garment and /Body; metres, Y up, one sample every 1 / fps seconds from 0.

    Each garment and the body is a transform that is the identity, with one mesh below it: /Garment/GarmentShape. Maya
    does not show a mesh at the top level, and treats a transform with several meshes as one object. A garment of
    several fabrics has a face set for each. Points and vertex normals are sampled at every frame; the author's polygons
    stay polygons, wound clockwise as Alembic has them; UVs are face-varying, one a corner.

    Args:
        trajectory: to write, with finite frames only.
        path: file to write.
        progress: called with the frames written.

    Raises:
        MissingExtraError: the "abc" extra is not installed.
        InputError: the file cannot be written.
    """
    check_alembic(path)
    if "fork" in multiprocessing.get_all_start_methods():
        # Where the disk takes no more, the library ends its process: another one than this writes.
        writer = multiprocessing.get_context("fork").Process(target=_write_quietly, args=(trajectory, path))
        writer.start()
        writer.join()
        if writer.exitcode:
            raise incomplete(path)
    else:
        _write(trajectory, path)
    progress(trajectory.frame_count, trajectory.frame_count)


def _write_quietly(trajectory: Trajectory, path: Path) -> None:
    """Write without what the library says on standard error when it ends its process."""
    import torch

    # Threads of the process that this one was forked from are not here, and would be waited for.
    torch.set_num_threads(1)
    faulthandler.disable()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    _write(trajectory, path)


def _write(trajectory: Trajectory, path: Path) -> None:
    from alembic3d import Abc, AbcCoreAbstract

    header, fps = trajectory.header, float(trajectory.fps)
    archive = Abc.CreateArchiveWithInfo(str(path), fps, "pb4u", "metres, Y up")
    # The library crashes on a sampling that is handed to a mesh; the archive takes it, and meshes name its index.
    sampling = archive.addTimeSampling(AbcCoreAbstract.TimeSampling(1.0 / fps, 0.0))
    top = archive.getTop()
    cloths = pieces(header)
    body_name, *names = names_apart(["Body", *(piece.name.replace("/", " ") for piece in cloths)], " ")
    garments = []
    looks = cloth_parts(header)
    for name, piece in zip(names, cloths, strict=True):
        section = piece.header
        mesh = _Mesh(top, name, section.outlines, section.faces, section.uvs, sampling)
        parts = piece.looks(looks)
        if len(parts) > 1:
            of_polygon = part_of_polygon(section, parts)
            for k, part in enumerate(parts):
                mesh.name_faces(part.name.replace("/", " "), np.flatnonzero(of_polygon == k))
        garments.append((piece.vertices, mesh))
    skin = Polygons.of_triangles(header.body_faces, None)
    body = _Mesh(top, body_name, skin, header.body_faces, None, sampling)
    for positions, body_positions in zip(trajectory.positions, trajectory.body_positions, strict=True):
        for vertices, garment in garments:
            garment.sample(positions[vertices])
        body.sample(body_positions)


class _Mesh:
    """A mesh of the archive under a transform of its own, written sample by sample.

    Args:
        parent: object that the transform hangs from.
        name: of the transform; that of the mesh has "Shape" after it.
        outlines: polygons, counter-clockwise.
        faces: (faces, 3) triangles that normals come from.
        uvs: (uv points, 2) that `outlines.uv_corners` names, or None.
        sampling: index of the time sampling in the archive.
    """

    def __init__(
        self, parent: Any, name: str, outlines: Polygons, faces: np.ndarray, uvs: np.ndarray | None, sampling: int
    ) -> None:
        import imath
        from alembic3d import AbcGeom

        self._faces = faces
        self._transform = AbcGeom.OXform(parent, name)
        self._transform.getSchema().set(AbcGeom.XformSample())
        self._mesh = AbcGeom.OPolyMesh(self._transform, f"{name}Shape")
        self._schema = self._mesh.getSchema()
        self._schema.setTimeSampling(sampling)
        ends = np.cumsum(outlines.sizes)
        # Corner k of a polygon that begins at s and ends before e goes to s + e - 1 - k.
        mirrored = np.repeat(2 * ends - outlines.sizes - 1, outlines.sizes) - np.arange(int(outlines.sizes.sum()))
        self._counts = _ints(imath, outlines.sizes)
        self._corners = _ints(imath, outlines.corners[mirrored])
        self._uvs: Any = None
        self._sets: list[Any] = []
        if uvs is not None and outlines.uv_corners is not None:
            # A plain list of a UV a corner: indexed ones are taken by fewer readers.
            points = _vectors("V2f", uvs[outlines.uv_corners[mirrored]])
            self._uvs = AbcGeom.OV2fGeomParamSample(points, AbcGeom.GeometryScope.kFacevaryingScope)

    def name_faces(self, name: str, polygons: np.ndarray) -> None:
        """Make a face set of some of its polygons (n,)."""
        import imath
        from alembic3d import AbcGeom

        self._sets.append(self._schema.createFaceSet(name))
        self._sets[-1].getSchema().set(AbcGeom.OFaceSetSchemaSample(_ints(imath, polygons)))

    def sample(self, positions: np.ndarray) -> None:
        """Add a frame of (vertices, 3) positions [m]."""
        from alembic3d import AbcGeom

        points = _vectors("V3f", positions)
        normals = _vectors("V3f", unit_normals(positions, self._faces))
        shaded = AbcGeom.ON3fGeomParamSample(normals, AbcGeom.GeometryScope.kVertexScope)
        uvs = AbcGeom.OV2fGeomParamSample() if self._uvs is None else self._uvs
        self._schema.set(AbcGeom.OPolyMeshSchemaSample(points, self._corners, self._counts, uvs, shaded))


def _ints(imath: Any, values: np.ndarray) -> Any:
    return imath.IntArrayFromBuffer(np.array(values, dtype=np.int32))


def _vectors(kind: str, values: np.ndarray) -> Any:
    import imath

    return getattr(imath, f"{kind}ArrayFromBuffer")(np.array(values, dtype=np.float32))
