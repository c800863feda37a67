"""Meshes of glTF files: triangles of the nodes of a scene, with their UVs, colours and images.

Source: Khronos, glTF 2.0 specification, 3.5 (scenes), 3.7 (meshes) and 3.9 (materials).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.errors import InputError, warn
from pb4u.geometry.appearance import Appearance, Appearances, sound_image
from pb4u.geometry.mesh_file import PolygonMesh, named_pieces, no_faces, require_sound, welded
from pb4u.geometry.topology import joined_indices, offsets
from pb4u.io.gltf_file import GltfFile, read_gltf
from pb4u.io.reading_limits import refusing

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


class _Part(NamedTuple):
    """One primitive: (vertices, 3) [m], (faces, 3) int64, (vertices, 2) v upward or None, its material and name."""

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None
    material: int | None
    name: str


def read_gltf_mesh(path: Path) -> PolygonMesh:
    """The triangles of a glTF file, vertices that were copied at UV seams joined again.

    Args:
        path: the .glb or .gltf.

    Raises:
        InputError: it is no glTF, is compressed by Draco or meshopt, is damaged, or has no faces.
    """
    file = read_gltf(path)
    with refusing(path, "cannot be read as a mesh"):
        parts = [
            _part(file, primitive, placed, file.entries("meshes")[mesh].get("name"))
            for mesh, placed in _placed(file)
            for primitive in file.entries("meshes")[mesh]["primitives"]
            if primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)
        ]
        if not sum(len(part.faces) for part in parts):
            raise no_faces(path)
        starts = offsets([part.vertices for part in parts])
        vertices = np.concatenate([part.vertices for part in parts])
        corners = joined_indices([part.faces for part in parts], starts)
        require_sound(path, vertices, corners)
        vertices, faces = welded(vertices, corners)
        laid_on = any(part.uvs is not None for part in parts)
        looks = _appearances(file, parts, laid_on)
        of_face = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])
        pieces, of_face = named_pieces([part.name for part in parts], of_face)
    if not laid_on:
        return PolygonMesh(vertices, tuple(faces), None, None, looks, pieces, of_face)
    uvs = [np.zeros((len(part.vertices), 2)) if part.uvs is None else part.uvs for part in parts]
    return PolygonMesh(vertices, tuple(faces), np.concatenate(uvs), tuple(corners), looks, pieces, of_face)


def _placed(file: GltfFile) -> Iterator[tuple[int, np.ndarray]]:
    """The meshes of the scene that is shown, each with its transform (4, 4)."""
    nodes, scenes = file.entries("nodes"), file.entries("scenes")
    below = {child for node in nodes for child in node.get("children", ())}
    roots = [node for node in range(len(nodes)) if node not in below]
    shown = scenes[file.document.get("scene", 0)].get("nodes", []) if scenes else roots
    waiting = [(node, np.eye(4)) for node in reversed(shown)]
    reached = set[int]()
    while waiting:
        node, parent = waiting.pop()
        if node in reached:
            raise ValueError(f"node {node} has two parents")
        reached.add(node)
        own = _transform(nodes[node])
        if not np.isfinite(own).all():
            raise ValueError(f"node {node} has no finite place")
        placed = parent @ own
        if "mesh" in nodes[node]:
            yield nodes[node]["mesh"], placed
        waiting += [(child, placed) for child in reversed(nodes[node].get("children", []))]


def _transform(node: dict[str, Any]) -> np.ndarray:
    """Transform (4, 4) of a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    transform = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    transform[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    transform[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return transform


def _part(file: GltfFile, primitive: dict[str, Any], placed: np.ndarray, mesh: object) -> _Part:
    attributes, material = primitive["attributes"], primitive.get("material")
    piece = str((material is not None and file.entries("materials")[material].get("name")) or mesh or "")
    local = file.array(attributes["POSITION"]).astype(np.float64)
    vertices = local.reshape(len(local), 3) @ placed[:3, :3].T + placed[:3, 3]
    row = file.array(primitive["indices"]) if "indices" in primitive else np.arange(len(vertices))
    row = row.reshape(len(row)).astype(np.int64)
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _TRIANGLES:
        faces = row[: len(row) // 3 * 3].reshape(-1, 3)
    else:
        faces = np.stack([row[:-2] if mode == _STRIP else np.full(len(row[2:]), row[0]), row[1:-1], row[2:]], axis=1)
        if mode == _STRIP:
            faces[1::2] = faces[1::2, [1, 0, 2]]
    if np.linalg.det(placed[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    _, texture = _colour_and_texture(file, material)
    moved = texture.get("extensions", {}).get("KHR_texture_transform", {})
    name = f"TEXCOORD_{moved.get('texCoord', texture.get('texCoord', 0))}"
    if name not in attributes:
        return _Part(vertices, faces, None, material, piece)
    uvs = file.array(attributes[name]).astype(np.float64).reshape(len(vertices), 2)
    # A turn, which this extension can give too, is not read: no exporter of garments writes one.
    uvs = uvs * np.array(moved.get("scale", (1.0, 1.0))) + np.array(moved.get("offset", (0.0, 0.0)))
    return _Part(vertices, faces, np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1), material, piece)


def _colour_and_texture(file: GltfFile, material: int | None) -> tuple[list[float] | None, dict[str, Any]]:
    """The base colour of a material, linear, or None; and what it says of its image, empty where it has none."""
    entry = {} if material is None else file.entries("materials")[material]
    surface = entry.get("pbrMetallicRoughness", {})
    older = entry.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    texture = surface.get("baseColorTexture", older.get("diffuseTexture", {}))
    return surface.get("baseColorFactor", older.get("diffuseFactor")), texture


def _appearances(file: GltfFile, parts: list[_Part], laid_on: bool) -> Appearances | None:
    """Base colours and images of the parts; images only where UVs say how they are laid on."""
    listed, places = list[Appearance](), dict[int | None, int]()
    for material in dict.fromkeys(part.material for part in parts):
        factor, texture = _colour_and_texture(file, material)
        if material is None or (factor is None and not (texture and laid_on)):
            continue
        name = str(file.entries("materials")[material].get("name") or "material")
        linear = np.clip(np.ones(3) if factor is None else np.array(factor[:3], dtype=np.float64), 0.0, 1.0)
        red, green, blue = (linear ** (1 / 2.2)).tolist()
        places[material] = len(listed)
        listed.append(Appearance(name, (red, green, blue), _image(file, name, texture) if laid_on else None))
    if not listed:
        return None
    return Appearances(
        tuple(listed), np.repeat([places.get(part.material, -1) for part in parts], [len(part.faces) for part in parts])
    )


def _image(file: GltfFile, name: str, texture: dict[str, Any]) -> bytes | None:
    """Content of the image of a texture; None where it has none, or none that can be read, with a warning."""
    if not texture:
        return None
    entry = file.entries("textures")[texture["index"]]
    others = (other["source"] for other in entry.get("extensions", {}).values() if "source" in other)
    source = next(others, None) if entry.get("source") is None else entry["source"]
    try:
        return None if source is None else sound_image(file.image(source), f"The image of {name}")
    except InputError as error:
        warn(f"{file.path.name}: {error}")
        return None
