"""A model file in the layout of SMPL, made of the built-in woman (CC0) in SMPL's rest pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.bone_names import smpl_names
from pb4u.body.library import load_body
from pb4u.body.skeleton import joint_positions
from pb4u.motion.library import load_motion
from pb4u.motion.smpl_recording import nominal_skeleton

_NEAR = 60
"""Vertices that a joint is a sum of."""


def write_smpl_woman(path: Path) -> Path:
    """The woman in a T-pose with SMPL's 24 joints, one direction of shape, and none that follow the pose.

    Args:
        path: the .npz; a recording is written beside it, from which the T-pose is taken.
    """
    woman, smpl = load_body("woman"), nominal_skeleton("smpl")
    assert isinstance(woman, ShapedBody)
    rest = path.with_suffix(".rest.npz")
    upright = np.zeros((2, 156))
    upright[:, 0] = np.pi / 2  # recordings of AMASS have Z up
    np.savez(rest, poses=upright, trans=np.zeros((2, 3)), mocap_framerate=30.0)
    poses = load_motion(rest, arms_away_degrees=0.0).poses(woman, 30.0, 1)
    rest.unlink()
    vertices = woman.posed(poses).positions(0, 1)[0].numpy().astype(np.float64)
    places = joint_positions(woman.skeleton, poses)[0]
    known = smpl_names(list(woman.skeleton.names), woman.skeleton.parents.tolist()) or {}
    joint_of: list[int] = []  # of each bone of the woman
    for bone, parent in enumerate(woman.skeleton.parents.tolist()):
        joint_of.append(smpl.index(known[bone]) if bone in known else joint_of[parent])
    regressor = np.zeros((smpl.bone_count, len(vertices)))
    for joint, name in enumerate(smpl.names):
        owner = name.replace("hand", "wrist")  # hands, which the woman's bones do not name, lie in the wrists
        place = places[next(bone for bone, named in known.items() if named == owner)]
        near = np.argsort(np.linalg.norm(vertices - place, axis=1))[:_NEAR]
        sums = np.vstack([vertices[near].T, np.ones(_NEAR)])
        regressor[joint, near] = np.linalg.lstsq(sums, np.append(place, 1.0), rcond=None)[0]
    weights = np.zeros((len(vertices), smpl.bone_count))
    joints = np.array(joint_of)[woman.weights.bones]
    np.add.at(weights, (np.arange(len(vertices))[:, None], joints), woman.weights.weights)
    np.savez_compressed(
        path,
        v_template=vertices,
        shapedirs=0.02 * vertices[..., None],  # beta0 makes it taller
        posedirs=np.zeros((len(vertices), 3, 9 * (smpl.bone_count - 1)), dtype=np.float32),
        J_regressor=regressor,
        kintree_table=np.stack([smpl.parents, np.arange(smpl.bone_count)]),
        weights=weights,
        f=woman.faces,
    )
    return path
