"""Which bone plays which part: tables between the bone names of files and bodies, and a set of humanoid roles.

Every skeleton is described once, against the roles, instead of once per pair of skeletons. An entry is a bone (or role)
name, or a `Blend` of two where the other skeleton divides the body elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from pb4u.body.joint_names import LIMB_BONES, SIDES

TORSO_ROLES = ("pelvis", "spine_lower", "spine_middle", "spine_upper", "neck_lower", "neck_upper", "head")
LIMB_ROLES = ("clavicle", "upper_arm", "forearm", "forearm_end", "hand", "thigh", "shin", "foot", "toes")
ROLES = TORSO_ROLES + tuple(f"{role}.{side}" for side in "LR" for role in LIMB_ROLES)
ROLE_INDEX: Mapping[str, int] = {role: i for i, role in enumerate(ROLES)}
FORWARD = (0.0, 0.0, 1.0)
"""Direction in which a straight forearm folds in a T-pose facing +Z."""


@dataclass(frozen=True)
class Blend:
    """A rotation part of the way from one bone's (or role's) to another's.

    Args:
        first: bone or role at which the way begins.
        second: bone or role at which it ends.
        amount: share of the way, 0 to 1.
    """

    first: str
    second: str
    amount: float = 0.5


Part: TypeAlias = str | Blend


@dataclass(frozen=True, eq=False)
class SkeletonRoles:
    """Bone names of a recorded skeleton by role.

    Args:
        family: name of the naming scheme.
        roles: role -> bone, or blend of bones. The head of a limb role's bone marks its joint.
        elbow_flexion: direction in which the left forearm folds, in a T-pose facing +Z.
        same_as: families of bodies that have these very bones and rest pose, which need no retargeting.
    """

    family: str
    roles: Mapping[str, Part]
    elbow_flexion: tuple[float, float, float] = FORWARD
    same_as: tuple[str, ...] = ()

    @property
    def bones(self) -> frozenset[str]:
        """Names of the bones that the recording must have."""
        return frozenset(
            bone
            for part in self.roles.values()
            for bone in ((part.first, part.second) if isinstance(part, Blend) else (part,))
        )


@dataclass(frozen=True, eq=False)
class TargetMap:
    """Roles that drive the bones of a body; bones that are not named go rigidly with their parents.

    Args:
        bones: bone -> role, or blend of roles.
        joints: limb role -> bone whose head marks the upper end of that limb segment.
        partial: whether a skeleton may lack bones that mark no joint.
    """

    bones: Mapping[str, Part]
    joints: Mapping[str, str] = field(default_factory=dict)
    partial: bool = False


# Role -> bone, or blend of bones, in the columns' skeletons. Of a limb role `{}` stands for the side.
_COLUMNS = ("CMU ASF", "CMU BVH (cgspeed)", "CMU BVH (MotionBuilder)", "Poser / DAZ BVH", "Mixamo", "SMPL")
_SIDE_WORDS = (("l", "r"), ("Left", "Right"), ("Left", "Right"), ("l", "r"), ("Left", "Right"), ("left", "right"))
_PARTS: Mapping[str, tuple[Part, ...]] = {
    "pelvis": ("root", "Hips", "Hips", "hip", "Hips", "pelvis"),
    "spine_lower": ("lowerback", "LowerBack", "lowerback", Blend("hip", "abdomen", 0.67), "Spine", "spine1"),
    "spine_middle": ("upperback", "Spine", "Chest", "abdomen", "Spine1", "spine2"),
    "spine_upper": ("thorax", "Spine1", "Chest2", "chest", "Spine2", "spine3"),
    "neck_lower": ("lowerneck", "Neck", "lowerneck", "neck", "Neck", "neck"),
    "neck_upper": (
        "upperneck", "Neck1", "Neck", Blend("neck", "head"), Blend("Neck", "Head"), Blend("neck", "head"),
    ),
    "head": ("head", "Head", "Head", "head", "Head", "head"),
    "clavicle": ("{}clavicle", "{}Shoulder", "{}Collar", "{}Collar", "{}Shoulder", "{}_collar"),
    "upper_arm": ("{}humerus", "{}Arm", "{}Shoulder", "{}Shldr", "{}Arm", "{}_shoulder"),
    "forearm": ("{}radius", "{}ForeArm", "{}Elbow", "{}ForeArm", "{}ForeArm", "{}_elbow"),
    "forearm_end": ("{}wrist", "{}ForeArm", "{}Elbow", "{}ForeArm", "{}ForeArm", "{}_elbow"),
    "hand": ("{}hand", "{}Hand", "{}Wrist", "{}Hand", "{}Hand", "{}_wrist"),
    "thigh": ("{}femur", "{}UpLeg", "{}Hip", "{}Thigh", "{}UpLeg", "{}_hip"),
    "shin": ("{}tibia", "{}Leg", "{}Knee", "{}Shin", "{}Leg", "{}_knee"),
    "foot": ("{}foot", "{}Foot", "{}Ankle", "{}Foot", "{}Foot", "{}_ankle"),
    "toes": ("{}toes", "{}ToeBase", "{}Toe", "{}Foot", "{}ToeBase", "{}_foot"),
}  # fmt: skip
# The humerus and radius of the CMU skeleton turn about axes that stand 30 degrees off the vertical in its T-pose.
_CMU_ELBOW = (0.0, 0.5, 3**0.5 / 2)


def _recorded_skeletons() -> Iterator[SkeletonRoles]:
    for column, (family, words) in enumerate(zip(_COLUMNS, _SIDE_WORDS, strict=True)):
        roles = {role: _PARTS[role][column] for role in TORSO_ROLES}
        for side, word in zip("LR", words, strict=True):
            roles |= {f"{role}.{side}": str(_PARTS[role][column]).format(word) for role in LIMB_ROLES}
        elbow = _CMU_ELBOW if family.startswith("CMU") else FORWARD
        yield SkeletonRoles(family, roles, elbow, ("smpl", "smplh", "smplx") if family == "SMPL" else ())


CMU, _CGSPEED, _MOTIONBUILDER, _POSER, _MIXAMO, SMPL = _recorded_skeletons()
# In this order: the bones of Mixamo are a part of those of cgspeed.
BVH_SOURCES = (_CGSPEED, _MIXAMO, _MOTIONBUILDER, _POSER)


def _joints(family: str) -> dict[str, str]:
    """Limb role -> bone whose head marks the upper end of that limb segment."""
    return {
        f"{role}.{side}": bone.format(word)
        for side, word in zip("LR", SIDES[family], strict=True)
        for role, bone in LIMB_BONES[family].items()
    }


def _anny() -> TargetMap:
    joints = _joints("anny")
    bones: dict[str, Part] = {
        "root": "pelvis", "spine05": "spine_lower", "spine04": Blend("spine_lower", "spine_middle"),
        "spine03": "spine_middle", "spine02": Blend("spine_middle", "spine_upper"), "spine01": "spine_upper",
        "neck01": "neck_lower", "neck02": Blend("neck_lower", "neck_upper"), "neck03": "neck_upper", "head": "head",
    }  # fmt: skip
    for side in "LR":
        bones |= {f"toe{k}-1.{side}": f"toes.{side}" for k in range(1, 6)}
        bones |= {bone: role for role, bone in joints.items() if role.endswith(side)}
        halves = {"upperarm02": "upper_arm", "upperleg02": "thigh", "lowerleg02": "shin"}
        bones |= {f"{bone}.{side}": f"{role}.{side}" for bone, role in halves.items()}
        bones |= {
            f"pelvis.{side}": "pelvis",
            f"shoulder01.{side}": Blend(f"clavicle.{side}", f"upper_arm.{side}", 0.35),
            f"lowerarm02.{side}": Blend(f"forearm.{side}", f"forearm_end.{side}"),
        }
    return TargetMap(bones, joints)


def _smpl() -> TargetMap:
    joints = _joints("smpl")
    bones: dict[str, Part] = {
        "pelvis": "pelvis", "spine1": "spine_lower", "spine2": "spine_middle", "spine3": "spine_upper",
        "neck": Blend("neck_lower", "neck_upper"), "head": "head", **{bone: role for role, bone in joints.items()},
    }  # fmt: skip
    return TargetMap(bones, joints)


TARGETS: Mapping[str, TargetMap] = {
    "anny": _anny(),
    **dict.fromkeys(("smpl", "smplh", "smplx"), _smpl()),
    # A rig with the names of SMPL's joints, and its own bones between and beside them.
    "character": replace(_smpl(), partial=True),
}
