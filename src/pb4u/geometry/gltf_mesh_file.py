"""Meshes of glTF files: triangles of the nodes of a scene, skinned as it stands, with UVs, colours and images.

Source: Khronos, glTF 2.0 specification, 3.5 (scenes), 3.7 (meshes) and 3.9 (materials).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pb4u.errors import InputError, InputNote, warn
from pb4u.geometry.appearance import Appearance, Appearances, sound_image
from pb4u.geometry.gltf_skin import node_order, node_transforms, placed
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

    Morph targets are left out, with a note.

    Args:
        path: the .glb or .gltf.

    Raises:
        InputError: it is not a glTF file, is compressed by Draco or meshopt, is damaged, or has no faces.
    """
    file = read_gltf(path)
    with refusing(path, "cannot be read as a mesh"):
        still, nodes, meshes = node_transforms(file), file.entries("nodes"), file.entries("meshes")
        shown = [
            (node, primitive)
            for node in _shown(file)
            for primitive in meshes[nodes[node]["mesh"]]["primitives"]
            if primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)
        ]
        parts = [_part(file, primitive, node, still) for node, primitive in shown]
        if any("targets" in primitive for _, primitive in shown):
            warn(f"{path.name}: its morph targets are not used; the mesh is read without them.", InputNote)
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
        pieces = named_pieces([part.name for part in parts], of_face)
        names = [str(nodes[node].get("name") or meshes[nodes[node]["mesh"]].get("name") or "") for node, _ in shown]
        objects = tuple(dict.fromkeys(names))
        object_of = np.array([objects.index(name) for name in names])[of_face]
    uvs, laid = None, None
    if laid_on:
        uvs = np.concatenate([np.zeros((len(part.vertices), 2)) if part.uvs is None else part.uvs for part in parts])
        laid = tuple(corners)
    return PolygonMesh(vertices, tuple(faces), uvs, laid, looks, *pieces, objects=objects, object_of=object_of)


def _shown(file: GltfFile) -> list[int]:
    """The nodes with a mesh of the scene that is shown, parents before children."""
    nodes, scenes = file.entries("nodes"), file.entries("scenes")
    roots = np.flatnonzero(node_order(file)[0] < 0).tolist()
    waiting = list(reversed(scenes[file.document.get("scene", 0)].get("nodes", []) if scenes else roots))
    shown = list[int]()
    while waiting:
        node = waiting.pop()
        if node in shown:
            raise ValueError(f"node {node} has two parents")
        shown.append(node)
        waiting += reversed(nodes[node].get("children", []))
    return [node for node in shown if "mesh" in nodes[node]]


def _part(file: GltfFile, primitive: dict[str, Any], node: int, still: np.ndarray) -> _Part:
    attributes, material = primitive["attributes"], primitive.get("material")
    mesh = file.entries("meshes")[file.entries("nodes")[node]["mesh"]].get("name")
    piece = str((material is not None and file.entries("materials")[material].get("name")) or mesh or "")
    local = file.array(attributes["POSITION"]).astype(np.float64)
    vertices, mirrored = placed(file, node, attributes, still, local.reshape(len(local), 3))
    row = file.array(primitive["indices"]) if "indices" in primitive else np.arange(len(vertices))
    row = row.reshape(len(row)).astype(np.int64)
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _TRIANGLES:
        faces = row[: len(row) // 3 * 3].reshape(-1, 3)
    else:
        faces = np.stack([row[:-2] if mode == _STRIP else np.full(len(row[2:]), row[0]), row[1:-1], row[2:]], axis=1)
        if mode == _STRIP:
            faces[1::2] = faces[1::2, [1, 0, 2]]
    if mirrored:
        faces = faces[:, ::-1]
    _, texture = _colour_and_texture(file, material)
    transform = texture.get("extensions", {}).get("KHR_texture_transform", {})
    name = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
    if name not in attributes:
        return _Part(vertices, faces, None, material, piece)
    uvs = file.array(attributes[name]).astype(np.float64).reshape(len(vertices), 2)
    # A turn, which this extension can give too, is not read: no exporter of garments writes one.
    uvs = uvs * np.array(transform.get("scale", (1.0, 1.0))) + np.array(transform.get("offset", (0.0, 0.0)))
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
    looks, places = list[Appearance](), dict[int | None, int]()
    for material in dict.fromkeys(part.material for part in parts):
        factor, texture = _colour_and_texture(file, material)
        if material is None or (factor is None and not (texture and laid_on)):
            continue
        name = str(file.entries("materials")[material].get("name") or "material")
        linear = np.clip(np.ones(3) if factor is None else np.array(factor[:3], dtype=np.float64), 0.0, 1.0)
        red, green, blue = (linear ** (1 / 2.2)).tolist()
        places[material] = len(looks)
        looks.append(Appearance(name, (red, green, blue), _image(file, name, texture) if laid_on else None))
    if not looks:
        return None
    return Appearances(
        tuple(looks), np.repeat([places.get(part.material, -1) for part in parts], [len(part.faces) for part in parts])
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
