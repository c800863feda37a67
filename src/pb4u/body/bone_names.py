"""Which bones of a rigged character are hips, limbs, spine and head, by their names or by VRM's own list.

They get the names of SMPL's joints, for which garments are cut and motions are known. Sides and limbs are recognised by
words, and the hips and the spine by where limbs join: rigs name those in most different ways.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

# SMPL's joint, of which {} is the side -> words that other rigs have for it, the surest first.
_LIMBS = {
    "{}_hip": ("thigh", "upleg", "upperleg", "femur", "hip"),
    "{}_knee": ("calf", "shin", "lowerleg", "leg", "knee", "tibia"),
    "{}_ankle": ("ankle", "foot"),
    "{}_foot": ("toebase", "toe", "toes", "ball"),
    "{}_collar": ("clavicle", "collar", "shoulder"),
    "{}_shoulder": ("upperarm", "uparm", "arm", "humerus", "shldr", "shoulder"),
    "{}_elbow": ("forearm", "lowerarm", "lowarm", "elbow", "radius"),
    "{}_wrist": ("hand", "wrist"),
}
_CENTRE = ("neck", "head")
_VRM_LIMBS = {
    "{}_hip": "UpperLeg", "{}_knee": "LowerLeg", "{}_ankle": "Foot", "{}_foot": "Toes",
    "{}_collar": "Shoulder", "{}_shoulder": "UpperArm", "{}_elbow": "LowerArm", "{}_wrist": "Hand",
}  # fmt: skip
_PAIRED = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
NEEDED = ("head", *(f"{side}_{joint}" for side in ("left", "right") for joint in _PAIRED))
"""Joints without which a skeleton is not taken for a human's; toes, collar bones and the neck may be missing."""
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
# Words of rigs that say nothing of the bone, and those that say that it is none of the chain.
_IDLE = {"mixamorig", "bip", "j", "c", "def", "org", "cc", "base", "bone", "joint", "jnt", "skin", "bind", "sk", "b"}
_ASIDE = {"twist", "roll", "ik", "pole", "target", "ctrl", "helper", "end", "nub", "tip", "share", "dummy", "offset"}


def smpl_names(
    names: Sequence[str], parents: Sequence[int], vrm: Mapping[str, int] | None = None
) -> dict[int, str] | None:
    """Bones by the SMPL joints that they are; None where they are not a human's.

    Args:
        names: of the bones, parents before children.
        parents: index of each parent, -1 of a root.
        vrm: bone by VRM's name, where the file has them.
    """
    found = _of_vrm(vrm) if vrm else _by_words(names)
    if any(joint not in found for joint in NEEDED):
        return None
    up = [_ancestry(found[joint], parents) for joint in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")]
    hips = next((bone for bone in up[0][1:] if bone in up[1]), None)
    chest = next((bone for bone in up[2][1:] if bone in up[3]), None)
    if hips is None or chest is None:
        return None
    way = _ancestry(chest, parents)
    spine = way[: way.index(hips)][::-1] if hips in way else []
    if not spine:
        return None
    found["pelvis"] = hips
    for joint, share in (("spine1", 0), ("spine2", len(spine) // 2), ("spine3", len(spine) - 1)):
        found[joint] = spine[share]
    # Of the same bone the later joint counts: a single bone from hips to shoulders is the chest.
    return {bone: joint for joint, bone in found.items()}


def _of_vrm(vrm: Mapping[str, int]) -> dict[str, int]:
    own = {joint: vrm[joint] for joint in _CENTRE if joint in vrm}
    for side in ("left", "right"):
        own |= {joint.format(side): vrm[f"{side}{w}"] for joint, w in _VRM_LIMBS.items() if f"{side}{w}" in vrm}
    return own


def _by_words(names: Sequence[str]) -> dict[str, int]:
    read: dict[tuple[str, str], int] = {}
    for bone, name in enumerate(names):
        key = _words(name)
        if key is not None:
            read.setdefault(key, bone)
    found = {joint: read["", joint] for joint in _CENTRE if ("", joint) in read}
    for side in ("left", "right"):
        for joint, words in _LIMBS.items():
            chosen = next((read[side, word] for word in words if (side, word) in read), None)
            if chosen is not None:
                found[joint.format(side)] = chosen
        # "Shoulder" is the collar bone of some and the upper arm of others, "foot" the ankle's bone or the toes'.
        if found.get(f"{side}_collar") == found.get(f"{side}_shoulder"):
            found.pop(f"{side}_collar", None)
        if (side, "ankle") in read and (side, "foot") in read:
            found.setdefault(f"{side}_foot", read[side, "foot"])
    return found


def _words(name: str) -> tuple[str, str] | None:
    """Side ("left", "right" or "") and word of a bone's name; None where it is no bone of a chain."""
    plain = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", name.rpartition(":")[2])
    plain = re.sub(r"([A-Z])([A-Z][a-z])", r"\1 \2", plain)
    side, words = "", []
    for word in re.split(r"[^a-z]+", plain.lower()):
        stuck = re.fullmatch(r"(left|right)(\w+)", word)
        if stuck:
            side, word = stuck[1], stuck[2]
        if word in _SIDES:
            side = _SIDES[word]
        elif word in _ASIDE:
            return None
        elif word and word not in _IDLE:
            words.append(word)
    return side, "".join(words)


def _ancestry(bone: int, parents: Sequence[int]) -> list[int]:
    way = [bone]
    while parents[way[-1]] >= 0:
        way.append(parents[way[-1]])
    return way
