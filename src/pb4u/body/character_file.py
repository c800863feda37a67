"""Rigged characters of glTF and VRM files: meshes joined, cleaned for contact, and set up at rest."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pb4u.body.bone_names import smpl_names
from pb4u.body.character import Character, Morph, Rig
from pb4u.body.contact_region import reachable
from pb4u.body.node_animation import Channel, Clip, NodePoses, NodeTree, parted
from pb4u.body.skeleton import Skeleton, branch
from pb4u.body.skinning import SkinningWeights
from pb4u.errors import InputError
from pb4u.geometry.topology import Topology, connected_labels
from pb4u.io.gltf_file import GltfFile, read_gltf
from pb4u.io.reading_limits import refusing, told_names

# Words of meshes and materials that are no skin; a material called skin, body or face outweighs its mesh's name.
_NOT_SKIN = re.compile(
    r"hair|eye|brow|lash|iris|pupil|cornea|teeth|tooth|tongue|gum|beard|moustache|glasses|hat|helmet|cap|cloth|shirt|"
    r"tops|bottoms|pants|trousers|jeans|shorts|skirt|dress|jacket|coat|hoodie|sweater|suit|shoe|boot|sneaker|sock|"
    r"glove|outfit|garment|underwear|bra|onepiece|accessor|weapon|tear|belt|bag",
    re.IGNORECASE,
)
_SKIN = re.compile(r"skin|body|face|flesh", re.IGNORECASE)
# Vertices nearer than this share of the height are one where the same bones move them, to this much of a weight.
_SAME_PLACE, _SAME_WEIGHT = 1e-5, 0.02
# Extent [m] of a character; a larger one is in centimetres or millimetres.
_SIZES = {1.0: (0.1, 10.0), 0.01: (10.0, 1000.0), 0.001: (1000.0, 1e4)}
_MOST_TRIANGLES, _MOST_BONES = 1_000_000, 2000
# Rays with which it is seen whether cloth can reach a vertex: a tenth of a millisecond each vertex.
_RAYS = 32
_OTHER_SIDE = re.compile("left|right")
_HANDS = ("left_wrist", "right_wrist")


@dataclass(frozen=True, eq=False)
class _Part:
    """One primitive: its triangles and what moves them.

    Args:
        names: of its node, mesh and material.
        node: that its mesh hangs on.
        skin: number of its skin.
        vertices: (vertices, 3) in the space of the skin.
        faces: (faces, 3) int64.
        joints: (vertices, influences) int64, places in the list of the skin.
        weights: (vertices, influences) [1], rows sum to 1.
        targets: (targets, vertices, 3) offsets of its morph targets.
        morphed: (targets,) weights that the file gives them.
    """

    names: tuple[str, str, str]
    node: int
    skin: int
    vertices: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    targets: np.ndarray
    morphed: np.ndarray

    @property
    def title(self) -> str:
        return next((name for name in reversed(self.names) if name), "a mesh without a name")

    @property
    def is_skin(self) -> bool:
        *meshes, material = self.names
        if _NOT_SKIN.search(material):
            return False
        return bool(_SKIN.search(material)) or not any(_NOT_SKIN.search(name) for name in meshes)


def read_character(path: Path, clip: str | None = None, parts: Collection[str] | None = None) -> Character:
    """The character of a glTF or VRM file in its bind pose, feet on y = 0, facing +Z.

    All skinned meshes are joined but hair, eyes, clothes and the like, recognised by their names and those of their
    materials. Holes are closed, so that inside has a meaning.

    Args:
        path: the .glb, .gltf or .vrm.
        clip: name of the animation that it performs; the first where left out.
        parts: names of the meshes or materials that make the body; recognised by their names where left out.

    Raises:
        InputError: it is no glTF, is compressed by Draco or meshopt, has no skin, no such clip or part, or is damaged.
    """
    file = read_gltf(path)
    with refusing(path, "is damaged"):
        return _character(file, clip, parts)


def _character(file: GltfFile, clip: str | None, parts: Collection[str] | None) -> Character:
    path = file.path
    tree = _tree(file)
    chosen, left = _chosen(path, _parts(file), parts)
    still = tree.globals(tree.poses)[0]
    nodes, inverses = _skins(file, {part.skin for part in chosen})
    places = _bind_spaces(tree, still, nodes, inverses)

    bones, matrices, bone_of = _merged_bones(path, nodes, inverses, places)
    surface = _joined(chosen, places, nodes, bone_of)
    order, names, parents = _ordered(file, tree, bones)
    rank = np.argsort(order)
    binds = np.stack(matrices)[order]
    ranked = np.array(bones)[order]
    surface = surface.renumbered(rank)
    world, names, more = _world(path, surface.vertices, names, binds)
    notes = (
        [*more] if not left else [f"{path.name}: left out of the body: {', '.join(left)}; --body-parts chooses.", *more]
    )
    surface, welded = surface.moved(world).welded()
    surface, closed = surface.turned_outward().closed()
    if closed:
        notes.append(f"{path.name}: {closed} closed, so that inside has a meaning.")
    if not Topology(surface.faces, len(surface.vertices)).is_closed:
        notes.append(f"{path.name}: its surface is not closed even so; penetration is not reported.")
    binds = world @ binds
    if not (np.abs(np.linalg.det(binds)) > 1e-20).all():
        raise ValueError("a bone is flattened by the scale of a node")
    heads = binds[:, :3, 3]
    names, parents, heads, bone_nodes, binds = _completed(names, parents, heads, ranked, binds, surface.vertices)
    skinning = SkinningWeights(surface.bones, surface.weights.astype(np.float32))
    hands = branch(parents, [k for k, name in enumerate(names) if name in _HANDS])
    contact = reachable(surface.vertices, surface.faces, skinning.share_of(hands) <= 0.5, _RAYS)
    morphs = _morphs(chosen, places, world, welded)
    if "pelvis" not in names:
        notes.append(
            f"{path.name}: its bones are no human's by their names, so it moves by its own clips and takes garments "
            "from files."
        )
    return Character(
        name=path.stem,
        family="character",
        vertices=surface.vertices,
        faces=surface.faces,
        skeleton=Skeleton(tuple(names), np.array(parents), heads),
        weights=skinning,
        contact=contact,
        rig=Rig(replace(tree, world=world), bone_nodes, binds, tuple(morphs)),
        source_vertices=welded,
        clip=_clip(file, tree, clip),
        clip_names=tuple(_clip_names(file)),
        notes=tuple(notes),
    )


def _merged_bones(
    path: Path, nodes: Mapping[int, list[int]], inverses: Mapping[int, np.ndarray], places: Mapping[int, np.ndarray]
) -> tuple[list[int], list[np.ndarray], dict[tuple[int, int], int]]:
    """Node and bind transform (4, 4) of each bone, and the bone of each (skin, joint); equal bones of skins are one."""
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
        raise InputError(f"{path} has {len(bones):,} bones, and {_MOST_BONES:,} are the most.")
    return bones, matrices, bone_of


def _joined(
    parts: list[_Part],
    places: Mapping[int, np.ndarray],
    nodes: Mapping[int, list[int]],
    bone_of: Mapping[tuple[int, int], int],
) -> _Surface:
    """All parts in the bind pose as one surface."""
    width = max(part.joints.shape[1] for part in parts)
    vertices, faces, indices, weights, count = [], [], [], [], 0
    for part in parts:
        at = places[part.skin]
        shape = part.vertices + np.einsum("k,kvc->vc", part.morphed, part.targets)
        vertices.append(shape @ at[:3, :3].T + at[:3, 3])
        faces.append(part.faces + count)
        table = np.array([bone_of[part.skin, k] for k in range(len(nodes[part.skin]))])
        rest = ((0, 0), (0, width - part.joints.shape[1]))
        indices.append(np.pad(table[part.joints], rest))
        weights.append(np.pad(part.weights, rest))
        count += len(part.vertices)
    return _Surface(*(np.concatenate(each) for each in (vertices, faces, indices, weights)))


def _morphs(parts: list[_Part], places: Mapping[int, np.ndarray], world: np.ndarray, welded: np.ndarray) -> list[Morph]:
    morphs, row = [], 0
    for part in parts:
        at = (world @ places[part.skin])[:3, :3]
        if np.any(part.targets):
            rows = welded[row : row + len(part.vertices)]
            # A vertex that several of the file's have become is moved once, by the first of them.
            kept = np.unique(rows, return_index=True)[1]
            morphs.append(Morph(part.node, rows[kept], part.targets[:, kept] @ at.T, part.morphed))
        row += len(part.vertices)
    return morphs


def _tree(file: GltfFile) -> NodeTree:
    entries = file.entries("nodes")
    parents = np.full(len(entries), -1, dtype=np.int64)
    for node, entry in enumerate(entries):
        for child in entry.get("children", ()):
            if parents[child] >= 0 or child == node:
                raise ValueError(f"node {child} has two parents")
            parents[child] = node
    order: list[int] = []
    reached = np.zeros(len(entries), dtype=bool)
    waiting = np.flatnonzero(parents < 0).tolist()
    while waiting:
        node = waiting.pop()
        reached[node] = True
        order.append(node)
        waiting += entries[node].get("children", ())
    if not reached.all():
        raise ValueError("its nodes hang on each other in a circle")
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
        turn = np.array(entry.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)[[3, 0, 1, 2]]
        rotations[node] = turn / np.linalg.norm(turn)
    if not all((np.abs(each) < 1e7).all() for each in (translations, rotations, scales)):
        raise ValueError("a node's place is no finite number")
    weights = {}
    for node, entry in enumerate(entries):
        if "mesh" in entry:
            mesh = file.entries("meshes")[entry["mesh"]]
            targets = max((len(each.get("targets", ())) for each in mesh["primitives"]), default=0)
            given = entry.get("weights", mesh.get("weights", [0.0] * targets))
            if len(given) != targets:
                raise ValueError(f"node {node} has {len(given)} weights for {targets} morph targets")
            weights[node] = np.array(given, dtype=np.float64).reshape(1, targets)
    poses = NodePoses(translations[None], rotations[None], scales[None], weights)
    return NodeTree(tuple(str(e.get("name", "")) for e in entries), parents, tuple(order), poses, np.eye(4))


def _parts(file: GltfFile) -> list[_Part]:
    found = []
    for node, entry in enumerate(file.entries("nodes")):
        if "mesh" not in entry or "skin" not in entry:
            continue
        mesh = file.entries("meshes")[entry["mesh"]]
        morphed = np.array(entry.get("weights", mesh.get("weights", [])), dtype=np.float64)
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            if primitive.get("mode", 4) != 4 or "JOINTS_0" not in attributes:
                continue
            if any(name in primitive.get("extensions", {}) for name in ("KHR_draco_mesh_compression",)):
                raise InputError(
                    f"{file.path} is compressed by Draco, which is not read; export it without compression."
                )
            vertices = file.array(attributes["POSITION"]).astype(np.float64)
            faces = (file.array(primitive["indices"]) if "indices" in primitive else np.arange(len(vertices))).astype(
                np.int64
            )
            faces = faces[: len(faces) // 3 * 3].reshape(-1, 3)
            sets = range(sum(name.startswith("JOINTS_") for name in attributes))
            joints = np.concatenate([file.array(attributes[f"JOINTS_{k}"]) for k in sets], axis=1).astype(np.int64)
            weights = np.concatenate([file.array(attributes[f"WEIGHTS_{k}"]) for k in sets], axis=1).astype(np.float64)
            count = len(file.entries("skins")[entry["skin"]]["joints"])
            if not len(faces) or faces.max() >= len(vertices) or len(joints) != len(vertices):
                raise ValueError("a triangle has a vertex that is not there")
            if joints.min() < 0 or joints.max() >= count or weights.shape != joints.shape:
                raise ValueError("a vertex hangs on a bone that is not there")
            total = weights.sum(axis=1, keepdims=True)
            if not np.isfinite(vertices).all() or (weights < 0.0).any() or not (total > 0.0).all():
                raise ValueError("a vertex has no finite place, or no weight")
            targets = [
                file.array(t["POSITION"]) if "POSITION" in t else np.zeros_like(vertices)
                for t in primitive.get("targets", ())
            ]
            material = file.entries("materials")[primitive["material"]] if "material" in primitive else {}
            names = (entry.get("name", ""), mesh.get("name", ""), material.get("name", ""))
            own = np.resize(morphed, len(targets)) if len(morphed) else np.zeros(len(targets))
            offsets = np.array(targets, dtype=np.float64).reshape(len(targets), len(vertices), 3)
            if not np.isfinite(offsets).all():
                raise ValueError("a morph target is not finite")
            part = (names, node, entry["skin"], vertices, faces, joints, weights / total, offsets, own)
            found.append(_Part(*part))
    return found


def _chosen(path: Path, parts: list[_Part], wanted: Collection[str] | None) -> tuple[list[_Part], list[str]]:
    """The parts that make the body, and titles of the others."""
    if not parts:
        raise InputError(
            f"{path} has no skin: no mesh in it hangs on bones; give a mesh that stands still as .obj, and one that "
            "moves by itself as a sequence of vertices."
        )
    if wanted is None:
        chosen = [part for part in parts if part.is_skin]
    else:
        known = {name for part in parts for name in part.names if name}
        for name in wanted:
            if name not in known:
                raise InputError(f'{path} has no mesh or material "{name}"; it has {told_names(known)}.')
        chosen = [part for part in parts if set(wanted) & set(part.names)]
    titles = list(dict.fromkeys(part.title for part in parts))
    if not chosen:
        raise InputError(
            f"{path}: by their names none of its meshes is a body ({told_names(titles)}); name it with --body-parts."
        )
    if sum(len(part.faces) for part in chosen) > _MOST_TRIANGLES:
        raise InputError(f"{path} has over {_MOST_TRIANGLES:,} triangles; decimate it in the program it comes from.")
    kept = {part.title for part in chosen}
    return chosen, [title for title in titles if title not in kept]


def _skins(file: GltfFile, used: set[int]) -> tuple[dict[int, list[int]], dict[int, np.ndarray]]:
    """Nodes of the joints of each skin, and the inverse bind matrices (joints, 4, 4)."""
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


def _bind_spaces(
    tree: NodeTree, still: np.ndarray, nodes: dict[int, list[int]], inverses: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Transform (4, 4) of each skin's own space to the scene in the bind pose.

    In the bind pose all joints of a skin agree on where its space is. A file stands where its nodes say; where they
    stand in another pose, only their unit and the axes nearest to them are taken.
    """
    binds: dict[int, np.ndarray] = {}
    places: dict[int, np.ndarray] = {}
    depth = {node: k for k, node in enumerate(tree.order)}
    for skin in sorted(nodes, key=lambda skin: min(depth[node] for node in nodes[skin])):
        joints, inverse = nodes[skin], inverses[skin]
        known = next((k for k, node in enumerate(joints) if node in binds), None)
        if known is not None:
            place = binds[joints[known]] @ inverse[known]
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


