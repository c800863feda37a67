"""One motion in BVH files whose joints lie in the same places in every frame, and that differ in their rest poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
from scipy.spatial.transform import Rotation
from tests.motion.recordings import BVH_NAMES, BVH_OFFSETS

PARENTS: Mapping[str, str] = BVH_NAMES["mixamo"]
OFFSETS: Mapping[str, np.ndarray] = {
    name: np.array(BVH_OFFSETS[name.removeprefix("Left").removeprefix("Right")], dtype=np.float64)
    * ([-1, 1, 1] if name.startswith("Right") else [1, 1, 1])
    for name in PARENTS
}
_ALONG = {name: next((child for child, parent in PARENTS.items() if parent == name), name) for name in PARENTS}
_ALONG |= {"Hips": "Spine", "Spine2": "Neck"}


def below(*tops: str) -> set[str]:
    """Some joints and all that hang on them."""
    found: set[str] = set(tops)
    for name, parent in PARENTS.items():
        if parent in found:
            found.add(name)
    return found


def _turned(degrees: float, axis: str = "x", *tops: str) -> dict[str, Rotation]:
    turn = Rotation.from_euler(axis, degrees, degrees=True)
    return dict.fromkeys(below(*tops) if tops else PARENTS, turn)


def _along_own_axis(axis: int, roll: float = 0.0) -> dict[str, Rotation]:
    """Axes of each bone in a T-pose of which one points along it."""
    own = {}
    for k, name in enumerate(PARENTS):
        along = OFFSETS[_ALONG[name]]
        aligned, _ = Rotation.align_vectors([along / np.linalg.norm(along)], [np.eye(3)[axis]])
        own[name] = aligned * Rotation.from_rotvec(roll * k * np.eye(3)[axis])
    return own


def _random() -> dict[str, Rotation]:
    rng = np.random.default_rng(7)
    return {name: Rotation.from_quat(rng.normal(size=4)) for name in PARENTS}


LEGS, ARMS = ("LeftUpLeg", "RightUpLeg"), ("LeftArm", "RightArm")
RESTS: Mapping[str, Mapping[str, Rotation]] = {
    "on the back": _turned(90.0),
    "on the front": _turned(-90.0),
    "on the side": _turned(90.0, "z"),
    "head down": _turned(180.0),
    "turned away": _turned(45.0, "y"),
    "legs reversed": _turned(180.0, "x", *LEGS),
    "legs reversed sideways": _turned(180.0, "z", *LEGS),
    "legs forward": _turned(90.0, "x", *LEGS),
    "seated": _turned(90.0, "x", *LEGS) | _turned(0.0, "x", "LeftLeg", "RightLeg"),
    "torso bent": _turned(-90.0, "x", "Spine"),
    "torso bent, arms not": _turned(-90.0, "x", "Spine") | _turned(0.0, "x", *ARMS),
    "arms down": _turned(90.0, "z", "LeftArm") | _turned(-90.0, "z", "RightArm"),
    "arms forward": _turned(90.0, "y", "LeftArm") | _turned(-90.0, "y", "RightArm"),
    "bones along X": _along_own_axis(0),
    "bones along Y": _along_own_axis(1),
    "bones along X, rolled": _along_own_axis(0, 1.1),
    "any axes": _random(),
}
"""Rest pose -> axes that joints have in a T-pose in its file; those left out are the world's."""


def walking(time: float) -> dict[str, Rotation]:
    """Rotations of joints from their parents in a T-pose: a walk with hanging arms that fold, and a head that turns."""

    def turned(**degrees: float) -> Rotation:
        return Rotation.from_euler("".join(degrees), list(degrees.values()), degrees=True)

    swing = 25.0 * np.sin(2 * np.pi * time)
    return {
        "LeftArm": turned(z=-70.0, x=-0.4 * swing), "RightArm": turned(z=70.0, x=0.4 * swing),
        "LeftForeArm": turned(y=-max(swing, 5.0)), "RightForeArm": turned(y=max(-swing, 5.0)),
        "LeftUpLeg": turned(x=-swing), "RightUpLeg": turned(x=swing),
        "LeftLeg": turned(x=max(1.2 * swing, 0.0)), "RightLeg": turned(x=max(-1.2 * swing, 0.0)),
        "Head": turned(y=0.6 * swing), "Hips": turned(y=0.1 * swing),
    }  # fmt: skip


def write_rested(
    path: Path,
    own: Mapping[str, Rotation],
    motion: Callable[[float], Mapping[str, Rotation]] = walking,
    named: Callable[[str], str] = str,
    frames: int = 30,
    offsets: Mapping[str, np.ndarray] = OFFSETS,
    parents: Mapping[str, str] = PARENTS,
    places: Callable[[int], Sequence[float]] = lambda frame: (0.0, 100.0, 2.0 * frame),
) -> Path:
    """A .bvh of a motion.

    Args:
        path: where it is written.
        own: axes that joints have in a T-pose, so that the rest pose is none.
        motion: rotations of joints from their parents in a T-pose at a time [s].
        named: what a joint is called.
        frames: number of frames.
        offsets: of the joints in a T-pose.
        parents: joint -> the one that it hangs on, "" for the root, which comes first.
        places: where the root is in a frame.
    """
    axes = {name: own.get(name, Rotation.identity()) for name in parents}
    order: list[str] = []

    def block(name: str, depth: int) -> list[str]:
        order.append(name)
        parent, pad = parents[name], "\t" * depth
        offset = axes[parent].inv().apply(offsets[name]) if parent else offsets[name]
        kind = "6 Xposition Yposition Zposition" if not parent else "3"
        lines = [f"{pad}{'JOINT' if parent else 'ROOT'} {named(name)}", pad + "{"]
        lines += [f"{pad}\tOFFSET {offset[0]:.6f} {offset[1]:.6f} {offset[2]:.6f}"]
        lines += [f"{pad}\tCHANNELS {kind} Zrotation Yrotation Xrotation"]
        children = [child for child, above in parents.items() if above == name]
        for child in children:
            lines += block(child, depth + 1)
        if not children:
            lines += [f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\tOFFSET 0 0 5", pad + "\t}"]
        return [*lines, pad + "}"]

    text = ["HIERARCHY", *block(next(iter(parents)), 0), "MOTION", f"Frames: {frames}", "Frame Time: 0.0333333"]
    for frame in range(frames):
        local = motion(frame / 30.0)
        world: dict[str, Rotation] = {}
        row = list(places(frame))
        for name in order:
            parent = parents[name]
            turn = local.get(name, Rotation.identity())
            world[name] = world[parent] * turn if parent else turn
            above = world[parent] * axes[parent] if parent else Rotation.identity()
            with catch_warnings():
                simplefilter("ignore")  # at a gimbal lock some of the angles will do
                row += (above.inv() * world[name] * axes[name]).as_euler("ZYX", degrees=True).tolist()
        text.append(" ".join(f"{number:.6f}" for number in row))
    path.write_text("\n".join(text) + "\n")
    return path
