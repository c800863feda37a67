"""A garment of others whose sleeves or legs do not lie around the limbs: put right beforehand, or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.body.joint_names import plain_names
from pb4u.body.limb_bones import limb_bones
from pb4u.collision.crossings import segments_through_faces
from pb4u.errors import InputError, warn
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.repair import push_out


def limbs_outside(vertices: np.ndarray, faces: np.ndarray, body: ShapedBody) -> tuple[str, ...]:
    """Names of the resting body's bones that cross cloth inside the body.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the body that wears it.
    """
    names, segments, _ = limb_bones(body)
    ends = body.skeleton.joints[segments]
    pairs, places = segments_through_faces(ends[:, 0], ends[:, 1], vertices, faces)
    if not len(pairs):
        return ()
    inside = RestBody.of(body).signed_distances(places) < 0.0
    return tuple(dict.fromkeys(names[bone] for bone in pairs[inside, 0].tolist()))


def with_limbs_inside(garment: Garment, body: ShapedBody | AnimatedBody) -> Garment:
    """The garment, pushed out of the body where limbs of the resting body go through it; unchanged where none does.

    Args:
        garment: as worn at rest.
        body: the body that wears it; a body without bones is ignored.

    Raises:
        InputError: a limb still passes through it.

    Warns:
        InputWarning: it was pushed.
    """
    if not isinstance(body, ShapedBody):
        return garment
    limbs = limbs_outside(garment.vertices, garment.faces, body)
    rest = RestBody.of(body)
    if not limbs or not rest.is_closed:
        return garment
    pushed = push_out(garment.vertices, garment.topology, rest)
    if bones := limbs_outside(pushed, garment.faces, body):
        raise InputError(
            f"{garment.name}: through it, not inside it, is {plain_names(bones)} of the body {body.name} at rest; pose "
            "its sleeves and legs around the limbs where it was made, or take the body that it was made for."
        )
    farthest = 100.0 * float(np.linalg.norm(pushed - garment.vertices, axis=1).max())
    warn(f"{garment.name}: {plain_names(limbs)} went through it at rest; it was pushed out, by {farthest:.1f} cm.")
    return replace(garment, vertices=pushed)
