"""The tables agree with the roles and with the skeletons that they describe."""

from __future__ import annotations

import pytest

from pb4u.body.joint_names import ARM, LIMB_BONES, SIDES
from pb4u.motion.correspondences import ROLES, SMPL, TARGETS, Blend
from pb4u.motion.humanoid import Humanoid


def test_source_plays_every_role():
    assert set(SMPL.roles) == set(ROLES)


@pytest.mark.parametrize("family", list(TARGETS))
def test_target_is_driven_by_known_roles(family):
    for part in TARGETS[family].bones.values():
        names = (part.first, part.second) if isinstance(part, Blend) else (part,)
        assert set(names) <= set(ROLES)


def test_targets_fit_their_skeletons(woman, smpl_body):
    for body in (woman, *(smpl_body(family) for family in ("smpl", "smplh", "smplx"))):
        assert Humanoid(body).leg_length == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize("family", list(LIMB_BONES))
def test_only_the_bones_of_arms_are_taken_for_an_arm(family):
    told = {
        part for part, bone in LIMB_BONES[family].items() for side in SIDES[family] if ARM.search(bone.format(side))
    }
    assert told == {"upper_arm", "forearm", "hand"}
