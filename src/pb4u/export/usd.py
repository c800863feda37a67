"""USD (.usdc, .usda, .usdz): garment and body as two meshes with time samples, through the "usd" extra."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pb4u.errors import InputError, extra
from pb4u.export.finite_frames import HELD_FRAMES, held_frames
from pb4u.export.incomplete_file import incomplete
from pb4u.export.panels import SewnPanels
from pb4u.export.pieces import Piece, names_apart, part_of_polygon, pieces
from pb4u.export.shading import SKIN, ClothPart, Colour, cloth_parts, unit_normals
from pb4u.geometry.appearance import image_suffix
from pb4u.progress import Progress, no_progress
from pb4u.scene.author_mesh import Polygons
from pb4u.scene.trajectory import Trajectory

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom, UsdShade

    from pb4u.scene.trajectory import TrajectoryHeader

_WITH_IMAGES = (".usdc", ".usda")
"""Suffixes of files that have their images beside them."""
_FRAMES_BETWEEN_SAVES = 100
"""Saving empties the stage's memory of time samples, so it is done before they amount to much."""


def check_usd(path: Path) -> None:
    """Refuse USD where its library is not installed, or where its images could overwrite somebody's own.

    Args:
        path: file to write.

    Raises:
        MissingExtraError: the "usd" extra is not installed.
        InputError: images of such names exist there without a USD file that they could belong to.
    """
    with extra("usd", f"Writing {path.suffix}"):
        import pxr.Usd  # noqa: F401
    if path.suffix.lower() == ".usdz" or any(path.with_suffix(suffix).exists() for suffix in _WITH_IMAGES):
        return
    name = re.compile(re.escape(path.stem) + r"\.texture\d+\.\w+")
    for image in sorted(path.parent.iterdir()):
        if name.fullmatch(image.name):
            raise InputError(f"{image} exists, and an image of {path.name} could need that name: choose another name.")


def write_usd(trajectory: Trajectory, path: Path, progress: Progress = no_progress) -> None:
    """Write one USD stage: /Scene with the meshes Garment and Body, no transforms; metres, Y up, one time code a frame.

    Several garments are meshes below Garment, by their names.
    Points, normals and extent are sampled at every frame; the author's polygons stay polygons; UVs are the
    face-varying `primvars:st`; images are written beside the file as NAME.texture0.png, or into a .usdz. The frames
    that `hold_finite` replaced are listed in the custom layer data.

    Args:
        trajectory: to write, with finite frames only.
        path: file to write: .usdc (binary), .usda (text) or .usdz (a package of one .usdc).
        progress: called with the frames written.

    Raises:
        MissingExtraError: the "usd" extra is not installed.
        InputError: USD cannot write the file.
    """
    check_usd(path)
    from pxr import Tf

    try:
        # Text has to be written in one go, so it is converted from a binary stage that was written in portions.
        with tempfile.TemporaryDirectory(prefix=".usd.", dir=path.parent) as folder:
            suffix = path.suffix.lower()
            binary = path if suffix == ".usdc" else Path(folder) / f"{path.stem}.usdc"
            _write_binary(trajectory, binary, binary if suffix == ".usdz" else path, progress)
            if suffix == ".usda":
                _to_text(binary, path)
            elif suffix == ".usdz":
                _package(binary, path)
    except Tf.ErrorException as error:
        # Its own words name places in its source; what fails here is the disk.
        raise incomplete(path) from error


def _write_binary(trajectory: Trajectory, path: Path, beside: Path, progress: Progress) -> None:
    """Write a binary stage at `path`, and its images beside `beside`."""
    from pxr import Usd, UsdGeom

    header = trajectory.header
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(trajectory.fps)
    stage.SetFramesPerSecond(trajectory.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(trajectory.frame_count - 1)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Scene").GetPrim())
    frames = held_frames(trajectory)
    if frames:
        stage.GetRootLayer().customLayerData = {"pb4u": {HELD_FRAMES: _ints(frames)}}
    garment_pieces, parts, garments = pieces(header), cloth_parts(header), []
    images: dict[bytes, str] = {}
    if len(garment_pieces) > 1:
        UsdGeom.Xform.Define(stage, "/Scene/Garment")
    for piece, prim in zip(garment_pieces, _prims([piece.name for piece in garment_pieces]), strict=True):
        outlines = piece.header.outlines
        looks = piece.looks(parts)
        mesh = _define(stage, prim, outlines, looks[0].colour)
        mesh.GetPrim().SetDisplayName(piece.name)
        if len(looks) > 1 or header.appearances is not None:
            _colour_cloth(stage, mesh, piece, looks, images, beside)
        _add_uvs(mesh, piece.header.uvs, outlines.uv_corners)
        _add_panels(mesh, piece.header)
        garments.append((piece.vertices, _AnimatedMesh(mesh, piece.header.faces)))
    skin = Polygons.of_triangles(header.body_faces, None)
    body = _AnimatedMesh(_define(stage, "/Scene/Body", skin, SKIN), header.body_faces)
    for t, (positions, body_positions) in enumerate(zip(trajectory.positions, trajectory.body_positions, strict=True)):
        for vertices, garment in garments:
            garment.sample(t, positions[vertices])
        body.sample(t, body_positions)
        if t % _FRAMES_BETWEEN_SAVES == _FRAMES_BETWEEN_SAVES - 1:
            stage.Save()
        progress(t + 1, trajectory.frame_count)
    stage.Save()


@dataclass(frozen=True)
class _AnimatedMesh:
    """A mesh of the stage, and the triangles that its normals come from."""

    mesh: UsdGeom.Mesh
    faces: np.ndarray

    def sample(self, t: int, positions: np.ndarray) -> None:
        from pxr import UsdGeom, Vt

        # A copy, because frames mapped from a file may lie at odd addresses, which USD refuses.
        points = Vt.Vec3fArray.FromNumpy(np.array(positions, dtype=np.float32))
        self.mesh.GetPointsAttr().Set(points, t)
        self.mesh.GetNormalsAttr().Set(Vt.Vec3fArray.FromNumpy(unit_normals(positions, self.faces)), t)
        self.mesh.GetExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), t)


