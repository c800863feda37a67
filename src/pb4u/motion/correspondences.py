"""Which bone plays which part: tables between the bone names of files and bodies, and a set of humanoid roles.

Every skeleton is described once, against the roles, instead of once per pair of skeletons. An entry is a bone (or role)
name, or a `Blend` of two where the other skeleton divides the body elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

TORSO_ROLES = ("pelvis", "spine_lower", "spine_middle", "spine_upper", "neck_lower", "neck_upper", "head")
LIMB_ROLES = ("clavicle", "upper_arm", "forearm", "forearm_end", "hand", "thigh", "shin", "foot", "toes")
ROLES = TORSO_ROLES + tuple(f"{role}.{side}" for side in "LR" for role in LIMB_ROLES)
ROLE_INDEX: Mapping[str, int] = {role: i for i, role in enumerate(ROLES)}


@dataclass(frozen=True)
class Blend:
    """A rotation `amount` of the way from one bone's (or role's) to another's."""

    first: str
    second: str
    amount: float = 0.5


Part: TypeAlias = str | Blend


@dataclass(frozen=True, eq=False)
class SourceMap:
    """How the bones of a recorded skeleton play the roles.

    Args:
        family: name of the naming scheme.
        roles: role -> bone, or blend of bones. The head of a limb role's bone marks its joint.
        elbow_flexion: direction in which the left forearm folds, in a T-pose facing +Z.
        same_as: families of bodies that have these very bones and rest pose, which need no retargeting.
    """

    family: str
    roles: Mapping[str, Part]
    elbow_flexion: tuple[float, float, float] = (0.0, 0.0, 1.0)
    same_as: tuple[str, ...] = ()

    @property
    def bones(self) -> frozenset[str]:
        """Every bone that the recording must have."""
        return frozenset(
            bone
            for part in self.roles.values()
            for bone in ((part.first, part.second) if isinstance(part, Blend) else (part,))
        )


@dataclass(frozen=True, eq=False)
class TargetMap:
    """How the roles drive the bones of a body; bones that are not named go rigidly with their parents.

    Args:
        bones: bone -> role, or blend of roles.
        joints: limb role -> bone whose head marks the upper end of that limb segment.
        elbow_flexion: as in `SourceMap`, used where the rest arm is straight.
    """

    bones: Mapping[str, Part]
    joints: Mapping[str, str] = field(default_factory=dict)
    elbow_flexion: tuple[float, float, float] = (0.0, 0.0, 1.0)


def _both_sides(left: str, right: str, **patterns: str) -> dict[str, str]:
    """{role: pattern} -> {role.L: name, role.R: name}; `{}` in a pattern stands for the side."""
    return {
        f"{role}.{side}": pattern.format(word)
        for side, word in (("L", left), ("R", right))
        for role, pattern in patterns.items()
    }


# The humerus and radius of the CMU skeleton turn about axes that stand 30 degrees off the vertical in its T-pose.
_CMU_ELBOW = (0.0, 0.5, 3**0.5 / 2)

CMU = SourceMap(
    "CMU ASF",
    {
        "pelvis": "root", "spine_lower": "lowerback", "spine_middle": "upperback", "spine_upper": "thorax",
        "neck_lower": "lowerneck", "neck_upper": "upperneck", "head": "head",
        **_both_sides(
            "l", "r", clavicle="{}clavicle", upper_arm="{}humerus", forearm="{}radius", forearm_end="{}wrist",
            hand="{}hand", thigh="{}femur", shin="{}tibia", foot="{}foot", toes="{}toes",
        ),
    },
    _CMU_ELBOW,
)  # fmt: skip

CGSPEED = SourceMap(
    "CMU BVH (cgspeed)",
    {
        "pelvis": "Hips", "spine_lower": "LowerBack", "spine_middle": "Spine", "spine_upper": "Spine1",
        "neck_lower": "Neck", "neck_upper": "Neck1", "head": "Head",
        **_both_sides(
            "Left", "Right", clavicle="{}Shoulder", upper_arm="{}Arm", forearm="{}ForeArm", forearm_end="{}ForeArm",
            hand="{}Hand", thigh="{}UpLeg", shin="{}Leg", foot="{}Foot", toes="{}ToeBase",
        ),
    },
    _CMU_ELBOW,
)  # fmt: skip

MOTIONBUILDER = SourceMap(
    "CMU BVH (MotionBuilder)",
    {
        "pelvis": "Hips", "spine_lower": "lowerback", "spine_middle": "Chest", "spine_upper": "Chest2",
        "neck_lower": "lowerneck", "neck_upper": "Neck", "head": "Head",
        **_both_sides(
            "Left", "Right", clavicle="{}Collar", upper_arm="{}Shoulder", forearm="{}Elbow", forearm_end="{}Elbow",
            hand="{}Wrist", thigh="{}Hip", shin="{}Knee", foot="{}Ankle", toes="{}Toe",
        ),
    },
    _CMU_ELBOW,
)  # fmt: skip

