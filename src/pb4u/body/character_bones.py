"""The bones of glTF skins: joined, in their bind pose, named and ordered as a human's where they are one's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pb4u.body.bone_names import smpl_names
from pb4u.body.node_animation import NodeTree
from pb4u.errors import InputError
from pb4u.io.gltf_file import GltfFile

_MOST_BONES = 2000


def bind_spaces(
    tree: NodeTree, still: np.ndarray, nodes: dict[int, list[int]], inverses: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Transform (4, 4) of each skin's own space to the scene in the bind pose.

    In the bind pose all joints of a skin give the same transform of its space. The nodes of a file place the skeleton;
    if they are in another pose than the bind pose, only their unit and nearest axes are used.

    Args:
        tree: nodes of the file.
        still: (nodes, 4, 4) transforms of the nodes to the scene without an animation.
        nodes: nodes of the joints of each skin.
        inverses: (joints, 4, 4) inverse bind matrices of each skin.
    """
    binds: dict[int, np.ndarray] = {}
    places: dict[int, np.ndarray] = {}
    depth = {node: k for k, node in enumerate(tree.order)}
    for skin in sorted(nodes, key=lambda skin: min(depth[node] for node in nodes[skin])):
        joints, inverse = nodes[skin], inverses[skin]
        bound = next((k for k, node in enumerate(joints) if node in binds), None)
        if bound is not None:
            place = binds[joints[bound]] @ inverse[bound]
        else:
            now = still[joints] @ inverse
            first = min(range(len(joints)), key=lambda k: depth[joints[k]])
            place = now[first]
            if np.abs(now - place).max() > 1e-3 * max(1.0, np.abs(place).max()):
                place = _upright(place)
        places[skin] = place
        for k, node in enumerate(joints):
            binds.setdefault(node, place @ np.linalg.inv(inverse[k]))
    return places


def merged_bones(
    path: Path, nodes: Mapping[int, list[int]], inverses: Mapping[int, np.ndarray], places: Mapping[int, np.ndarray]
) -> tuple[list[int], list[np.ndarray], dict[tuple[int, int], int]]:
    """Node and bind transform (4, 4) of each bone, and the bone of each (skin, joint); equal bones of skins are one.

    Args:
        path: the file, named in the error.
        nodes: nodes of the joints of each skin.
        inverses: (joints, 4, 4) inverse bind matrices of each skin.
        places: (4, 4) transform of each skin's own space to the scene.

    Raises:
        InputError: there are too many bones.
    """
    bones: list[int] = []
    matrices: list[np.ndarray] = []
    bone_of: dict[tuple[int, int], int] = {}
    for skin, joints in nodes.items():
        for k, node in enumerate(joints):
            bind = places[skin] @ np.linalg.inv(inverses[skin][k])
            same = [b for b, (n, m) in enumerate(zip(bones, matrices, strict=True)) if n == node]
            near = [b for b in same if np.abs(matrices[b] - bind).max() < 1e-4 * max(1.0, np.abs(bind).max())]
            if not near:
                bones.append(node)
                matrices.append(bind)
            bone_of[skin, k] = near[0] if near else len(bones) - 1
    if len(bones) > _MOST_BONES:
        raise InputError(f"{path} has {len(bones):,} bones; at most {_MOST_BONES:,} are allowed.")
    return bones, matrices, bone_of


