"""Skeletons are known by what programs call their joints, in recordings as in characters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.rest_poses import OFFSETS, PARENTS, walking, write_rested

from pb4u.body.bone_names import smpl_names
from pb4u.errors import InputError
from pb4u.motion.library import load_motion

LIMBS = ("UpLeg", "Leg", "Foot", "ToeBase", "Shoulder", "Arm", "ForeArm", "Hand")
CENTRE = ("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head")
# What programs call these joints of the trunk, then those of a limb, in which {} is the side; and their two sides.
NAMES = {
    "Mixamo": (
        "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck mixamorig:Head",
        " ".join(f"mixamorig:{{}}{limb}" for limb in LIMBS), "Left Right",
    ),
    "Mixamo of a browser": (
        "mixamorigHips mixamorigSpine mixamorigSpine1 mixamorigSpine2 mixamorigNeck mixamorigHead",
        " ".join(f"mixamorig{{}}{limb}" for limb in LIMBS), "Left Right",
    ),
    "MotionBuilder": (
        "Character1_Hips Character1_Spine Character1_Spine1 Character1_Spine2 Character1_Neck Character1_Head",
        " ".join(f"Character1_{{}}{limb}" for limb in LIMBS), "Left Right",
    ),
    "LAFAN1": (" ".join(CENTRE), "{}UpLeg {}Leg {}Foot {}Toe {}Shoulder {}Arm {}ForeArm {}Hand", "Left Right"),
    "Unreal": (
        "pelvis spine_01 spine_02 spine_03 neck_01 head",
        "thigh_{} calf_{} foot_{} ball_{} clavicle_{} upperarm_{} lowerarm_{} hand_{}", "l r",
    ),
    "SMPL": (
        "Pelvis Spine1 Spine2 Spine3 Neck Head",
        "{}_Hip {}_Knee {}_Ankle {}_Foot {}_Collar {}_Shoulder {}_Elbow {}_Wrist", "L R",
    ),
    "SMPL in words": (
        "pelvis spine1 spine2 spine3 neck head",
        "{}_hip {}_knee {}_ankle {}_foot {}_collar {}_shoulder {}_elbow {}_wrist", "left right",
    ),
    "Xsens": (
        "Hips Chest Chest2 Chest3 Neck Head",
        "{}Hip {}Knee {}Ankle {}Toe {}Collar {}Shoulder {}Elbow {}Wrist", "Left Right",
    ),
    "Xsens in FBX": (
        "Pelvis L5 L3 T8 Neck Head",
        "{}UpperLeg {}LowerLeg {}Foot {}Toe {}Shoulder {}UpperArm {}ForeArm {}Hand", "Left Right",
    ),
    "Rokoko": (
        "Hips Spine1 Spine2 Spine3 Neck Head", "{}Thigh {}Shin {}Foot {}Toe {}Shoulder {}Arm {}ForeArm {}Hand",
        "Left Right",
    ),
    "3ds Max Biped": (
        "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Spine2 Bip01_Neck Bip01_Head",
        "Bip01_{}_Thigh Bip01_{}_Calf Bip01_{}_Foot Bip01_{}_Toe0 Bip01_{}_Clavicle Bip01_{}_UpperArm "
        "Bip01_{}_Forearm Bip01_{}_Hand", "L R",
    ),
    "VRM": (
        "hips spine chest upperChest neck head",
        "{}UpperLeg {}LowerLeg {}Foot {}Toes {}Shoulder {}UpperArm {}LowerArm {}Hand", "left right",
    ),
    "VRoid": (
        "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head",
        " ".join(f"J_Bip_{{}}_{limb}" for limb in
                 ("UpperLeg", "LowerLeg", "Foot", "ToeBase", "Shoulder", "UpperArm", "LowerArm", "Hand")), "L R",
    ),
    "MakeHuman": (
        "root spine05 spine03 spine01 neck01 head",
        "upperleg01.{} lowerleg01.{} foot.{} toe1-1.{} clavicle.{} upperarm01.{} lowerarm01.{} wrist.{}", "L R",
    ),
    "Rigify": (
        "DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.003 DEF-neck DEF-head",
        "DEF-thigh.{} DEF-shin.{} DEF-foot.{} DEF-toe.{} DEF-shoulder.{} DEF-upper_arm.{} DEF-forearm.{} DEF-hand.{}",
        "L R",
    ),
    "DAZ": (
        "hip abdomenLower abdomenUpper chestUpper neckLower head",
        "{}ThighBend {}Shin {}Foot {}Toe {}Collar {}ShldrBend {}ForearmBend {}Hand", "l r",
    ),
    "CMU Acclaim": (
        "root lowerback upperback thorax lowerneck head",
        "{}femur {}tibia {}foot {}toes {}clavicle {}humerus {}radius {}hand", "l r",
    ),
}  # fmt: skip


def renaming(scheme: str) -> Mapping[str, str]:
    """Joint of Mixamo -> what a scheme calls it."""
    centre, limbs, sides = NAMES[scheme]
    names = dict(zip(CENTRE, centre.split(), strict=True))
    for side, word in zip(("Left", "Right"), sides.split(), strict=True):
        names |= {f"{side}{limb}": name.format(word) for limb, name in zip(LIMBS, limbs.split(), strict=True)}
    return names


def arms_and_legs(path: Path, body) -> np.ndarray:
    """Rotations (frames, bones, 4) of the body."""
    return load_motion(path, arms_away_degrees=0.0).poses(body, 30.0, 12).rotations


@pytest.fixture(scope="module")
def known(tmp_path_factory, woman) -> np.ndarray:
    return arms_and_legs(write_rested(tmp_path_factory.mktemp("m") / "clip.bvh", {}, frames=12), woman)


@pytest.mark.parametrize("scheme", list(NAMES))
def test_a_recording_is_known_by_the_names_of_many_programs(tmp_path, woman, known, scheme):
    path = write_rested(tmp_path / "clip.bvh", {}, named=lambda name: renaming(scheme)[name], frames=12)
    np.testing.assert_allclose(arms_and_legs(path, woman), known, atol=1e-6)


@pytest.mark.parametrize("scheme", list(NAMES))
def test_a_character_is_known_by_the_same_names(scheme):
    names = [renaming(scheme)[name] for name in PARENTS]
    order = list(PARENTS)
    found = smpl_names(names, [order.index(parent) if parent else -1 for parent in PARENTS.values()])
    assert found is not None
    wanted = {"Hips": "pelvis", "LeftUpLeg": "left_hip", "RightLeg": "right_knee", "LeftFoot": "left_ankle",
              "RightArm": "right_shoulder", "LeftForeArm": "left_elbow", "RightHand": "right_wrist", "Neck": "neck",
              "LeftToeBase": "left_foot", "RightShoulder": "right_collar", "Spine2": "spine3"}  # fmt: skip
    assert {name: found.get(order.index(name)) for name in wanted} == wanted


def test_names_with_spaces_are_whole(tmp_path, woman, known):
    names = renaming("3ds Max Biped")
    path = write_rested(tmp_path / "clip.bvh", {}, named=lambda name: names[name].replace("_", " "), frames=12)
    np.testing.assert_allclose(arms_and_legs(path, woman), known, atol=1e-6)


@pytest.mark.parametrize("scheme", ["LAFAN1", "Unreal", "Xsens", "VRM"])
def test_toes_collar_bones_and_neck_may_be_missing(tmp_path, woman, known, scheme):
    left_out = {"LeftToeBase", "RightToeBase", "LeftShoulder", "RightShoulder", "Neck"}
    names, offsets = renaming(scheme), dict(OFFSETS)
    parents = {}
    for name, parent in PARENTS.items():
        if name in left_out:
            continue
        if parent in left_out:
            offsets[name], parent = OFFSETS[parent] + OFFSETS[name], PARENTS[parent]
        parents[name] = parent
    path = write_rested(
        tmp_path / "clip.bvh", {}, lambda time: {k: v for k, v in walking(time).items() if k != "Head"},
        names.__getitem__, 12, offsets, parents,
    )  # fmt: skip
    found = arms_and_legs(path, woman)
    for bone in ("upperarm01.L", "lowerarm01.R", "upperleg01.L", "lowerleg01.R", "foot.L", "spine01"):
        k = woman.skeleton.index(bone)
        np.testing.assert_allclose(found[:, k], known[:, k], atol=1e-6)


def test_limbs_may_hang_on_spine_and_neck_as_biped_has_them(tmp_path, woman, known):
    names, parents, offsets = renaming("3ds Max Biped"), dict(PARENTS), dict(OFFSETS)
    for side in ("Left", "Right"):
        for limb, above in (("UpLeg", "Spine"), ("Shoulder", "Neck")):
            parents[f"{side}{limb}"] = above
            offsets[f"{side}{limb}"] = OFFSETS[f"{side}{limb}"] - OFFSETS[above]

    def without_head(time: float) -> dict[str, Rotation]:
        return {name: turn for name, turn in walking(time).items() if name != "Head"}

    found, wanted = (
        arms_and_legs(write_rested(tmp_path / "clip.bvh", {}, without_head, called.__getitem__, 12, *skeleton), woman)
        for called, skeleton in ((names, (offsets, parents)), ({name: name for name in PARENTS}, ()))
    )
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_twist_bones_are_left_aside(tmp_path, woman, known):
    parents, offsets = {}, dict(OFFSETS)
    for name, parent in PARENTS.items():
        parents[name] = parent
        if name.endswith(("Arm", "UpLeg")):
            parents[f"{name}Twist"], offsets[f"{name}Twist"] = name, 0.5 * OFFSETS["LeftArm"]
    path = write_rested(tmp_path / "clip.bvh", {}, frames=12, parents=parents, offsets=offsets)
    np.testing.assert_allclose(arms_and_legs(path, woman), known, atol=1e-6)


@pytest.mark.parametrize(
    ("renamed", "says"),
    [
        ({"LeftArm": "Flipper"}, r'the nearest is Mixamo, of which LeftArm is missing \("Flipper" may be LeftArm\)'),
        ({"LeftForeArm": "LeftFourArm"}, r'\("LeftFourArm" may be LeftForeArm\)'),
        ({"Head": "Skull"}, "of which Head is missing"),
    ],
)
def test_an_unknown_joint_is_named_with_the_nearest_known(bvh, renamed, says):
    with pytest.raises(InputError, match=says):
        load_motion(bvh(renamed=renamed))
