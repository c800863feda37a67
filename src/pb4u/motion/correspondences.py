"""Which bone plays which part: tables between the bone names of files and bodies, and a set of humanoid roles.

Every skeleton is described once, against the roles, instead of once per pair of skeletons. An entry is a bone (or role)
name, or a `Blend` of two where the other skeleton divides the body elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from pb4u.body.bone_names import human_bones
from pb4u.body.joint_names import LIMB_BONES, SIDES

TORSO_ROLES = ("pelvis", "spine_lower", "spine_middle", "spine_upper", "neck_lower", "neck_upper", "head")
LIMB_ROLES = ("clavicle", "upper_arm", "forearm", "forearm_end", "hand", "thigh", "shin", "foot", "toes")
ROLES = TORSO_ROLES + tuple(f"{role}.{side}" for side in "LR" for role in LIMB_ROLES)
SEGMENTS: Mapping[str, str] = {
    f"{upper}.{side}": f"{lower}.{side}"
    for upper, lower in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shin"), ("shin", "foot"))
    for side in "LR"
}
"""Limb role -> the one whose joint marks its lower end."""
ROLE_INDEX: Mapping[str, int] = {role: i for i, role in enumerate(ROLES)}
FORWARD = (0.0, 0.0, 1.0)
"""Direction in which a straight forearm folds in a T-pose facing +Z."""


@dataclass(frozen=True)
class Blend:
    """A rotation interpolated between those of two bones (or roles).

    Args:
        first: bone or role at amount 0.
        second: bone or role at which it ends.
        amount: interpolation parameter, 0 to 1.
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
        elbow_flexion: direction in which the left forearm bends, in a T-pose facing +Z.
        same_as: families of bodies that have these very bones and rest pose, which need no retargeting.
    """

    family: str
    roles: Mapping[str, Part]
    elbow_flexion: tuple[float, float, float] = FORWARD
    same_as: tuple[str, ...] = ()


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


# The humerus and radius of the CMU skeleton turn about axes that stand 30 degrees off the vertical in its T-pose.
_CMU_ELBOW = (0.0, 0.5, 3**0.5 / 2)
_CMU_BONES = {"lhipjoint", "lowerback"}
_SPINE_ROLES = TORSO_ROLES[1:4]
_LIMB_JOINTS = {role: bone.replace("{}_", "") for role, bone in LIMB_BONES["smpl"].items()}


def roles_of(names: Sequence[str], parents: Sequence[int]) -> SkeletonRoles | None:
    """Roles of the bones of a human, from their names (`pb4u.body.bone_names`); None if the skeleton is not human.

    For a spine or neck with an unusual number of bones roles are interpolated between its bones; without toes, collar
    bones or a neck their parents take these roles.

    Args:
        names: of the bones, each once, parents before children.
        parents: index of each parent, -1 of a root.
    """
    human = human_bones(names, parents)
    if human is None:
        return None
    chest, head = names[human.spine[-1]], names[human.joints["head"]]
    spine = [names[bone] for bone in (human.pelvis, *human.spine)]
    neck = [names[bone] for bone in human.neck]
    roles: dict[str, Part] = {"pelvis": spine[0], "head": head}
    roles |= {role: _along(spine, k / len(_SPINE_ROLES)) for k, role in enumerate(_SPINE_ROLES, 1)}
    if neck:
        roles |= {"neck_lower": neck[0], "neck_upper": neck[-1] if len(neck) > 1 else Blend(neck[0], head)}
    else:
        roles |= {"neck_lower": _along([chest, head], 1 / 3), "neck_upper": _along([chest, head], 2 / 3)}
    if not set(human.spine) <= set(_above(human.joints["head"], parents)):
        return None
    limbs: dict[str, int] = {}
    for side, word in (("L", "left"), ("R", "right")):
        joints = {role: human.joints.get(f"{word}_{joint}") for role, joint in _LIMB_JOINTS.items()}
        bones = {role: bone for role, bone in joints.items() if bone is not None}
        bones = {"clavicle": human.spine[-1], "toes": bones["foot"], **bones}
        bones["forearm_end"] = int(parents[bones["hand"]])
        limbs |= {f"{role}.{side}": bone for role, bone in bones.items()}
    if any(limbs[upper] not in _above(limbs[lower], parents) for upper, lower in SEGMENTS.items()):
        return None
    roles |= {role: names[bone] for role, bone in limbs.items()}
    cmu = {name.casefold() for name in names} >= _CMU_BONES
    return SkeletonRoles("CMU" if cmu else "human", roles, _CMU_ELBOW if cmu else FORWARD)


def _above(bone: int, parents: Sequence[int]) -> list[int]:
    """Bones that a bone hangs on."""
    above = []
    while parents[bone] >= 0:
        bone = int(parents[bone])
        above.append(bone)
    return above


def _along(bones: Sequence[str], share: float) -> Part:
    """The bone, or blend of two, at a share of the way from the first of some bones to the last."""
    place = share * (len(bones) - 1)
    first = int(place + 1e-9)
    amount = place - first
    return bones[first] if amount < 1e-9 else Blend(bones[first], bones[first + 1], amount)


SMPL = SkeletonRoles(
    "SMPL",
    {
        "pelvis": "pelvis", "spine_lower": "spine1", "spine_middle": "spine2", "spine_upper": "spine3",
        "neck_lower": "neck", "neck_upper": Blend("neck", "head"), "head": "head",
        **{
            f"{role}.{side}": LIMB_BONES["smpl"][role.replace("_end", "")].format(word)
            for side, word in zip("LR", SIDES["smpl"], strict=True)
            for role in LIMB_ROLES
        },
    },
    same_as=("smpl", "smplh", "smplx"),
)  # fmt: skip


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
