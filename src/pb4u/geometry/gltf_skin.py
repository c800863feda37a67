"""Nodes and skins of glTF files, for bodies and for garments.

Source: Khronos, glTF 2.0 specification, 3.5 (scenes) and 3.7.3 (skins).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.io.gltf_file import GltfFile


def node_order(file: GltfFile) -> tuple[np.ndarray, tuple[int, ...]]:
    """Parent (nodes,) int64 of each node, -1 of a root, and the nodes in an order with parents before children.

    Args:
        file: a glTF file.

    Raises:
        ValueError: a node has two parents, or the hierarchy has a cycle.
    """
    entries = file.entries("nodes")
    parents = np.full(len(entries), -1, dtype=np.int64)
    for node, entry in enumerate(entries):
        for child in entry.get("children", ()):
            if parents[child] >= 0 or child == node:
                raise ValueError(f"node {child} has two parents")
            parents[child] = node
    order: list[int] = []
    waiting = np.flatnonzero(parents < 0).tolist()
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting += entries[node].get("children", ())
    if len(order) < len(entries):
        raise ValueError("the hierarchy of its nodes has a cycle, or a node with two parents")
    return parents, tuple(order)


def node_transforms(file: GltfFile) -> np.ndarray:
    """Transforms (nodes, 4, 4) of the nodes to the scene in the file's pose, lengths in the file's unit.

    Args:
        file: a glTF file.

    Raises:
        ValueError: a node has two parents or no finite position, or the hierarchy has a cycle.
    """
    parents, order = node_order(file)
    entries = file.entries("nodes")
    result = np.zeros((len(entries), 4, 4))
    for node in order:
        transform = _transform(entries[node])
        if not np.isfinite(transform).all():
            raise ValueError(f"node {node} has no finite position")
        result[node] = transform if parents[node] < 0 else result[parents[node]] @ transform
    return result


def _transform(node: dict[str, Any]) -> np.ndarray:
    """Transform (4, 4) of a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    transform = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    transform[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    transform[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return transform


def read_skins(file: GltfFile, used: set[int]) -> tuple[dict[int, list[int]], dict[int, np.ndarray]]:
    """Nodes of the joints of each skin, and the inverse bind matrices (joints, 4, 4).

    Args:
        file: a glTF file.
        used: numbers of the skins to read.

    Raises:
        ValueError: a skin has no bind pose that can be inverted.
    """
    nodes, inverses = {}, {}
    for skin in sorted(used):
        entry = file.entries("skins")[skin]
        nodes[skin] = [int(node) for node in entry["joints"]]
        if "inverseBindMatrices" in entry:
            flat = file.array(entry["inverseBindMatrices"])[: len(nodes[skin])]
            inverses[skin] = flat.reshape(-1, 4, 4).transpose(0, 2, 1)
        else:
            inverses[skin] = np.tile(np.eye(4), (len(nodes[skin]), 1, 1))
        if len(inverses[skin]) < len(nodes[skin]) or not (np.abs(np.linalg.det(inverses[skin])) > 1e-20).all():
            raise ValueError(f"skin {skin} has no bind pose")
    return nodes, inverses


def influences(file: GltfFile, attributes: dict[str, int], vertices: int, joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Skinning of the vertices of a primitive: indices into the skin's joints, and weights that sum to 1.

    Args:
        file: a glTF file.
        attributes: of the primitive.
        vertices: number of its vertices.
        joints: number of joints of its skin.

    Returns:
        (vertices, influences) int64, and (vertices, influences) float64 [1].

    Raises:
        ValueError: a vertex is bound to a missing joint, or has no weight.
    """
    sets = range(sum(name.startswith("JOINTS_") for name in attributes))
    places = np.concatenate([file.array(attributes[f"JOINTS_{k}"]) for k in sets], axis=1).astype(np.int64)
    weights = np.concatenate([file.array(attributes[f"WEIGHTS_{k}"]) for k in sets], axis=1).astype(np.float64)
    if len(places) != vertices or places.min() < 0 or places.max() >= joints or weights.shape != places.shape:
        raise ValueError("a vertex is bound to a bone that does not exist")
    total = weights.sum(axis=1, keepdims=True)
    if (weights < 0.0).any() or not (total > 0.0).all():
        raise ValueError("a vertex has no finite position, or no weight")
    return places, weights / total


def placed(
    file: GltfFile, node: int, attributes: dict[str, int], still: np.ndarray, positions: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Vertices of a primitive where the scene has them, and whether it mirrors them.

    With a skin only its joints move them, whatever the transform of the mesh's node; without one they move with the
    node.

    Args:
        file: a glTF file.
        node: the node of the mesh.
        attributes: of the primitive.
        still: (nodes, 4, 4) as `node_transforms` gives them.
        positions: (vertices, 3) as the primitive has them.

    Raises:
        ValueError: the skin has no bind pose, or a vertex is bound to none of its joints.
    """
    skin = file.entries("nodes")[node].get("skin")
    if skin is None or "JOINTS_0" not in attributes:
        transforms = still[node][None]
        vertices = positions @ still[node][:3, :3].T + still[node][:3, 3]
    else:
        nodes, inverses = read_skins(file, {skin})
        transforms = still[nodes[skin]] @ inverses[skin]
        joints, weights = influences(file, attributes, len(positions), len(nodes[skin]))
        blended = np.einsum("vk,vkij->vij", weights, transforms[joints])
        vertices = np.einsum("vij,vj->vi", blended[:, :3, :3], positions) + blended[:, :3, 3]
    return vertices, bool(np.linalg.det(transforms[0, :3, :3]) < 0.0)
