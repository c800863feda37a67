"""Hand-made recordings in the formats of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

_CMU_TREE = {
    "lhipjoint": ("root", (0.8, -0.6, 0.0), ""), "lfemur": ("lhipjoint", (0.342, -0.94, 0.0), "rx ry rz"),
    "ltibia": ("lfemur", (0.342, -0.94, 0.0), "rx"), "lfoot": ("ltibia", (0.08, -0.22, 0.97), "rx rz"),
    "ltoes": ("lfoot", (0.0, 0.0, 1.0), "rx"), "lowerback": ("root", (0.0, 1.0, 0.0), "rx ry rz"),
    "upperback": ("lowerback", (0.0, 1.0, 0.0), "rx ry rz"), "thorax": ("upperback", (0.0, 1.0, 0.0), "rx ry rz"),
    "lowerneck": ("thorax", (0.0, 1.0, 0.0), "rx ry rz"), "upperneck": ("lowerneck", (0.0, 1.0, 0.0), "rx ry rz"),
    "head": ("upperneck", (0.0, 1.0, 0.0), "rx ry rz"), "lclavicle": ("thorax", (0.97, 0.25, 0.0), "ry rz"),
    "lhumerus": ("lclavicle", (1.0, 0.0, 0.0), "rx ry rz"), "lradius": ("lhumerus", (1.0, 0.0, 0.0), "rx"),
    "lwrist": ("lradius", (1.0, 0.0, 0.0), "ry"), "lhand": ("lwrist", (1.0, 0.0, 0.0), "rx rz"),
}  # fmt: skip
_CMU_AXES = {"lfemur": "0 0 20", "ltibia": "0 0 20", "lhumerus": "180 -30 -90", "lradius": "180 -30 -90"}


def write_acclaim(folder: Path, frames: int = 4, pose: dict[str, list[float]] | None = None) -> Path:
    """07.asf with the bones of the CMU database and 07_01.amc, whose path is given.

    Args:
        folder: where they are written.
        frames: number of frames.
        pose: angles [deg] of some bones in every frame.
    """
    mirror = str.maketrans("l", "r")
    tree = dict(_CMU_TREE)
    for name, (parent, (x, y, z), dof) in _CMU_TREE.items():
        if name.startswith("l") and name not in ("lowerback", "lowerneck"):
            paired = parent[0].translate(mirror) + parent[1:] if parent not in ("root", "thorax") else parent
            tree["r" + name[1:]] = (paired, (-x, y, z), dof)
    lines = [":units", "  length 0.45", "  angle deg", ":root", "  order TX TY TZ RX RY RZ", "  axis XYZ"]
    lines += ["  position 0 0 0", "  orientation 0 0 0", ":bonedata"]
    for name, (_, direction, dof) in tree.items():
        axis = _CMU_AXES.get(name, _mirrored_axis(_CMU_AXES.get("l" + name[1:], "0 0 0")))
        lines += ["  begin", f"    name {name}", f"    direction {' '.join(map(str, direction))}"]
        lines += ["    length 4", f"    axis {axis} XYZ", *([f"    dof {dof}"] if dof else []), "  end"]
    children: dict[str, list[str]] = {}
    for name, (parent, _, _) in tree.items():
        children.setdefault(parent, []).append(name)
    lines += [":hierarchy", "  begin", *(f"    {p} {' '.join(c)}" for p, c in children.items()), "  end"]
    (folder / "07.asf").write_text("\n".join(lines))
    motion = ["#!OML", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(frames):
        motion += [str(frame + 1), f"root 0 10 {0.1 * frame} 0 0 0"]
        for name, (_, _, dof) in tree.items():
            if dof:
                angles = (pose or {}).get(name, [0.0] * len(dof.split()))
                motion.append(f"{name} {' '.join(map(str, angles))}")
    (folder / "07_01.amc").write_text("\n".join(motion))
    return folder / "07_01.amc"


def _mirrored_axis(axis: str) -> str:
    x, y, z = (float(angle) for angle in axis.split())
    return f"{x} {-y} {-z}"


BVH_NAMES = {
    "mixamo": {
        "Hips": "", "Spine": "Hips", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Spine2", "Head": "Neck",
        **{
            f"{side}{name}": (parent if parent in ("Hips", "Spine2") else f"{side}{parent}")
            for side in ("Left", "Right")
            for name, parent in {
                "UpLeg": "Hips", "Leg": "UpLeg", "Foot": "Leg", "ToeBase": "Foot", "Shoulder": "Spine2",
                "Arm": "Shoulder", "ForeArm": "Arm", "Hand": "ForeArm",
            }.items()
        },
    }
}  # fmt: skip
BVH_OFFSETS = {
    "Hips": (0, 100, 0), "Spine": (0, 10, 0), "Spine1": (0, 12, 0), "Spine2": (0, 12, 0), "Neck": (0, 18, 0),
    "Head": (0, 10, 3), "UpLeg": (9, -5, 0), "Leg": (0, -43, 0), "Foot": (0, -42, 0), "ToeBase": (0, -8, 14),
    "Shoulder": (6, 12, 0), "Arm": (12, 0, 0), "ForeArm": (27, 0, 0), "Hand": (25, 0, 0),
}  # fmt: skip


def write_bvh(
    folder: Path,
    frames: int = 4,
    order: str = "ZXY",
    angles: dict[str, dict[str, float]] | None = None,
    prefix: str = "mixamorig:",
    renamed: dict[str, str] | None = None,
    frame_time: str = "0.0333333",
    count: int | None = None,
    value: str = "",
) -> Path:
    """A .bvh of a Mixamo skeleton, whose path is given.

    Args:
        folder: where it is written.
        frames: number of frames.
        order: channel order of all joints.
        angles: [deg] by joint and axis, in every frame.
        prefix: of the joint names.
        renamed: joints called otherwise.
        frame_time: as the header tells it [s].
        count: frames that the header tells; as many as there are by default.
        value: in place of a number of the last frame.
    """
    tree = BVH_NAMES["mixamo"]
    order_of: list[str] = []

    def block(name: str, depth: int) -> list[str]:
        order_of.append(name)
        part = name.removeprefix("Left").removeprefix("Right")
        offset = np.array(BVH_OFFSETS[part]) * ([-1, 1, 1] if name.startswith("Right") else [1, 1, 1])
        pad = "  " * depth
        shown = prefix + (renamed or {}).get(name, name)
        channels = [f"{axis}rotation" for axis in order]
        if not tree[name]:
            channels = ["Xposition", "Yposition", "Zposition", *channels]
        lines = [f"{pad}{'JOINT' if tree[name] else 'ROOT'} {shown}", pad + "{"]
        lines += [
            f"{pad}  OFFSET {' '.join(map(str, offset))}",
            f"{pad}  CHANNELS {len(channels)} {' '.join(channels)}",
        ]
        children = [child for child, parent in tree.items() if parent == name]
        for child in children:
            lines += block(child, depth + 1)
        if not children:
            lines += [f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET 0 1 0", pad + "  }"]
        return [*lines, pad + "}"]

    text = ["HIERARCHY", *block("Hips", 0), "MOTION", f"Frames: {frames if count is None else count}"]
    text.append(f"Frame Time: {frame_time}")
    for frame in range(frames):
        row = [0.0, 100.0, 2.0 * frame]
        for name in order_of:
            row += [(angles or {}).get(name, {}).get(axis, 0.0) for axis in order]
        words = [f"{number:.6f}" for number in row]
        if value and frame == frames - 1:
            words[7] = value
        text.append(" ".join(words))
    path = folder / "clip.bvh"
    path.write_text("\n".join(text) + "\n")
    return path