def _linear(colour: Colour) -> Colour:
    """A colour as USD takes it, from sRGB [0 to 1]."""
    red, green, blue = (float(channel) ** 2.2 for channel in colour)
    return red, green, blue


def _define(stage: Usd.Stage, name: str, polygons: Polygons, colour: Colour) -> UsdGeom.Mesh:
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, name)
    mesh.CreateFaceVertexCountsAttr(_ints(polygons.sizes))
    mesh.CreateFaceVertexIndicesAttr(_ints(polygons.corners))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreatePointsAttr()
    mesh.CreateNormalsAttr()
    mesh.CreateExtentAttr()
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateDisplayColorAttr(Vt.Vec3fArray([_linear(colour)]))
    return mesh


def _prims(names: Sequence[str]) -> list[str]:
    """Where the meshes of garments of these names stand: one is the garment, several are below it."""
    from pxr import Tf

    if len(names) == 1:
        return ["/Scene/Garment"]
    return [f"/Scene/Garment/{name}" for name in names_apart([Tf.MakeValidIdentifier(name) for name in names], "_")]


def _colour_cloth(
    stage: Usd.Stage,
    mesh: UsdGeom.Mesh,
    piece: Piece,
    parts: Sequence[ClothPart],
    images: dict[bytes, str],
    path: Path,
) -> None:
    """Display colours polygon by polygon; a material of each part where there are several, or where authors gave one.

    Images lie beside the file.
    """
    from pxr import UsdGeom, UsdShade, Vt

    of_polygon = part_of_polygon(piece.header, parts)
    colours = np.array([_linear(part.colour) for part in parts])[of_polygon].astype(np.float32)
    mesh.CreateDisplayColorAttr(Vt.Vec3fArray.FromNumpy(colours))
    UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor").SetInterpolation(UsdGeom.Tokens.uniform)
    mesh_name = mesh.GetPrim().GetName()
    for k, part in enumerate(parts if piece.header.appearances is not None or len(parts) > 1 else ()):
        if part.image is not None and part.image not in images:
            images[part.image] = f"{path.stem}.texture{len(images)}{image_suffix(part.image)}"
            path.with_name(images[part.image]).write_bytes(part.image)
        subset = UsdGeom.Subset.CreateGeomSubset(
            mesh, f"part_{k}", UsdGeom.Tokens.face, _ints(np.flatnonzero(of_polygon == k)), "materialBind"
        )
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(
            _material(stage, f"part_{k}" if mesh_name == "Garment" else f"{mesh_name}_{k}", part, images)
        )


def _material(stage: Usd.Stage, leaf: str, part: ClothPart, images: dict[bytes, str]) -> UsdShade.Material:
    """A preview surface of the part's colour, or of its image, by the name of its file."""
    from pxr import Gf, Sdf, UsdShade

    name = f"/Scene/Materials/{leaf}"
    material = UsdShade.Material.Define(stage, name)
    material.GetPrim().SetDisplayName(part.name)
    surface = UsdShade.Shader.Define(stage, f"{name}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.85)
    linear = _linear(part.colour)
    colour = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    colour.Set(Gf.Vec3f(*linear))
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    if part.image is not None:
        reader, image = (UsdShade.Shader.Define(stage, f"{name}/{part_name}") for part_name in ("st", "image"))
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        image.CreateIdAttr("UsdUVTexture")
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(f"./{images[part.image]}")
        image.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*linear, 1.0))
        for axis in ("wrapS", "wrapT"):
            image.CreateInput(axis, Sdf.ValueTypeNames.Token).Set("repeat")
        image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        colour.ConnectToSource(image.ConnectableAPI(), "rgb")
    return material


def _add_uvs(mesh: UsdGeom.Mesh, uvs: np.ndarray | None, uv_corners: np.ndarray | None) -> None:
    if uvs is None or uv_corners is None:
        return
    from pxr import Sdf, UsdGeom, Vt

    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set(Vt.Vec2fArray.FromNumpy(np.array(uvs, dtype=np.float32)))
    st.SetIndices(_ints(uv_corners))


def _add_panels(mesh: UsdGeom.Mesh, header: TrajectoryHeader) -> None:
    """Subsets of faces that are the panels of a sewn garment, and one of edges, its seams."""
    panels = SewnPanels.of(header)
    if panels is None:
        return
    from pxr import UsdGeom

    for number, name in enumerate(panels.names):
        faces, prim = _ints(np.flatnonzero(panels.of_face == number)), f"panel_{number}"
        subset = UsdGeom.Subset.CreateGeomSubset(mesh, prim, UsdGeom.Tokens.face, faces, "panels")
        subset.GetPrim().SetDisplayName(name)
    UsdGeom.Subset.CreateGeomSubset(mesh, "seams", UsdGeom.Tokens.edge, _ints(panels.seams), "seams")


def _to_text(binary: Path, path: Path) -> None:
    from pxr import Sdf

    if not Sdf.Layer.FindOrOpen(str(binary)).Export(str(path)):
        raise incomplete(path)


def _package(binary: Path, path: Path) -> None:
    from pxr import UsdUtils

    if not UsdUtils.CreateNewUsdzPackage(str(binary), str(path)):
        raise incomplete(path)


def _ints(values: Any) -> Any:
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.array(np.ravel(values), dtype=np.int32))
