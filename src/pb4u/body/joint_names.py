"""Bones at the joints of a human body, in the names of Anny and of the SMPL family."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

SIDES: Mapping[str, tuple[str, str]] = {"anny": ("L", "R"), "smpl": ("left", "right")}
"""Words of the left and of the right side in the names of bones."""

NECK_BONES: Mapping[str, Mapping[str, str]] = {
    "anny": {"neck": "neck01", "head": "neck02"},
    "smpl": {"neck": "neck", "head": "head"},
}
"""Bones at whose heads the neck begins, and the skin that moves with the head."""

LIMB_BONES: Mapping[str, Mapping[str, str]] = {
    "anny": {
        "clavicle": "clavicle.{}", "upper_arm": "upperarm01.{}", "forearm": "lowerarm01.{}", "hand": "wrist.{}",
        "thigh": "upperleg01.{}", "shin": "lowerleg01.{}", "foot": "foot.{}", "toes": "toe2-1.{}",
    },
    "smpl": {
        "clavicle": "{}_collar", "upper_arm": "{}_shoulder", "forearm": "{}_elbow", "hand": "{}_wrist",
        "thigh": "{}_hip", "shin": "{}_knee", "foot": "{}_ankle", "toes": "{}_foot",
    },
}  # fmt: skip
"""Bone whose head marks the upper end of each segment of a limb; {} stands for the side."""

ARM = re.compile("arm|elbow|wrist|(left|right)_shoulder")
"""In the names of an arm's bones, those between its joints too; Anny's shoulders are not swung out."""

_PLAIN = {
    "clavicle": "shoulder", "shoulder": "shoulder", "upperarm": "upper arm", "lowerarm": "forearm", "wrist": "wrist",
    "metacarpal": "hand", "finger": "hand", "pelvis": "hip", "upperleg": "thigh", "lowerleg": "shin", "foot": "foot",
    "toe": "toes", "toes": "toes", "spine": "trunk", "neck": "neck", "head": "head", "root": "trunk",
}  # fmt: skip
# SMPL names a bone by the joint that it begins at.
_PLAIN_SMPL = {
    "collar": "shoulder", "shoulder": "upper arm", "elbow": "forearm", "hip": "thigh", "knee": "shin", "ankle": "foot",
    "foot": "toes", "index": "hand", "middle": "hand", "pinky": "hand", "ring": "hand", "thumb": "hand",
}  # fmt: skip


def plain_name(bone: str) -> str:
    """Plain name of a bone, such as "left thigh"; its own name if it is unknown.

    Args:
        bone: its name in Anny or in the SMPL family.
    """
    match = re.fullmatch(r"(?:(left|right)_)?([a-z]+)[\d-]*(?:\.([LR]))?", bone)
    if match is None:
        return bone
    words = {**_PLAIN, **_PLAIN_SMPL} if match[1] else _PLAIN
    side = match[1] or {"L": "left", "R": "right", None: ""}[match[3]]
    return f"{side} {words[match[2]]}".strip() if match[2] in words else bone


def plain_names(bones: Iterable[str], most: int = 4) -> str:
    """Bones in plain words, each once, such as "the left thigh and the left shin".

    Args:
        bones: their names.
        most: largest number of names; beyond it only their number is given.
    """
    parts = [f"the {name}" for name in dict.fromkeys(map(plain_name, bones))]
    if len(parts) > most:
        parts[most:] = [f"{len(parts) - most} more"]
    return " and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]]))