def _upright(place: np.ndarray) -> np.ndarray:
    """A transform with its turn rounded to the nearest of the axes'."""
    left, stretch, right = np.linalg.svd(place[:3, :3])
    result = np.eye(4)
    result[:3, :3] = _nearest_axes(left @ right) * np.exp(np.log(stretch).mean())
    return result


def _nearest_axes(turn: np.ndarray) -> np.ndarray:
    """The turn (3, 3) that takes axes to axes and is nearest to one."""
    axes = np.zeros((3, 3))
    free = np.abs(turn)
    for _ in range(3):
        row, column = np.unravel_index(free.argmax(), free.shape)
        axes[row, column] = np.sign(turn[row, column])
        free[row], free[:, column] = -1.0, -1.0
    return axes


def _ordered(file: GltfFile, tree: NodeTree, bones: list[int]) -> tuple[np.ndarray, list[str], list[int]]:
    """Order in which the bones come, the hips first and parents before children; their names and parents in it."""
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
    known = smpl_names([tree.names[bones[b]] for b in by_depth], parents, ranks)
    hips = next((k for k, joint in (known or {}).items() if joint == "pelvis"), 0)
    # What lies above the hips goes with them: the skeleton of a human begins there.
    moved = [hips, *(k for k in range(len(by_depth)) if k != hips)]
    new = {old: k for k, old in enumerate(moved)}
    above, up = set(), parents[hips]
    while up >= 0:
        above.add(up)
        up = parents[up]
    names, seen = [], set()
    for old in moved:
        name = (known or {}).get(old) or tree.names[bones[by_depth[old]]] or f"bone {old}"
        while name in seen or (known and name in known.values() and old not in known):
            name += "'"
        seen.add(name)
        names.append(name)
    parted_from = [-1 if old == hips else 0 if old in above or parents[old] < 0 else new[parents[old]] for old in moved]
    order = np.array([by_depth[old] for old in moved])
    # Parents of what was above the hips come first already; of all others too, since the old order had them so.
    return order, names, parted_from


