"""Which bones of a skeleton are hips, limbs, spine and head, by their names or by VRM's own list.

One table serves characters and recordings alike. Sides and limbs are recognised by words, and the hips, the spine and
the neck by where limbs and head join: rigs name those in most different ways. The joints get SMPL's names, for which
garments are cut and motions are known.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

_JOINTS = tuple(f"{{}}_{joint}" for joint in ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist"))
# Naming scheme -> words of both sides, and its names of these joints, in which {} is the side.
_NAMES: Mapping[str, tuple[str, str]] = {
    "Unreal": ("l r", "thigh_{} calf_{} foot_{} ball_{} clavicle_{} upperarm_{} lowerarm_{} hand_{}"),
    "3ds Max Biped": (
        "L R",
        "Bip01_{}_Thigh Bip01_{}_Calf Bip01_{}_Foot Bip01_{}_Toe0 Bip01_{}_Clavicle Bip01_{}_UpperArm "
        "Bip01_{}_Forearm Bip01_{}_Hand",
    ),
    "VRM": ("left right", "{}UpperLeg {}LowerLeg {}Foot {}Toes {}Shoulder {}UpperArm {}LowerArm {}Hand"),
    "MakeHuman": (
        "L R", "upperleg01.{} lowerleg01.{} foot.{} toe1-1.{} clavicle.{} upperarm01.{} lowerarm01.{} wrist.{}",
    ),
    "Poser / DAZ": ("l r", "{}Thigh {}Shin {}Foot {}Toe {}Collar {}Shldr {}ForeArm {}Hand"),
    "Rokoko": ("Left Right", "{}Thigh {}Shin {}Foot {}Toe {}Shoulder {}Arm {}ForeArm {}Hand"),
    "Mixamo": ("Left Right", "{}UpLeg {}Leg {}Foot {}ToeBase {}Shoulder {}Arm {}ForeArm {}Hand"),
    "CMU (cgspeed)": ("Left Right", "{}UpLeg {}Leg {}Foot {}ToeBase {}Shoulder {}Arm {}ForeArm {}Hand"),
    "LAFAN1": ("Left Right", "{}UpLeg {}Leg {}Foot {}Toe {}Shoulder {}Arm {}ForeArm {}Hand"),
    "Xsens": ("Left Right", "{}Hip {}Knee {}Ankle {}Toe {}Collar {}Shoulder {}Elbow {}Wrist"),
    "CMU (MotionBuilder)": ("Left Right", "{}Hip {}Knee {}Ankle {}Toe {}Collar {}Shoulder {}Elbow {}Wrist"),
    "SMPL": ("left right", "{}_hip {}_knee {}_ankle {}_foot {}_collar {}_shoulder {}_elbow {}_wrist"),
    "CMU ASF": ("l r", "{}femur {}tibia {}foot {}toes {}clavicle {}humerus {}radius {}hand"),
}  # fmt: skip
# Words that other rigs have for them.
_WORDS = {
    "hip": ("femur", "hipjoint"),
    "knee": ("tibia",),
    "shoulder": ("uparm", "humerus"),
    "elbow": ("lowarm", "radius"),
}
SCHEMES = tuple(_NAMES)
"""Naming schemes that are known by name."""
_CENTRE = ("neck", "head")
_PAIRED = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
NEEDED = ("head", *(f"{side}_{joint}" for side in ("left", "right") for joint in _PAIRED))
"""Joints without which a skeleton is not taken for a human's; toes, collar bones and the neck may be missing."""
_BELOW = {
    f"{side}_{joint}": f"{side}_{below}"
    for side in ("left", "right")
    for joint, below in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
# Words of rigs that say nothing of the bone, and those that say that it is none of the chain.
_IDLE = {
    "mixamorig", "bip", "j", "c", "def", "org", "cc", "base", "bone", "joint", "jnt", "skin", "bind", "sk", "b",
    "bend",
}  # fmt: skip
_ASIDE = {"twist", "roll", "ik", "pole", "target", "ctrl", "helper", "end", "nub", "tip", "share", "dummy", "offset"}
# A word before so many of the names is the rig's own.
_MOST = 0.9


@dataclass(frozen=True, eq=False)
class HumanBones:
    """Bones of a human.

    Args:
        joints: bone by SMPL's name of the joint at its head, of limbs, neck and head.
        pelvis: the parent of both legs.
        spine: one or more bones, from above the pelvis to the parent of both arms.
        neck: bones between the spine and the head; there may be none.
    """

    joints: Mapping[str, int]
    pelvis: int
    spine: tuple[int, ...]
    neck: tuple[int, ...]


def human_bones(
    names: Sequence[str], parents: Sequence[int], vrm: Mapping[str, int] | None = None
) -> HumanBones | None:
    """The bones of a human; None if the skeleton is not human.

    Args:
        names: of the bones, parents before children.
        parents: index of each parent, -1 of a root.
        vrm: bone by VRM's name, if the file has these names.
    """
    bones = _of_vrm(vrm) if vrm else _by_words(names, parents)
    if any(joint not in bones for joint in NEEDED):
        return None
    up = [_ancestry(bones[joint], parents) for joint in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")]
    hips = next((bone for bone in up[0][1:] if bone in up[1]), None)
    chest = next((bone for bone in up[2][1:] if bone in up[3]), None)
    if hips is None or chest is None:
        return None
    way = _ancestry(chest, parents)
    spine = way[: way.index(hips)][::-1] if hips in way else []
    if not spine:
        return None
    if len(spine) > 1 and spine[-1] == bones.get("neck"):  # collar bones that hang on the neck, as Biped has them
        spine.pop()
    above = _ancestry(bones["head"], parents)[1:]
    neck = above[: above.index(spine[-1])][::-1] if spine[-1] in above else []
    if neck:
        bones.setdefault("neck", neck[0])
    return HumanBones(bones, hips, tuple(spine), tuple(neck))


def smpl_names(
    names: Sequence[str], parents: Sequence[int], vrm: Mapping[str, int] | None = None
) -> dict[int, str] | None:
    """SMPL's joint name of each bone; None if the skeleton is not human.

    Args:
        names: of the bones, parents before children.
        parents: index of each parent, -1 of a root.
        vrm: bone by VRM's name, if the file has these names.
    """
    human = human_bones(names, parents, vrm)
    if human is None:
        return None
    bones, spine = {**human.joints, "pelvis": human.pelvis}, human.spine
    for joint, share in (("spine1", 0), ("spine2", len(spine) // 2), ("spine3", len(spine) - 1)):
        bones[joint] = spine[share]
    # Of the same bone the later joint counts: a single bone from hips to shoulders is the chest.
    return {bone: joint for joint, bone in bones.items()}


def unknown_bones(names: Sequence[str], parents: Sequence[int]) -> str:
    """Sentence on why a skeleton is not recognised as human: the nearest naming scheme, its missing bones, and likely
    matches.

    Args:
        names: of the bones, parents before children.
        parents: index of each parent, -1 of a root.
    """
    bones = _by_words(names, parents)
    plain = {name.casefold() for name in names}
    nearest = max(SCHEMES, key=lambda scheme: sum(name.casefold() in plain for _, name in _named(scheme)))
    scheme = {"head": "Head", **dict(_named(nearest))}
    missing = {joint: scheme[joint] for joint in sorted(NEEDED, key=list(scheme).index) if joint not in bones}
    if not missing:
        return "legs, trunk, arms and head are not connected as in a human skeleton"
    free = {bone: name for bone, name in enumerate(names) if bone not in bones.values()}
    meant = []
    for joint, name in missing.items():
        between = parents[bones[_BELOW[joint]]] if _BELOW.get(joint) in bones else -1
        near = get_close_matches(name, free.values(), 1, 0.5) or [free[bone] for bone in (between,) if bone in free]
        meant += [f'"{near[0]}" may be {name}'] if near else []
    return (
        f"the nearest is {nearest}, of which {', '.join(list(missing.values())[:6])} "
        f"{'is' if len(missing) == 1 else 'are'} missing" + (f" ({', '.join(meant[:6])})" if meant else "")
    )


def _named(scheme: str) -> Iterator[tuple[str, str]]:
    """Joints and their names of both sides in a naming scheme, as (SMPL's name, own name)."""
    sides, names = _NAMES[scheme]
    for joint, name in zip(_JOINTS, names.split(), strict=True):
        for side, word in zip(("left", "right"), sides.split(), strict=True):
            yield joint.format(side), name.format(word)


def _of_vrm(vrm: Mapping[str, int]) -> dict[str, int]:
    centre = {joint: vrm[joint] for joint in _CENTRE if joint in vrm}
    return centre | {joint: vrm[name] for joint, name in _named("VRM") if name in vrm}


def _by_words(names: Sequence[str], parents: Sequence[int]) -> dict[str, int]:
    parts = [_parts(name) for name in names]
    first = [part[0] for part in parts if part]
    common = {word for word in set(first) if len(names) > len(NEEDED) and first.count(word) >= _MOST * len(names)}
    keys_of = [_words([word for word in part if word not in common]) for part in parts]
    read: dict[tuple[str, str], int] = {}
    for bone, key in enumerate(keys_of):
        if key is not None:
            read.setdefault(key, bone)
    bones = {joint: read["", joint] for joint in _CENTRE if ("", joint) in read}
    for joint, keys in _KEYS.items():
        chosen = next((read[key] for key in keys if key in read), None)
        if chosen is not None:
            bones[joint] = chosen
    for side in ("left", "right"):
        # "Shoulder" is the collar bone of some and the upper arm of others, "foot" the ankle's bone or the toes'.
        collar, upper, lower = (bones.get(f"{side}_{joint}") for joint in ("collar", "shoulder", "elbow"))
        if upper is not None and upper == collar:
            way = _ancestry(lower, parents)[1:] if lower is not None else []
            between = way[: way.index(upper)] if upper in way else []
            other = any(keys_of[bone] not in (None, keys_of[upper]) for bone in between)
            bones.pop(f"{side}_shoulder" if other else f"{side}_collar")
        if bones.get(f"{side}_foot") == bones.get(f"{side}_ankle"):
            bones.pop(f"{side}_foot", None)
    return bones


def _parts(name: str) -> list[str]:
    """Words of a bone's name, small, without the namespace that exporters put before it."""
    plain = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", re.split("[:|]", name)[-1])
    plain = re.sub(r"([A-Z])([A-Z][a-z])", r"\1 \2", plain)
    return [word for word in re.split(r"[^a-z]+", plain.lower()) if word]


def _words(parts: Sequence[str]) -> tuple[str, str] | None:
    """Side ("left", "right" or "") and word of a bone's name; None where it is not a bone of a chain."""
    side, words = "", list[str]()
    for word in parts:
        stuck = re.fullmatch(r"(left|right)(\w+)", word)
        if stuck:
            side, word = stuck[1], stuck[2]
        if word in _SIDES:
            side = _SIDES[word]
        elif word in _ASIDE:
            return None
        elif word not in _IDLE or words == ["hip"]:  # the joint of the hip, above the thigh
            words.append(word)
    return side, "".join(words)


def _keys() -> dict[str, list[tuple[str, str]]]:
    """Joint -> what `_words` tells of its names, the surest first: what two joints are called is the least sure."""
    keys: dict[str, list[tuple[str, str]]] = {}
    for scheme in _NAMES:
        for joint, name in _named(scheme):
            key = _words(_parts(name))
            if key is not None and key not in keys.setdefault(joint, []):
                keys[joint].append(key)
    for joint, words in _WORDS.items():
        for side in ("left", "right"):
            keys[f"{side}_{joint}"] += [(side, word) for word in words]
    called = [key for pairs in keys.values() for key in pairs]
    return {joint: sorted(pairs, key=lambda key: called.count(key) > 1) for joint, pairs in keys.items()}


_KEYS = _keys()


def _ancestry(bone: int, parents: Sequence[int]) -> list[int]:
    way = [bone]
    while parents[way[-1]] >= 0:
        way.append(parents[way[-1]])
    return way
