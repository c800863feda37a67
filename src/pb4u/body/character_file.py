"""Rigged characters of glTF and VRM files: meshes joined, cleaned for contact, and set up at rest."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pb4u.body.bone_names import NEEDED
from pb4u.body.character import Character, Morph, Rig
from pb4u.body.character_animation import clip_names, node_tree, read_clip
from pb4u.body.character_bones import (
    bind_spaces,
    completed_bones,
    merged_bones,
    nearest_axes,
    ordered_bones,
)
from pb4u.body.character_surface import CharacterSurface
from pb4u.body.contact_region import reachable, share_out_of_contact
from pb4u.body.length_units import UNITS, body_unit, extent_of, is_person
from pb4u.body.skeleton import Skeleton, hand_bones
from pb4u.body.skin_pieces import skin_vertices
from pb4u.body.skinning import SkinningWeights
from pb4u.errors import InputError, warn
from pb4u.geometry.gltf_skin import influences, read_skins
from pb4u.geometry.topology import Topology, joined_indices, offsets
from pb4u.io.gltf_file import GltfFile, read_gltf
from pb4u.io.reading_limits import names_text, refusing

# Words of meshes and materials that are no skin; a material called skin, body or face outweighs its mesh's name.
_HEAD = r"hair|eye|brow|lash|iris|pupil|cornea|teeth|tooth|tongue|gum|beard|moustache|glasses|hat|helmet|cap"
_NOT_SKIN = re.compile(
    rf"{_HEAD}|cloth|shirt|"
    r"tops|bottoms|pants|trousers|jeans|shorts|skirt|dress|jacket|coat|hoodie|sweater|suit|shoe|boot|sneaker|sock|"
    r"glove|outfit|garment|underwear|bra|onepiece|accessor|weapon|tear|belt|bag",
    re.IGNORECASE,
)
_SKIN = re.compile(r"skin|body|face|flesh", re.IGNORECASE)
_MOST_TRIANGLES = 1_000_000
# Rays with which it is seen whether cloth can reach a vertex: a tenth of a millisecond each vertex.
_RAYS = 32
# Share of the skin out of contact, hands aside, that is told of: eyes, mouth and folds of sound ones have less.
_MOST_OUT = 0.06
# A hole wider than this share of the height is not a neck or wrist where meshes meet.
_WIDE = 0.15
_OTHER_SIDE = re.compile("left|right")


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

    def only(self, mask: np.ndarray) -> _Part:
        """The part with some of its vertices alone, (vertices,) bool."""
        if mask.all():
            return self
        faces = (np.cumsum(mask) - 1)[self.faces[mask[self.faces].all(axis=1)]]
        return replace(
            self, vertices=self.vertices[mask], faces=faces, joints=self.joints[mask], weights=self.weights[mask],
            targets=self.targets[:, mask],
        )  # fmt: skip

    @property
    def is_skin(self) -> bool:
        *meshes, material = self.names
        if _NOT_SKIN.search(material):
            return False
        return bool(_SKIN.search(material)) or not any(_NOT_SKIN.search(name) for name in meshes)


def read_character(
    path: Path, clip: str | None = None, parts: Collection[str] | None = None, units: str | None = None
) -> Character:
    """The character of a glTF or VRM file in its bind pose, feet on y = 0, facing +Z.

    All skinned meshes are joined but hair, eyes, clothes and the like, recognised by their names and those of their
    materials. Holes are closed, so that inside and outside are defined.

    Args:
        path: the .glb, .gltf or .vrm.
        clip: name of the animation that it performs; by default the first.
        parts: names of the meshes or materials that form the body; by default recognised by their names.
        units: name of its unit of length; by default recognised by the size of a person.

    Raises:
        InputError: it is not a glTF file, is compressed by Draco or meshopt, has no skin, no such clip or part, or is
            damaged.
    """
    file = read_gltf(path)
    with refusing(path, "is damaged"):
        return _character(file, clip, parts, units)


def _character(file: GltfFile, clip: str | None, parts: Collection[str] | None, units: str | None) -> Character:
    path = file.path
    tree = node_tree(file)
    chosen, others = _chosen(path, _parts(file), parts)
    still = tree.globals(tree.poses)[0]
    nodes, inverses = read_skins(file, {part.skin for part in chosen})
    places = bind_spaces(tree, still, nodes, inverses)

    bones, matrices, bone_of = merged_bones(path, nodes, inverses, places)
    surface = _joined(chosen, places, nodes, bone_of)
    order, names, parents = ordered_bones(file, tree, bones)
    rest = others
    if parts is None:
        chosen, covers = _skin_alone(chosen, skin_vertices(surface, _limbs(names, parents)[np.argsort(order)]))
        surface, rest = _joined(chosen, places, nodes, bone_of), [*others, *covers]
    rest = [*rest, *(title for title in _unskinned(file) if title not in rest)]
    rank = np.argsort(order)
    binds = np.stack(matrices)[order]
    ranked = np.array(bones)[order]
    surface = surface.renumbered(rank)
    world, names, more = _world(path, surface.vertices, names, binds, units)
    taken = f"{path.name}: the body is {', '.join(dict.fromkeys(part.title for part in chosen))}"
    notes = [f"{taken}; left out of the body: {', '.join(rest)}; --body-parts chooses." if rest else f"{taken}.", *more]
    surface, welded = surface.moved(world).welded()
    surface, holes = surface.turned_outward().closed()
    if holes:
        sentence = f"{len(holes)} hole(s) of the surface, the largest {100 * max(holes):.0f} cm across, are closed"
        notes.append(f"{path.name}: {sentence}, so that the surface is closed.")
        outer = [title for title in others if not re.search(_HEAD, title, re.IGNORECASE)]
        if outer and max(holes) > _WIDE * float(np.ptp(surface.vertices[:, 1])):
            every = dict.fromkeys([*(part.title for part in chosen), *outer])
            warn(
                f"{path.name}: its skin has a hole of {100 * max(holes):.0f} cm, as where skin under clothes was "
                f"deleted; cloth falls in there, so add the meshes that cover it: --body-parts {','.join(every)}."
            )
    if not Topology(surface.faces, len(surface.vertices)).is_closed:
        notes.append(f"{path.name}: its surface is still not closed, so penetration is not reported.")
    binds = world @ binds
    if not (np.abs(np.linalg.det(binds)) > 1e-20).all():
        raise ValueError("a bone is flattened by the scale of a node")
    heads = binds[:, :3, 3]
    names, parents, heads, bone_nodes, binds = completed_bones(names, parents, heads, ranked, binds, surface.vertices)
    skinning = SkinningWeights(surface.bones, surface.weights.astype(np.float32))
    of_hand = skinning.share_of(hand_bones(names, parents))
    contact = reachable(surface.vertices, surface.faces, of_hand <= 0.5, _RAYS)
    notes.append(_tell_of_contact(path, surface, contact, of_hand > 0.5))
    morphs = _morphs(chosen, places, world, welded)
    if "pelvis" not in names:
        notes.append(
            f"{path.name}: its bone names are not those of a human, so only its own clips move it and only garments "
            "from files fit it."
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
        clip=read_clip(file, tree, clip),
        clip_names=tuple(clip_names(file)),
        notes=tuple(notes),
    )


def _limbs(names: list[str], parents: list[int]) -> np.ndarray:
    """Number (bones,) int64 of the limb or head that each bone of a human is in, -1 of the trunk; its own of others."""
    if "pelvis" not in names:
        return np.arange(len(names))
    limbs = np.full(len(names), -1)
    for bone, (name, parent) in enumerate(zip(names, parents, strict=True)):
        limbs[bone] = bone if name in NEEDED else limbs[parent] if parent >= 0 else -1
    return limbs


def _tell_of_contact(path: Path, surface: CharacterSurface, contact: np.ndarray, of_hand: np.ndarray) -> str:
    """What is said of the skin that takes no part in contact; warns where much of it is not a hand."""
    out = share_out_of_contact(surface.vertices, surface.faces, contact)
    beyond = share_out_of_contact(surface.vertices, surface.faces, contact | of_hand)
    if beyond > _MOST_OUT:
        warn(
            f"{path.name}: {100 * beyond:.0f} % of its skin, hands not counted, takes no part in contact, because "
            "other surfaces cover it; cloth passes through there: leave the covering parts out with --body-parts."
        )
    return (
        f"{path.name}: {100 * out:.0f} % of its skin takes no part in contact: the hands, and skin that cloth "
        "cannot reach."
    )


def _unskinned(file: GltfFile) -> list[str]:
    """Names of the meshes that hang on no bones."""
    meshes = file.entries("meshes")
    return [
        str(entry.get("name") or meshes[entry["mesh"]].get("name") or "a mesh without a name")
        for entry in file.entries("nodes")
        if "mesh" in entry and "skin" not in entry
    ]


def _skin_alone(parts: list[_Part], skin: np.ndarray) -> tuple[list[_Part], list[str]]:
    """The parts without what is not skin, and titles of that; `skin` (vertices,) bool is of all parts."""
    skins, omitted = list[_Part](), list[str]()
    starts = offsets([part.vertices for part in parts])
    masks = [skin[start : start + len(part.vertices)] for start, part in zip(starts, parts, strict=False)]
    titles = [part.title for part, mask in zip(parts, masks, strict=True) if mask.any()]
    for part, mask in zip(parts, masks, strict=True):
        title = part.title if part.title not in titles else next(filter(None, part.names), part.title)
        if not mask.any():
            omitted.append(title)
            continue
        skins.append(part.only(mask))
        if lost := len(part.faces) - len(skins[-1].faces):
            omitted.append(f"{lost:,} faces of {title} that are not skin")
    return skins, list(dict.fromkeys(omitted))


def _joined(
    parts: list[_Part],
    places: Mapping[int, np.ndarray],
    nodes: Mapping[int, list[int]],
    bone_of: Mapping[tuple[int, int], int],
) -> CharacterSurface:
    """All parts in the bind pose as one surface."""
    width = max(part.joints.shape[1] for part in parts)
    vertices, indices, weights = [], [], []
    for part in parts:
        at = places[part.skin]
        shape = part.vertices + np.einsum("k,kvc->vc", part.morphed, part.targets)
        vertices.append(shape @ at[:3, :3].T + at[:3, 3])
        table = np.array([bone_of[part.skin, k] for k in range(len(nodes[part.skin]))])
        rest = ((0, 0), (0, width - part.joints.shape[1]))
        indices.append(np.pad(table[part.joints], rest))
        weights.append(np.pad(part.weights, rest))
    faces = joined_indices([part.faces for part in parts], offsets(vertices))
    return CharacterSurface(np.concatenate(vertices), faces, np.concatenate(indices), np.concatenate(weights))


def _morphs(parts: list[_Part], places: Mapping[int, np.ndarray], world: np.ndarray, welded: np.ndarray) -> list[Morph]:
    morphs, row = [], 0
    for part in parts:
        at = (world @ places[part.skin])[:3, :3]
        if np.any(part.targets):
            rows = welded[row : row + len(part.vertices)]
            # A vertex that several of the file's have become is moved once, by the first of them.
            first = np.unique(rows, return_index=True)[1]
            morphs.append(Morph(part.node, rows[first], part.targets[:, first] @ at.T, part.morphed))
        row += len(part.vertices)
    return morphs


def _parts(file: GltfFile) -> list[_Part]:
    parts = []
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
                    f"{file.path} is compressed by Draco, which pb4u does not read; export it without compression."
                )
            vertices = file.array(attributes["POSITION"]).astype(np.float64)
            faces = (file.array(primitive["indices"]) if "indices" in primitive else np.arange(len(vertices))).astype(
                np.int64
            )
            faces = faces[: len(faces) // 3 * 3].reshape(-1, 3)
            if not len(faces) or faces.max() >= len(vertices):
                raise ValueError("a triangle names a vertex that does not exist")
            if not np.isfinite(vertices).all():
                raise ValueError("a vertex has no finite position, or no weight")
            count = len(file.entries("skins")[entry["skin"]]["joints"])
            joints, weights = influences(file, attributes, len(vertices), count)
            targets = [
                file.array(t["POSITION"]) if "POSITION" in t else np.zeros_like(vertices)
                for t in primitive.get("targets", ())
            ]
            material = file.entries("materials")[primitive["material"]] if "material" in primitive else {}
            names = (entry.get("name", ""), mesh.get("name", ""), material.get("name", ""))
            start_weights = np.resize(morphed, len(targets)) if len(morphed) else np.zeros(len(targets))
            deltas = np.array(targets, dtype=np.float64).reshape(len(targets), len(vertices), 3)
            if not np.isfinite(deltas).all():
                raise ValueError("a morph target is not finite")
            part = (names, node, entry["skin"], vertices, faces, joints, weights, deltas, start_weights)
            parts.append(_Part(*part))
    return parts


def _chosen(path: Path, parts: list[_Part], names: Collection[str] | None) -> tuple[list[_Part], list[str]]:
    """The parts that make the body, and titles of the others."""
    if not parts:
        raise InputError(
            f"{path} has no skin: no mesh in it is bound to bones; give a mesh that does not move as .obj, and an "
            "animated one as a sequence of vertices."
        )
    if names is None:
        chosen = [part for part in parts if part.is_skin]
    else:
        offered = {name for part in parts for name in part.names if name}
        for name in names:
            if name not in offered:
                raise InputError(f'{path} has no mesh or material "{name}"; it has {names_text(offered)}.')
        chosen = [part for part in parts if set(names) & set(part.names)]
    titles = list(dict.fromkeys(part.title for part in parts))
    if not chosen:
        raise InputError(
            f"{path}: none of its meshes has the name of a body ({names_text(titles)}); name it with --body-parts."
        )
    if sum(len(part.faces) for part in chosen) > _MOST_TRIANGLES:
        raise InputError(f"{path} has over {_MOST_TRIANGLES:,} triangles; decimate it in the program it comes from.")
    chosen_titles = {part.title for part in chosen}
    return chosen, [title for title in titles if title not in chosen_titles]


def _world(
    path: Path, vertices: np.ndarray, names: list[str], binds: np.ndarray, units: str | None
) -> tuple[np.ndarray, list[str], list[str]]:
    """Transform (4, 4) of the scene to the world, names of the bones in it, and notes.

    In metres, upright and facing +Z, the hips over the origin and the feet at y = 0.
    """
    unit, note = body_unit(path, extent_of(vertices), units)
    notes = [] if note is None else [f"{path.name}: {note}"]
    if units is None and unit == "metres" and not is_person(extent_of(vertices)):
        notes.append(
            f"{path.name}: it measures {extent_of(vertices):.3g} m, which is not the size of a person; --body-units "
            "scales it."
        )
    turn, places = np.eye(3), binds[:, :3, 3]
    if "pelvis" in names:
        pelvis, head, ankle, *hips = (
            places[names.index(name)] for name in ("pelvis", "head", "left_ankle", "left_hip", "right_hip")
        )
        left, up = hips[0] - hips[1], head - pelvis
        up = up - left * (up @ left) / (left @ left)
        axes = np.stack([axis / np.linalg.norm(axis) for axis in (left, up, np.cross(left, up))])
        turn = nearest_axes(axes)
        standing = (vertices - ankle) @ turn.T
        if standing[standing[:, 1] < 0.0, 2].sum() < 0.0:
            # Its toes point backwards: a mirror has made its left side its right.
            turn = np.diag([-1.0, 1.0, -1.0]) @ turn
            names = [_OTHER_SIDE.sub(lambda side: "right" if side[0] == "left" else "left", name) for name in names]
            notes.append(f"{path.name}: the scale of a node mirrors it, so its left and right are swapped.")
        if not np.array_equal(turn, np.eye(3)):
            upright = "" if turn[1, 1] == 1.0 else "upright and "
            notes.append(f"{path.name}: turned {upright}to face +Z, by its hips, head and feet.")
    world = np.eye(4)
    world[:3, :3] = UNITS[unit] * turn
    turned = vertices @ world[:3, :3].T
    middle = world[:3, :3] @ places[0] if "pelvis" in names else 0.5 * (turned.min(axis=0) + turned.max(axis=0))
    world[:3, 3] = -np.array([middle[0], turned[:, 1].min(), middle[2]])
    return world, names, notes
