"""Bones at the joints of a human body, in the names of Anny and of the SMPL family."""

from __future__ import annotations

import re
from collections.abc import Mapping

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