def _vrm_bones(file: GltfFile) -> dict[str, int]:
    """Node by VRM's name of the bone; empty where the file is none. VRM 0 lists them, VRM 1 names them."""
    extensions = file.document.get("extensions", {})
    old = extensions.get("VRM", {}).get("humanoid", {}).get("humanBones", [])
    new = extensions.get("VRMC_vrm", {}).get("humanoid", {}).get("humanBones", {})
    listed = {str(each["bone"]): int(each["node"]) for each in old} if isinstance(old, list) else {}
    return listed | {str(name): int(each["node"]) for name, each in new.items()}


def _world(
    path: Path, vertices: np.ndarray, names: list[str], binds: np.ndarray
) -> tuple[np.ndarray, list[str], list[str]]:
    """Transform (4, 4) of the scene to the world, names of the bones in it, and notes.

    In metres, upright and facing +Z, the hips over the origin and the feet at y = 0.
    """
    size = float(np.ptp(vertices, axis=0).max())
    unit = next((unit for unit, (low, high) in _SIZES.items() if low <= size < high), None)
    if unit is None:
        raise InputError(f"{path}: the character measures {size:g} m; glTF is in metres, scale it and export it again.")
    notes = []
    if unit != 1.0:
        notes.append(
            f"{path.name}: {size:.0f} m tall, so it is taken to be in {'centi' if unit == 0.01 else 'milli'}metres."
        )
    turn, places = np.eye(3), binds[:, :3, 3]
    if "pelvis" in names:
        pelvis, head, ankle, *hips = (
            places[names.index(name)] for name in ("pelvis", "head", "left_ankle", "left_hip", "right_hip")
        )
        left, up = hips[0] - hips[1], head - pelvis
        up = up - left * (up @ left) / (left @ left)
        axes = np.stack([each / np.linalg.norm(each) for each in (left, up, np.cross(left, up))])
        turn = _nearest_axes(axes)
        standing = (vertices - ankle) @ turn.T
        if standing[standing[:, 1] < 0.0, 2].sum() < 0.0:
            # Its toes point backwards: a mirror has made its left side its right.
            turn = np.diag([-1.0, 1.0, -1.0]) @ turn
            names = [_OTHER_SIDE.sub(lambda side: "right" if side[0] == "left" else "left", name) for name in names]
            notes.append(f"{path.name}: mirrored by the scale of a node, so its left and right are swapped.")
        if not np.array_equal(turn, np.eye(3)):
            upright = "" if turn[1, 1] == 1.0 else "upright and "
            notes.append(f"{path.name}: turned {upright}to face +Z, by its hips, head and feet.")
    world = np.eye(4)
    world[:3, :3] = unit * turn
    moved = vertices @ world[:3, :3].T
    middle = world[:3, :3] @ places[0] if "pelvis" in names else 0.5 * (moved.min(axis=0) + moved.max(axis=0))
    world[:3, 3] = -np.array([middle[0], moved[:, 1].min(), middle[2]])
    return world, names, notes


