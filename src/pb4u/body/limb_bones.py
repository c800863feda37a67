"""The bones of a body that cloth has to stay around."""

from __future__ import annotations

import re

import numpy as np

from pb4u.body.body_model import ShapedBody

_TOES = re.compile(r"^toe[\d-]+")


def limb_bones(body: ShapedBody) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Bones whose skin mostly takes part in contact; hands or fingers left out of contact are not among them.

    The toes of a foot have one name.

    Args:
        body: the body.

    Returns:
        Names of the bones, the two joints (bones, 2) int64 of each, and the bone (body vertices,) int64 that moves each
        vertex of the skin most, -1 if it is another bone.
    """
    skeleton, weights = body.skeleton, body.weights
    nearest = weights.bones[np.arange(len(weights.bones)), weights.weights.argmax(axis=1)]
    skin = np.bincount(nearest, minlength=skeleton.bone_count)
    touched = np.bincount(nearest, body.contact, skeleton.bone_count)
    segments = [
        (parent, bone)
        for bone, parent in enumerate(skeleton.parents.tolist())
        if parent >= 0 and skin[parent] and 2 * touched[parent] > skin[parent]
    ]
    parents = [parent for parent, _ in segments]
    # A joint with several children is the head of several bones: its skin counts as that of the first.
    first = np.array([parents.index(bone) if bone in parents else -1 for bone in range(skeleton.bone_count)])
    names = [_TOES.sub("toes", skeleton.names[parent]) for parent in parents]
    return names, np.array(segments, dtype=np.int64).reshape(-1, 2), first[nearest]
