"""From the bind pose of a character into the first frame of its clip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pb4u.body.character import Character, PosedCharacter
from pb4u.body.node_animation import NodePoses, parted
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_xyzw, slerp, to_xyzw
from pb4u.motion.curves import ease
from pb4u.motion.lead_in import run_up


def character_lead_in(character: Character, poses: NodePoses, fps: float, frames: int) -> NodePoses:
    """Poses with more frames before them, that lead from the bind pose to the first one.

    As `lead_in` does it for bodies: the bind pose has the position and heading of the first frame, bones are
    interpolated by slerp, and the whole body is shifted vertically so that its lowest point is at the right height.

    Args:
        character: the character that performs them.
        poses: of its clip.
        fps: frames per second.
        frames: how many frames lead in.

    Raises:
        InputError: a node of uneven scale shears its bones there.
    """
    if frames == 0:
        return poses
    first = _frame(poses, 0)
    rest = _standing(character, first)
    progress = np.arange(frames) / frames
    along = ease(progress)
    # The clip continued backwards with its first velocity, which soon fades out.
    elapsed = run_up((progress - 1.0) * frames / fps) * fps
    following = _frame(poses, min(1, len(poses) - 1))

    def towards(name: str) -> np.ndarray:
        start, end, after = (getattr(poses_at, name)[0] for poses_at in (rest, first, following))
        share = along.reshape(-1, *([1] * end.ndim))
        end = end + elapsed.reshape(share.shape) * (after - end)
        return np.asarray(start + share * (end - start))

    nodes = first.rotations.shape[1]
    target = _turned_on(first.rotations[0], following.rotations[0], elapsed)
    rotations = slerp(np.broadcast_to(rest.rotations, target.shape), target, np.repeat(along[:, None], nodes, axis=1))
    weights = {n: rest.weights[n] + along[:, None] * (w - rest.weights[n]) for n, w in first.weights.items()}
    blended = NodePoses(towards("translations"), rotations, towards("scales"), weights, poses.rise)
    lowest = [PosedCharacter(character, part, fps).positions(0, len(part))[..., 1].amin(dim=1).numpy() for part in
              (rest, first, blended)]  # fmt: skip
    height = lowest[0][0] + along * (lowest[1][0] - lowest[0][0])
    return _raised(character, blended, height - lowest[2]).joined(poses)


def _frame(poses: NodePoses, frame: int) -> NodePoses:
    at = slice(frame, frame + 1)
    weights = {node: values[at] for node, values in poses.weights.items()}
    return replace(
        poses,
        translations=poses.translations[at],
        rotations=poses.rotations[at],
        scales=poses.scales[at],
        weights=weights,
    )


def _turned_on(first: np.ndarray, second: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
    """Rotations (times, nodes, 4) `elapsed` (times,) frames after the first of two consecutive ones (nodes, 4)."""
    before = Rotation.from_quat(to_xyzw(first))
    step = (Rotation.from_quat(to_xyzw(second)) * before.inv()).as_rotvec()
    turned = [from_xyzw((Rotation.from_rotvec(time * step) * before).as_quat()) for time in elapsed]
    return np.array(turned)


def _standing(character: Character, first: NodePoses) -> NodePoses:
    """The bind pose, where and as the first frame stands and faces; nodes that are no bones are as in that frame."""
    rig = character.rig
    tree = rig.tree
    binds: dict[int, np.ndarray] = {}
    for node, bind in zip(rig.bone_nodes.tolist(), rig.binds, strict=True):
        binds.setdefault(node, bind)
    now = tree.globals(first)[0]
    root = int(rig.bone_nodes[0])
    transform = now[root] @ np.linalg.inv(binds[root])
    front = transform[:3, :3] @ np.array([0.0, 0.0, 1.0])
    yaw = np.arctan2(front[0], front[2]) if np.hypot(front[0], front[2]) > 0.2 * np.linalg.norm(front) else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    place = np.eye(4)
    place[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
    place[:3, 3] = (now[root] - place @ binds[root])[:3, 3] * np.array([1.0, 0.0, 1.0])
    translations, rotations, scales = (np.array(getattr(first, n)) for n in ("translations", "rotations", "scales"))
    world = tree.world.copy()
    world[1, 3] += first.rise
    stands: dict[int, np.ndarray] = {}
    for node in tree.order:
        parent = int(tree.parents[node])
        above = world if parent < 0 else stands[parent]
        if node in binds:
            local = np.linalg.inv(above) @ place @ binds[node]
            try:
                translations[0, node], rotations[0, node], scales[0, node] = parted(local)
            except ValueError as error:
                raise InputError(
                    f"{character.name}: in its bind pose {error}, as under a parent of uneven scale; apply the scales "
                    "of its nodes in the program it comes from, or skip the lead-in with --lead-in 0."
                ) from error
            stands[node] = place @ binds[node]
        else:
            stands[node] = above @ first.matrices(node)[0]
    still = {node: np.array(rig.tree.poses.weights[node]) for node in first.weights}
    return NodePoses(translations, rotations, scales, still, first.rise)


def _raised(character: Character, poses: NodePoses, heights: np.ndarray) -> NodePoses:
    """The poses with the whole raised by `heights` (frames,) [m]."""
    tree = character.rig.tree
    translations = poses.translations.copy()
    for node in np.flatnonzero(tree.parents < 0):
        translations[:, node] += heights[:, None] * np.linalg.inv(tree.world[:3, :3])[:, 1]
    return replace(poses, translations=translations)