def _completed(
    names: list[str], parents: list[int], joints: np.ndarray, nodes: np.ndarray, binds: np.ndarray, vertices: np.ndarray
) -> tuple[list[str], list[int], np.ndarray, np.ndarray, np.ndarray]:
    """A human's bones with those that rigs leave out: toes, collar bones and the neck, moving with their parents."""
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


def _clip_names(file: GltfFile) -> list[str]:
    return [str(entry.get("name") or f"clip {k}") for k, entry in enumerate(file.entries("animations"))]


def _clip(file: GltfFile, tree: NodeTree, wanted: str | None) -> Clip | None:
    entries, names = file.entries("animations"), _clip_names(file)
    if wanted is not None and wanted not in names:
        held = f"it has {told_names(names)}" if names else "it has none"
        raise InputError(f'{file.path} has no clip "{wanted}"; {held}.')
    if not entries:
        return None
    index = 0 if wanted is None else names.index(wanted)
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
            values = values[:, [3, 0, 1, 2]]
            if kind != "CUBICSPLINE":
                values = values / np.linalg.norm(values, axis=1, keepdims=True)
        if (
            not len(times)
            or (np.diff(times) < 0).any()
            or not np.isfinite(values).all()
            or not np.isfinite(times).all()
        ):
            raise ValueError(f"the clip {names[index]} has key frames that do not rise, or are not finite")
        if times[-1] > 1e5 or not 0 <= target["node"] < len(file.entries("nodes")):
            raise ValueError(f"the clip {names[index]} has a key frame at {times[-1]:g} s, or moves no node")
        if target["path"] == "weights" and values.shape[1] != tree.poses.weights[target["node"]].shape[1]:
            raise ValueError(f"the clip {names[index]} has another number of weights than there are morph targets")
        if kind == "CUBICSPLINE":
            values = values.reshape(len(times), 3, -1)
        channels.append(Channel(target["node"], target["path"], times, values, kind))
    return Clip(names[index], tuple(channels))