POSER = SourceMap(
    "Poser / DAZ BVH",
    {
        "pelvis": "hip", "spine_lower": Blend("hip", "abdomen", 0.67), "spine_middle": "abdomen",
        "spine_upper": "chest", "neck_lower": "neck", "neck_upper": Blend("neck", "head"), "head": "head",
        **_both_sides(
            "l", "r", clavicle="{}Collar", upper_arm="{}Shldr", forearm="{}ForeArm", forearm_end="{}ForeArm",
            hand="{}Hand", thigh="{}Thigh", shin="{}Shin", foot="{}Foot", toes="{}Foot",
        ),
    },
)  # fmt: skip

MIXAMO = SourceMap(
    "Mixamo",
    {
        "pelvis": "Hips", "spine_lower": "Spine", "spine_middle": "Spine1", "spine_upper": "Spine2",
        "neck_lower": "Neck", "neck_upper": Blend("Neck", "Head"), "head": "Head",
        **_both_sides(
            "Left", "Right", clavicle="{}Shoulder", upper_arm="{}Arm", forearm="{}ForeArm", forearm_end="{}ForeArm",
            hand="{}Hand", thigh="{}UpLeg", shin="{}Leg", foot="{}Foot", toes="{}ToeBase",
        ),
    },
)  # fmt: skip

SMPL = SourceMap(
    "SMPL",
    {
        "pelvis": "pelvis", "spine_lower": "spine1", "spine_middle": "spine2", "spine_upper": "spine3",
        "neck_lower": "neck", "neck_upper": Blend("neck", "head"), "head": "head",
        **_both_sides(
            "left", "right", clavicle="{}_collar", upper_arm="{}_shoulder", forearm="{}_elbow",
            forearm_end="{}_elbow", hand="{}_wrist", thigh="{}_hip", shin="{}_knee", foot="{}_ankle", toes="{}_foot",
        ),
    },
    same_as=("smpl", "smplh", "smplx"),
)  # fmt: skip

BVH_SOURCES = (CGSPEED, MIXAMO, MOTIONBUILDER, POSER)


def _anny() -> TargetMap:
    bones: dict[str, Part] = {
        "root": "pelvis", "spine05": "spine_lower", "spine04": Blend("spine_lower", "spine_middle"),
        "spine03": "spine_middle", "spine02": Blend("spine_middle", "spine_upper"), "spine01": "spine_upper",
        "neck01": "neck_lower", "neck02": Blend("neck_lower", "neck_upper"), "neck03": "neck_upper", "head": "head",
    }  # fmt: skip
    joints: dict[str, str] = {}
    for side in "LR":
        limb: dict[str, Part] = {
            "pelvis": "pelvis", "clavicle": f"clavicle.{side}",
            "shoulder01": Blend(f"clavicle.{side}", f"upper_arm.{side}", 0.35),
            "upperarm01": f"upper_arm.{side}", "upperarm02": f"upper_arm.{side}", "lowerarm01": f"forearm.{side}",
            "lowerarm02": Blend(f"forearm.{side}", f"forearm_end.{side}"), "wrist": f"hand.{side}",
            "upperleg01": f"thigh.{side}", "upperleg02": f"thigh.{side}", "lowerleg01": f"shin.{side}",
            "lowerleg02": f"shin.{side}", "foot": f"foot.{side}",
            **{f"toe{k}-1": f"toes.{side}" for k in range(1, 6)},
        }  # fmt: skip
        bones |= {f"{name}.{side}": part for name, part in limb.items()}
        ends = {
            "clavicle": "clavicle", "upper_arm": "upperarm01", "forearm": "lowerarm01", "hand": "wrist",
            "thigh": "upperleg01", "shin": "lowerleg01", "foot": "foot", "toes": "toe2-1",
        }  # fmt: skip
        joints |= {f"{role}.{side}": f"{bone}.{side}" for role, bone in ends.items()}
    return TargetMap(bones, joints)


def _smpl() -> TargetMap:
    bones: dict[str, Part] = {
        "pelvis": "pelvis", "spine1": "spine_lower", "spine2": "spine_middle", "spine3": "spine_upper",
        "neck": Blend("neck_lower", "neck_upper"), "head": "head",
    }  # fmt: skip
    joints: dict[str, str] = {}
    for side, word in (("L", "left"), ("R", "right")):
        limb = {
            "clavicle": "collar", "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist",
            "thigh": "hip", "shin": "knee", "foot": "ankle", "toes": "foot",
        }  # fmt: skip
        bones |= {f"{word}_{bone}": f"{role}.{side}" for role, bone in limb.items()}
        joints |= {f"{role}.{side}": f"{word}_{bone}" for role, bone in limb.items()}
    return TargetMap(bones, joints)


TARGETS: Mapping[str, TargetMap] = {"anny": _anny(), "smpl": _smpl(), "smplh": _smpl(), "smplx": _smpl()}
