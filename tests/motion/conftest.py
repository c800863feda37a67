"""Bodies and hand-made recordings for the tests of motions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.motion.recordings import write_acclaim, write_bvh

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.body.skinning import SkinningWeights
from pb4u.motion.smpl_recording import nominal_skeleton


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
    """`write_acclaim` into the folder of the test."""
    return partial(write_acclaim, tmp_path)


@pytest.fixture
def bvh(tmp_path: Path) -> Callable[..., Path]:
    """`write_bvh` into the folder of the test."""
    return partial(write_bvh, tmp_path)
