"""The nodes and animations of glTF files."""

from __future__ import annotations

import numpy as np

from pb4u.body.node_animation import Channel, Clip, NodePoses, NodeTree, parted
from pb4u.errors import InputError
from pb4u.geometry.gltf_skin import node_order
from pb4u.geometry.rotation import from_xyzw
from pb4u.io.gltf_file import GltfFile
from pb4u.io.reading_limits import names_text


def node_tree(file: GltfFile) -> NodeTree:
    """The nodes of a file in their pose without animation, lengths in the file's unit.

    Args:
        file: a glTF file.
    """
    entries = file.entries("nodes")
    parents, order = node_order(file)
    translations, rotations, scales = (
        np.zeros((len(entries), 3)),
        np.zeros((len(entries), 4)),
        np.ones((len(entries), 3)),
    )
    rotations[:, 0] = 1.0
    for node, entry in enumerate(entries):
        if "matrix" in entry:
            matrix = np.array(entry["matrix"], dtype=np.float64).reshape(4, 4).T
            translations[node], rotations[node], scales[node] = parted(matrix)
            continue
        translations[node] = entry.get("translation", (0.0, 0.0, 0.0))
        scales[node] = entry.get("scale", (1.0, 1.0, 1.0))
        turn = from_xyzw(np.array(entry.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64))
        rotations[node] = turn / np.linalg.norm(turn)
    if not all((np.abs(values) < 1e7).all() for values in (translations, rotations, scales)):
        raise ValueError("the position of a node is not finite")
    weights = {}
    for node, entry in enumerate(entries):
        if "mesh" in entry:
            mesh = file.entries("meshes")[entry["mesh"]]
            targets = max((len(primitive.get("targets", ())) for primitive in mesh["primitives"]), default=0)
            values = entry.get("weights", mesh.get("weights", [0.0] * targets))
            if len(values) != targets:
                raise ValueError(f"node {node} has {len(values)} weights for {targets} morph targets")
            weights[node] = np.array(values, dtype=np.float64).reshape(1, targets)
    poses = NodePoses(translations[None], rotations[None], scales[None], weights)
    return NodeTree(tuple(str(e.get("name", "")) for e in entries), parents, order, poses, np.eye(4))


def clip_names(file: GltfFile) -> list[str]:
    """Names of the animations, in the order of the file.

    Args:
        file: a glTF file.
    """
    return [str(entry.get("name") or f"clip {k}") for k, entry in enumerate(file.entries("animations"))]


def read_clip(file: GltfFile, tree: NodeTree, name: str | None) -> Clip | None:
    """An animation; None if the file has none and no name is given.

    Args:
        file: a glTF file.
        tree: its nodes.
        name: name of the animation; by default the first.

    Raises:
        InputError: the file has no animation of that name.
        ValueError: the times of its key frames do not increase, values are not finite, or a node is missing.
    """
    entries, names = file.entries("animations"), clip_names(file)
    if name is not None and name not in names:
        clips = f"it has {names_text(names)}" if names else "it has none"
        raise InputError(f'{file.path} has no clip "{name}"; {clips}.')
    if not entries:
        return None
    index = 0 if name is None else names.index(name)
    channels = []
    entry = entries[index]
    for channel in entry["channels"]:
        target, sampler = channel["target"], entry["samplers"][channel["sampler"]]
        if "node" not in target or target["path"] not in ("translation", "rotation", "scale", "weights"):
            continue
        times = np.atleast_1d(file.array(sampler["input"])).astype(np.float64)
        kind = sampler.get("interpolation", "LINEAR")
        values = file.array(sampler["output"]).astype(np.float64)
        knots = len(times) * (3 if kind == "CUBICSPLINE" else 1)
        values = values.reshape(knots, -1)
        if target["path"] == "rotation":
            values = from_xyzw(values)
            if kind != "CUBICSPLINE":
                values = values / np.linalg.norm(values, axis=1, keepdims=True)
        if (
            not len(times)
            or (np.diff(times) < 0).any()
            or not np.isfinite(values).all()
            or not np.isfinite(times).all()
        ):
            raise ValueError(f"the clip {names[index]} has key frames whose times do not increase or are not finite")
        if times[-1] > 1e5 or not 0 <= target["node"] < len(file.entries("nodes")):
            raise ValueError(f"the clip {names[index]} has a key frame at {times[-1]:g} s, or moves no node")
        if target["path"] == "weights" and values.shape[1] != tree.poses.weights[target["node"]].shape[1]:
            raise ValueError(f"the clip {names[index]} has another number of weights than there are morph targets")
        if kind == "CUBICSPLINE":
            values = values.reshape(len(times), 3, -1)
        channels.append(Channel(target["node"], target["path"], times, values, kind))
    return Clip(names[index], tuple(channels))
