"""Bodies and hand-made recordings for the tests of motions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.body.skinning import SkinningWeights
from pb4u.motion.smpl_recording import nominal_skeleton

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


@pytest.fixture(scope="session")
def woman() -> ShapedBody:
    return load_body("woman")


@pytest.fixture(scope="session")
def man() -> ShapedBody:
    return load_body("man")


@pytest.fixture(scope="session")
def smpl_body() -> Callable[[str], ShapedBody]:
    """Bodies with the joints of the SMPL family and one small tetrahedron of skin on each of them."""

    def make(family: str) -> ShapedBody:
        skeleton = nominal_skeleton(family)
        corners = 0.03 * np.array([[1.0, -1, 1], [-1, -1, 1], [0, -1, -1], [0, 1, 0]])
        vertices = (skeleton.joints[:, None] + corners).reshape(-1, 3)
        lift = np.array([0.0, -vertices[:, 1].min(), 0.0])
        owner = np.repeat(np.arange(skeleton.bone_count), 4)
        faces = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
        return ShapedBody(
            name=family,
            family=family,
            vertices=vertices + lift,
            faces=(faces + 4 * np.arange(skeleton.bone_count)[:, None, None]).reshape(-1, 3),
            skeleton=type(skeleton)(skeleton.names, skeleton.parents, skeleton.joints + lift),
            weights=SkinningWeights(owner[:, None], np.ones((len(owner), 1), dtype=np.float32)),
            contact=np.ones(len(vertices), dtype=bool),
        )

    return make


@pytest.fixture
def acclaim(tmp_path: Path) -> Callable[..., Path]:
    """Writes 07.asf with the bones of the CMU database and 07_01.amc with `frames` frames; returns the latter.

    `pose` gives angles [deg] of some bones in every frame.
    """

    def write(frames: int = 4, pose: dict[str, list[float]] | None = None) -> Path:
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
        (tmp_path / "07.asf").write_text("\n".join(lines))
        motion = ["#!OML", ":FULLY-SPECIFIED", ":DEGREES"]
        for frame in range(frames):
            motion += [str(frame + 1), f"root 0 10 {0.1 * frame} 0 0 0"]
            for name, (_, _, dof) in tree.items():
                if dof:
                    angles = (pose or {}).get(name, [0.0] * len(dof.split()))
                    motion.append(f"{name} {' '.join(map(str, angles))}")
        (tmp_path / "07_01.amc").write_text("\n".join(motion))
        return tmp_path / "07_01.amc"

    return write


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
_BVH_OFFSETS = {
    "Hips": (0, 100, 0), "Spine": (0, 10, 0), "Spine1": (0, 12, 0), "Spine2": (0, 12, 0), "Neck": (0, 18, 0),
    "Head": (0, 10, 3), "UpLeg": (9, -5, 0), "Leg": (0, -43, 0), "Foot": (0, -42, 0), "ToeBase": (0, -8, 14),
    "Shoulder": (6, 12, 0), "Arm": (12, 0, 0), "ForeArm": (27, 0, 0), "Hand": (25, 0, 0),
}  # fmt: skip


@pytest.fixture
def bvh(tmp_path: Path) -> Callable[..., Path]:
    """Writes a .bvh of a Mixamo skeleton and returns its path.

    Args of the callable: frames; channel order of all joints; angles [deg] by joint and axis, in every frame; prefix
    of the joint names; renamed joints; header values.
    """

    def write(
        frames: int = 4,
        order: str = "ZXY",
        angles: dict[str, dict[str, float]] | None = None,
        prefix: str = "mixamorig:",
        renamed: dict[str, str] | None = None,
        frame_time: str = "0.0333333",
        count: int | None = None,
        value: str = "",
    ) -> Path:
        tree = BVH_NAMES["mixamo"]
        order_of: list[str] = []

        def block(name: str, depth: int) -> list[str]:
            order_of.append(name)
            part = name.removeprefix("Left").removeprefix("Right")
            offset = np.array(_BVH_OFFSETS[part]) * ([-1, 1, 1] if name.startswith("Right") else [1, 1, 1])
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
        path = tmp_path / "clip.bvh"
        path.write_text("\n".join(text) + "\n")
        return path

    return write