@dataclass(frozen=True, eq=False)
class _Surface:
    """A skinned surface.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        bones: (vertices, influences) int64.
        weights: (vertices, influences) [1].
    """

    vertices: np.ndarray
    faces: np.ndarray
    bones: np.ndarray
    weights: np.ndarray

    def renumbered(self, rank: np.ndarray) -> _Surface:
        """The same surface with other numbers of its bones."""
        return _Surface(self.vertices, self.faces, rank[self.bones], self.weights)

    def moved(self, transform: np.ndarray) -> _Surface:
        """The same surface elsewhere."""
        places = self.vertices @ transform[:3, :3].T + transform[:3, 3]
        return _Surface(places, self.faces, self.bones, self.weights)

    def welded(self) -> tuple[_Surface, np.ndarray]:
        """The surface with vertices in one place as one, where the same bones move them; and the vertex of each.

        glTF splits a vertex wherever its normal or its texture has two values.
        """
        reach = _SAME_PLACE * max(float(np.ptp(self.vertices, axis=0).max()), 1e-9)
        pairs = cKDTree(self.vertices).query_pairs(reach, output_type="ndarray")
        apart = np.abs(self._dense(pairs[:, 0]) - self._dense(pairs[:, 1])).max(axis=1, initial=0.0)
        pairs = pairs[apart < _SAME_WEIGHT]
        number = connected_labels(len(self.vertices), pairs[:, 0], pairs[:, 1])
        _, kept, number = np.unique(number, return_index=True, return_inverse=True)
        number = number.reshape(-1)
        faces = number[self.faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        # One triangle counts once, whichever way round.
        _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        faces = faces[np.sort(once)]
        return _Surface(self.vertices[kept], faces, self.bones[kept], self.weights[kept]), number

    def _dense(self, rows: np.ndarray) -> np.ndarray:
        """Weights (rows, bones) of some vertices by bone."""
        result = np.zeros((len(rows), int(self.bones.max()) + 1), dtype=np.float32)
        np.add.at(result, (np.arange(len(rows))[:, None], self.bones[rows]), self.weights[rows])
        return result

    def turned_outward(self) -> _Surface:
        """The surface with each of its pieces turned so that its volume is positive."""
        topology = Topology(self.faces, len(self.vertices))
        piece = topology.piece_of_vertex[self.faces[:, 0]]
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        volume = np.bincount(piece, np.einsum("fc,fc->f", a, np.cross(b, c)))
        faces = np.where((volume[piece] < 0.0)[:, None], self.faces[:, ::-1], self.faces)
        return _Surface(self.vertices, np.ascontiguousarray(faces), self.bones, self.weights)

    def closed(self) -> tuple[_Surface, str]:
        """The surface with a fan over each hole, and what was closed in words (may be empty)."""
        loops = _hole_cycles(self.faces)
        if not loops:
            return self, ""
        vertices, faces, bones, weights = [self.vertices], [self.faces], [self.bones], [self.weights]
        width = self.bones.shape[1]
        sizes = []
        for k, loop in enumerate(loops):
            centre = len(self.vertices) + k
            faces.append(np.column_stack([loop, np.roll(loop, -1), np.full(len(loop), centre)]))
            vertices.append(self.vertices[loop].mean(axis=0)[None])
            mean = self._dense(loop).mean(axis=0)
            strongest = np.argsort(-mean, kind="stable")[:width]
            bones.append(np.pad(strongest, (0, width - len(strongest)))[None])
            kept = np.pad(mean[strongest], (0, width - len(strongest)))
            weights.append((kept / kept.sum())[None])
            sizes.append(float(np.linalg.norm(np.ptp(self.vertices[loop], axis=0))))
        sentence = f"{len(loops)} hole(s) of the surface, the largest {100 * max(sizes):.0f} cm across, are"
        return _Surface(*(np.concatenate(each) for each in (vertices, faces, bones, weights))), sentence


def _hole_cycles(faces: np.ndarray) -> list[np.ndarray]:
    """The holes of triangles (faces, 3) as cycles of vertices, in the direction that triangles over them have."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max()) + 1
    missing = np.setdiff1d(directed[:, 1] * count + directed[:, 0], directed[:, 0] * count + directed[:, 1])
    following: dict[int, list[int]] = {}
    for start, end in zip((missing // count).tolist(), (missing % count).tolist(), strict=True):
        following.setdefault(start, []).append(end)
    cycles = []
    while following:
        way = [next(iter(following))]
        place = {way[0]: 0}
        while way and following.get(way[-1]):
            end = following[way[-1]].pop()
            if not following[way[-1]]:
                del following[way[-1]]
            if end not in place:
                place[end] = len(way)
                way.append(end)
                continue
            # Where holes touch in a vertex, each is a cycle of its own.
            cycle = way[place[end] :]
            cycles.append(np.array(cycle))
            for vertex in cycle[1:]:
                del place[vertex]
            way = way[: place[end] + 1]
        following.pop(way[-1], None)
    return [cycle for cycle in cycles if len(cycle) > 2]
