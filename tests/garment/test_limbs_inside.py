"""Garments whose sleeves do not lie around the arms are refused, and those dented into a limb are pushed out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pb4u.body.library import load_body
from pb4u.errors import InputError, InputWarning
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.garment.limbs_inside import limbs_outside, with_limbs_inside


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


@pytest.fixture(scope="module")
def shirt(woman) -> Garment:
    return build_garment("longsleeve", woman, 1500)


def test_what_is_worn_stays_as_it_is(woman, shirt):
    assert limbs_outside(shirt.vertices, shirt.faces, woman) == ()
    assert with_limbs_inside(shirt, woman) is shirt


def test_a_sleeve_beside_its_arm_is_refused_in_one_sentence(woman, shirt):
    shoulder = woman.skeleton.joints[woman.skeleton.index("upperarm01.L")]
    sleeve = shirt.vertices[:, 0] > shoulder[0] + 0.03
    angle = np.radians(20.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    vertices = shirt.vertices.copy()
    vertices[sleeve] = (vertices[sleeve] - shoulder) @ turn.T + shoulder
    found = {each.code: each.sentence for each in diagnose(replace(shirt, vertices=vertices), woman).findings}
    assert found["limb-outside"].startswith("The left forearm of the body at rest: through the cloth")
    with pytest.raises(InputError, match=r"left forearm .*woman"):
        with_limbs_inside(replace(shirt, vertices=vertices), woman)


def test_a_dent_across_the_spine_is_pushed_out(woman, shirt):
    back = (shirt.vertices[:, 2] < -0.02) & (np.abs(shirt.vertices[:, 0]) < 0.05)
    back &= np.abs(shirt.vertices[:, 1] - 0.65 * woman.height) < 0.05
    vertices = shirt.vertices.copy()
    joints = woman.skeleton.joints
    spine = joints[np.abs(joints[:, 0]) < 0.01]
    bone = spine[np.abs(spine[:, 1] - 0.65 * woman.height).argmin(), 2]
    vertices[back, 2] = bone + 0.01
    dented = replace(shirt, vertices=vertices)
    (limb,) = limbs_outside(vertices, shirt.faces, woman)
    assert limb.startswith("spine")
    with pytest.warns(InputWarning, match=r"^longsleeve: the trunk"):
        mended = with_limbs_inside(dented, woman)
    assert limbs_outside(mended.vertices, mended.faces, woman) == ()
    still = np.linalg.norm(shirt.vertices - shirt.vertices[back].mean(axis=0), axis=1) > 0.4
    np.testing.assert_allclose(mended.vertices[still], vertices[still], atol=2e-3)
