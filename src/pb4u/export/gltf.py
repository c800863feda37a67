"""GLB (glTF 2.0): garment and body as two meshes whose morph targets are animated by weights.

One target a frame would be exact, but grow with the clip beyond what viewers take (a texture layer each in most).
Instead each surface gets the few targets that reproduce all of its frames to within a millimetre (`shape_basis`),
and a weight for each at every frame, interpolated in straight lines. The error is stated in the `extras` of the mesh.
Engines that play no morph targets take bones instead (`bone_baking`).
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.errors import warn
from pb4u.export.bone_baking import BakedBones, bake_bones
from pb4u.export.finite_frames import HELD_FRAMES, held_frames
from pb4u.export.panels import SewnPanels
from pb4u.export.pieces import pieces
from pb4u.export.sewing_lines import sewn_parts
from pb4u.export.shading import SKIN, ClothPart
from pb4u.export.shape_basis import ShapeBasis, fit_shapes
from pb4u.geometry.appearance import image_suffix
from pb4u.io.gltf_file import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    FLOAT,
    UNSIGNED_INT,
    UNSIGNED_SHORT,
    GltfDocument,
    glb_head,
)
from pb4u.progress import Progress, no_progress
from pb4u.scene.author_mesh import split_seams
from pb4u.scene.trajectory import Trajectory

_TOLERANCE = 1e-3
"""Largest distance of a vertex from the trajectory [m]: less than can be seen beside a body."""
_MOST_TARGETS = 256
"""Texture layers that every WebGL 2 device has."""


def write_glb(
    trajectory: Trajectory,
    path: Path,
    progress: Progress = no_progress,
    body: bool = True,
    bones: int | None = None,
) -> str | None:
    """Write one GLB file; vertices keep their order, copies with a second UV at a seam follow after the last.

    The frames that `hold_finite` replaced are listed in the `extras` of the asset. An InputWarning says if 256 targets
    leave an error above a millimetre.

    Args:
        trajectory: to write, with finite frames only.
        path: file to write.
        progress: called after each pass over the frames.
        body: whether the body is written as well.
        bones: number of bones of each surface, used instead of morph targets because game engines play bones.

    Returns:
        How far off bones leave the garment, as a predicate without its subject; None without them.
    """
    header, frames = trajectory.header, trajectory.frame_count
    cloths, (cloth, _) = pieces(header), sewn_parts(header)
    body = body and len(header.body_faces) > 0
    passes = len(cloths) + body
    binary = path.with_name(f"{path.name}.bin")
    try:
        with binary.open("wb") as file:
            document = _Document(file, trajectory, bones)
            for number, piece in enumerate(cloths):
                part = piece.header
                document.add_surface(
                    "garment" if len(cloths) == 1 else piece.name, trajectory.positions[:, piece.vertices], part.faces,
                    (part.uvs, part.uv_faces), piece.looks(cloth), _part(progress, number * frames, passes),
                    SewnPanels.of(part),
                )  # fmt: skip
            if body:
                skin = [ClothPart("body", np.arange(len(header.body_faces)), SKIN)]
                document.add_surface(
                    "body", trajectory.body_positions, header.body_faces, (None, None), skin,
                    _part(progress, len(cloths) * frames, passes),
                )  # fmt: skip
            described = document.finished()
        _assemble(described, binary, path)
    finally:
        binary.unlink(missing_ok=True)
    return None if document.farthest is None else _told_of(document.farthest)


def _part(progress: Progress, before: int, passes: int) -> Progress:
    return lambda done, total: progress(before + done, passes * total)


def _assemble(document: dict[str, Any], binary: Path, path: Path) -> None:
    with path.open("wb") as out, binary.open("rb") as data:
        out.write(glb_head(document, binary.stat().st_size))
        shutil.copyfileobj(data, out, 1 << 20)


def _told_of(baked: BakedBones) -> str:
    """How far off its bones leave the garment, as a predicate without its subject."""
    return (
        f"has {len(baked.centres)} bones, which leave the garment {1000 * baked.rms_error:.1f} mm off "
        f"(root mean square) and {1000 * baked.largest_error:.1f} mm at most."
    )


class _Document(GltfDocument):
    """A glTF file of moving surfaces."""

    def __init__(self, file: BinaryIO, trajectory: Trajectory, bones: int | None) -> None:
        super().__init__(file)
        self._bones = bones
        self.farthest: BakedBones | None = None
        self._frames = trajectory.frame_count
        self._times: int | None = None
        self._seconds = (np.arange(self._frames) / trajectory.fps).astype(np.float32)
        if frames := held_frames(trajectory):
            self.json["asset"]["extras"] = {HELD_FRAMES: frames}
        self._textures: dict[bytes, int] = {}
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []

    def add_surface(
        self,
        name: str,
        positions: np.ndarray,
        faces: np.ndarray,
        uv: tuple[np.ndarray | None, np.ndarray | None],
        looks: Sequence[ClothPart],
        progress: Progress,
        panels: SewnPanels | None = None,
    ) -> None:
        """Add a node with a mesh, its morph targets and their weights over time.

        Args:
            name: of the node.
            positions: (frames, vertices, 3) [m].
            faces: (faces, 3) int64.
            uv: UV points (uv points, 2) and UV faces (faces, 3), or None for each.
            looks: its parts, each of which has a primitive and a material of its own.
            progress: called with (passes done, passes in all).
            panels: of a sewn garment: the attribute `_PANEL` of a vertex, names and seams in the extras of the mesh.
        """
        # With bones the first frame alone is a shape.
        shown = positions if self._bones is None else positions[:1]
        basis = fit_shapes(shown, faces, _TOLERANCE, _MOST_TARGETS, progress)
        if basis.error > _TOLERANCE:
            warn(
                f"{_MOST_TARGETS} morph targets leave the {name} up to {1000 * basis.error:.1f} mm from the "
                "trajectory; write a shorter range, or USD, which is exact.",
            )
        baked = None if self._bones is None else bake_bones(np.asarray(positions), self._bones, progress)
        of_vertex, corners, uvs = split_seams(len(basis.start), faces, *uv)
        extras: dict[str, Any] = {"largest_error": basis.error}
        attributes = self._attributes(basis, of_vertex, uvs)
        if panels is not None:
            attributes["_PANEL"] = self._panels(panels, of_vertex, corners)
            extras |= {"panels": panels.names, "seams": panels.seams.ravel().tolist()}
        if baked is not None:
            attributes |= self._joints(baked, of_vertex)
        primitives = self._primitives(attributes, corners, looks)
        mesh: dict[str, Any] = {"name": name, "primitives": primitives, "extras": extras}
        node = len(self.json["nodes"])
        if len(basis.shapes):
            targets = self._morph_targets(basis, of_vertex)
            for primitive in primitives:
                primitive["targets"] = targets
            mesh["weights"] = [0.0] * len(basis.shapes)
            extras["targetNames"] = [f"shape {k}" for k in range(len(basis.shapes))]
            self._animate(node, "weights", basis.weights.reshape(-1), "SCALAR")
        self.json["nodes"].append({"name": name, "mesh": len(self.json["meshes"])})
        self.json["scenes"][0]["nodes"].append(node)
        self.json["meshes"].append(mesh)
        if baked is not None:
            self._add_skin(node, baked)
            extras |= {"largest_error": baked.largest_error, "rms_error": baked.rms_error}
            if name != "body" and (self.farthest is None or baked.rms_error > self.farthest.rms_error):
                self.farthest = baked

    def _attributes(self, basis: ShapeBasis, of_vertex: np.ndarray, uvs: np.ndarray | None) -> dict[str, int]:
        """Places, normals and UVs of the written vertices, copies of those `of_vertex` (written,)."""
        attributes = {
            "POSITION": self.add_vectors(basis.start[of_vertex], bounded=True),
            "NORMAL": self.add_vectors(basis.start_normals[of_vertex]),
        }
        if uvs is not None:
            attributes["TEXCOORD_0"] = self.add_vectors(uvs * (1.0, -1.0) + (0.0, 1.0))  # v downward
        return attributes

    def _panels(self, panels: SewnPanels, of_vertex: np.ndarray, corners: np.ndarray) -> int:
        """The panel of each written vertex, a corner of faces `corners` (faces, 3); -1 for none."""
        of_written = np.full(len(of_vertex), -1.0, dtype="<f4")
        of_written[corners] = panels.of_face[:, None]
        return self.add(of_written, "SCALAR", FLOAT, ARRAY_BUFFER)

    def _joints(self, baked: BakedBones, of_vertex: np.ndarray) -> dict[str, int]:
        """The bones of each written vertex and their weights."""
        joints, weights = baked.joints[of_vertex].astype("<u2"), baked.weights[of_vertex].astype("<f4")
        return {
            "JOINTS_0": self.add(joints, "VEC4", UNSIGNED_SHORT, ARRAY_BUFFER),
            "WEIGHTS_0": self.add(weights, "VEC4", FLOAT, ARRAY_BUFFER),
        }

    def _primitives(
        self, attributes: dict[str, int], corners: np.ndarray, looks: Sequence[ClothPart]
    ) -> list[dict[str, Any]]:
        """A primitive for each part; they share their vertices, and none but their own are read of them."""
        return [
            {
                "attributes": attributes,
                "indices": self.add(
                    corners[look.faces].reshape(-1).astype("<u4"), "SCALAR", UNSIGNED_INT, ELEMENT_ARRAY_BUFFER
                ),
                "material": self._material(look),
            }
            for look in looks
        ]

    def _morph_targets(self, basis: ShapeBasis, of_vertex: np.ndarray) -> list[dict[str, int]]:
        """Offsets of each shape for the written vertices and their normals."""
        return [
            {
                "POSITION": self.add_vectors(shape[of_vertex], bounded=True),
                "NORMAL": self.add_vectors(normals[of_vertex]),
            }
            for shape, normals in zip(basis.shapes, basis.normal_shapes, strict=True)
        ]

    def _add_skin(self, node: int, baked: BakedBones) -> None:
        """Bones of a mesh's node, each a joint that moves and turns."""
        nodes, first = self.json["nodes"], len(self.json["nodes"]) + 1
        name, count = nodes[node]["name"], len(baked.centres)
        self.json["scenes"][0]["nodes"].append(first - 1)
        nodes.append({"name": f"{name} bones", "children": list(range(first, first + count))})
        inverse = np.tile(np.eye(4, dtype="<f4"), (count, 1, 1))
        inverse[:, 3, :3] = -baked.centres  # column by column
        skin = {
            "joints": list(range(first, first + count)),
            "inverseBindMatrices": self.add(inverse, "MAT4", FLOAT),
            "skeleton": first - 1,
        }
        nodes[node]["skin"] = len(self.json.setdefault("skins", []))
        self.json["skins"].append(skin)
        for bone in range(count):
            turns = Rotation.from_matrix(baked.rotations[:, bone]).as_quat()
            # Of the two quaternions of a rotation the one nearer to that of the frame before.
            turns *= np.cumprod(np.r_[1.0, np.where((turns[1:] * turns[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)])[:, None]
            at = baked.translations[:, bone]
            nodes.append({"name": f"{name} bone {bone}", "translation": at[0].tolist(), "rotation": turns[0].tolist()})
            self._animate(first + bone, "translation", at, "VEC3")
            self._animate(first + bone, "rotation", turns, "VEC4")

    def finished(self) -> dict[str, Any]:
        """The whole document; nothing can be added after."""
        self.json["buffers"] = [{"byteLength": self.file.tell()}]
        if self._channels:
            self.json["animations"] = [{"name": "cloth", "samplers": self._samplers, "channels": self._channels}]
        return self.json

    def _animate(self, node: int, path: str, values: np.ndarray, kind: str) -> None:
        if self._times is None:
            end = float(self._seconds[-1])
            self._times = self.add(self._seconds, "SCALAR", FLOAT, min=[0.0], max=[end])
        output = self.add(values.astype("<f4"), kind, FLOAT)
        target = {"node": node, "path": path}
        self._channels.append({"sampler": len(self._samplers), "target": target})
        self._samplers.append({"input": self._times, "output": output, "interpolation": "LINEAR"})

    def _material(self, look: ClothPart) -> int:
        # glTF colours are linear; the constants are as seen on a screen.
        linear = [round(float(channel) ** 2.2, 4) for channel in look.colour]
        surface: dict[str, Any] = {
            "baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.85,
        }  # fmt: skip
        if look.image is not None:
            surface["baseColorTexture"] = {"index": self._texture(look.image)}
        self.json["materials"].append({"name": look.name, "pbrMetallicRoughness": surface, "doubleSided": True})
        return len(self.json["materials"]) - 1

    def _texture(self, image: bytes) -> int:
        """Texture of an image, which is in the file once for all parts."""
        if image not in self._textures:
            kind = "image/png" if image_suffix(image) == ".png" else "image/jpeg"
            self._textures[image] = len(self._textures)
            textures, images = (self.json.setdefault(name, []) for name in ("textures", "images"))
            textures.append({"source": len(images)})
            images.append({"bufferView": self.add_view(image), "mimeType": kind})
        return self._textures[image]