def ordered_bones(file: GltfFile, tree: NodeTree, bones: list[int]) -> tuple[np.ndarray, list[str], list[int]]:
    """Order of the bones, with the hips first and parents before children; their names and parents in that order.

    Args:
        file: a glTF file.
        tree: its nodes.
        bones: node of each bone.
    """
    depth = {node: k for k, node in enumerate(tree.order)}
    by_depth = sorted(range(len(bones)), key=lambda b: (depth[bones[b]], b))
    place = {bones[b]: k for k, b in reversed(list(enumerate(by_depth)))}
    parents = []
    for b in by_depth:
        up = int(tree.parents[bones[b]])
        while up >= 0 and up not in place:
            up = int(tree.parents[up])
        parents.append(-1 if up < 0 else place[up])
    vrm = _vrm_bones(file)
    ranks = {name: place[node] for name, node in vrm.items() if node in place} if vrm else None
    joint_of_bone = smpl_names([tree.names[bones[b]] for b in by_depth], parents, ranks)
    hips = next((k for k, joint in (joint_of_bone or {}).items() if joint == "pelvis"), 0)
    # What lies above the hips goes with them: the skeleton of a human begins there.
    rows = [hips, *(k for k in range(len(by_depth)) if k != hips)]
    new = {old: k for k, old in enumerate(rows)}
    above, up = set(), parents[hips]
    while up >= 0:
        above.add(up)
        up = parents[up]
    names, seen = [], set()
    for old in rows:
        name = (joint_of_bone or {}).get(old) or tree.names[bones[by_depth[old]]] or f"bone {old}"
        while name in seen or (joint_of_bone and name in joint_of_bone.values() and old not in joint_of_bone):
            name += "'"
        seen.add(name)
        names.append(name)
    parted_from = [-1 if old == hips else 0 if old in above or parents[old] < 0 else new[parents[old]] for old in rows]
    order = np.array([by_depth[old] for old in rows])
    # Parents of what was above the hips come first already; of all others too, since the old order had them so.
    return order, names, parted_from


def _vrm_bones(file: GltfFile) -> dict[str, int]:
    """Node by VRM's name of the bone; empty where the file is none. VRM 0 lists them, VRM 1 names them."""
    extensions = file.document.get("extensions", {})
    old = extensions.get("VRM", {}).get("humanoid", {}).get("humanBones", [])
    new = extensions.get("VRMC_vrm", {}).get("humanoid", {}).get("humanBones", {})
    of_vrm_0 = {str(bone["bone"]): int(bone["node"]) for bone in old} if isinstance(old, list) else {}
    return of_vrm_0 | {str(name): int(bone["node"]) for name, bone in new.items()}


def completed_bones(
    names: list[str], parents: list[int], joints: np.ndarray, nodes: np.ndarray, binds: np.ndarray, vertices: np.ndarray
) -> tuple[list[str], list[int], np.ndarray, np.ndarray, np.ndarray]:
    """A human skeleton completed by bones that some rigs lack: toes, collar bones and the neck, which move with their
    parents.

    Args:
        names: names of the bones; returned unchanged if none is the pelvis.
        parents: parent of each bone; -1 for none.
        joints: (bones, 3) [m].
        nodes: (bones,) int64 node of each bone.
        binds: (bones, 4, 4) transform of each bone to the world in the bind pose.
        vertices: (vertices, 3) of the skin [m], feet on y = 0.
    """
    if "pelvis" not in names:
        return names, parents, joints, nodes, binds
    added = {"neck": ("spine3", "head", 0.75)}
    for side in ("left", "right"):
        added[f"{side}_collar"] = ("spine3", f"{side}_shoulder", 0.3)
        added[f"{side}_foot"] = (f"{side}_ankle", f"{side}_ankle", 0.0)
    height = float(np.ptp(vertices[:, 1]))
    for name, (parent, towards, share) in added.items():
        if name in names:
            continue
        start = names.index(parent)
        place = joints[start] + share * (joints[names.index(towards)] - joints[start])
        if name.endswith("foot"):  # the ball of a foot: ahead of the ankle, near the ground
            place = np.array([place[0], min(0.01 * height, place[1]), place[2] + 0.07 * height])
        names, parents = [*names, name], [*parents, start]
        joints = np.vstack([joints, place])
        nodes, binds = np.append(nodes, nodes[start]), np.concatenate([binds, binds[start : start + 1]])
    return names, parents, joints, nodes, binds


def _upright(place: np.ndarray) -> np.ndarray:
    """A transform with its turn rounded to the nearest of the axes'."""
    left, stretch, right = np.linalg.svd(place[:3, :3])
    result = np.eye(4)
    result[:3, :3] = nearest_axes(left @ right) * np.exp(np.log(stretch).mean())
    return result


def nearest_axes(turn: np.ndarray) -> np.ndarray:
    """The rotation or reflection (3, 3) nearest to another that takes each axis to an axis.

    Args:
        turn: (3, 3) the other one.
    """
    axes = np.zeros((3, 3))
    free = np.abs(turn)
    for _ in range(3):
        row, column = np.unravel_index(free.argmax(), free.shape)
        axes[row, column] = np.sign(turn[row, column])
        free[row], free[:, column] = -1.0, -1.0
    return axes
