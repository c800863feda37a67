import os
import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from pb4u.body.anny_body import AnnyBody, to_world_axes
from pb4u.body.baked_body import BakedBody
from pb4u.body.built_in import BUILT_IN
from pb4u.body.skeleton import PoseSequence
from pb4u.errors import InputError, MissingExtraError
from pb4u.geometry.rotation import from_axis_angle, matrix_from_quaternion

BAKING = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "bake_bodies.py"))
GENDER, bake = BAKING["GENDER"], BAKING["bake"]


@pytest.fixture(scope="module")
def anny_body() -> AnnyBody:
    pytest.importorskip("anny", reason="the anny extra is not installed")
    cache = os.environ.get("ANNY_CACHE_DIR")
    if not cache or not any(Path(cache).rglob("*.safetensors")):
        pytest.skip("set ANNY_CACHE_DIR to a warm cache; building Anny's rig takes minutes")
    return AnnyBody()


def forward_of_anny(anny_body: AnnyBody, parameters: dict[str, float], poses: PoseSequence) -> np.ndarray:
    """Vertices (frames, vertices, 3) of Anny's own forward pass, in this package's axes."""
    model = anny_body.model
    rest = model.get_rest_model(model.get_phenotype_blendshape_coefficients(**parameters))
    axes = to_world_axes(np.eye(3)).T
    delta = np.zeros((*poses.rotations.shape[:2], 4, 4))
    rotations = matrix_from_quaternion(torch.from_numpy(poses.rotations)).numpy()
    delta[..., :3, :3] = axes.T @ rotations @ axes @ rest["rest_bone_poses"][0, :, :3, :3].numpy()
    delta[:, 0, :3, 3] = poses.root_positions @ axes
    delta[..., 3, 3] = 1.0
    return to_world_axes(model(torch.from_numpy(delta), phenotype_kwargs=parameters)["vertices"].numpy())


@pytest.mark.parametrize("name", BUILT_IN)
def test_baked_and_full_bodies_move_as_anny_does(anny_body: AnnyBody, name: str) -> None:
    rng = np.random.default_rng(5)
    for shape in ({}, {"height": 0.7, "weight": 0.9, "muscle": 0.2}):
        parameters = {"gender": GENDER[name], "age": 0.67, **shape}
        rotations = from_axis_angle(rng.normal(size=(5, 104, 3)) * 0.3)
        for body in (BakedBody.built_in(name).shaped(**shape), anny_body.shaped(**parameters)):
            poses = PoseSequence(rotations, body.skeleton.joints[0] + rng.normal(size=(5, 3)), 30.0)
            error = body.posed(poses).positions(0, 5).numpy() - forward_of_anny(anny_body, parameters, poses)
            assert np.linalg.norm(error, axis=-1).max() < 5e-4


def test_baked_shapes_equal_those_of_anny(anny_body: AnnyBody) -> None:
    rng = np.random.default_rng(6)
    for name in BUILT_IN:
        for values in rng.random((5, 3)).tolist():
            shape = dict(zip(("height", "weight", "muscle"), values, strict=True))
            baked = BakedBody.built_in(name).shaped(**shape)
            full = anny_body.shaped(gender=GENDER[name], **shape)
            assert np.abs(baked.vertices - full.vertices).max() < 1e-4
            assert np.abs(baked.skeleton.joints - full.skeleton.joints).max() < 1e-4


def test_baking_again_gives_the_files_of_the_package(anny_body: AnnyBody, tmp_path: Path) -> None:
    pytest.importorskip("igl", reason="libigl is not installed")
    written = bake(tmp_path)
    assert [path.stem for path in written] == list(BUILT_IN)
    for path in written:
        with np.load(path) as fresh, np.load(Path(__file__).parents[2] / "src/pb4u/body/data" / path.name) as shipped:
            assert set(fresh.files) == set(shipped.files)
            for key in fresh.files:
                if fresh[key].dtype.kind == "f":
                    np.testing.assert_allclose(fresh[key], shipped[key], atol=1e-6)
                else:
                    # A last digit may round the other way on another machine.
                    assert (fresh[key] != shipped[key]).mean() < 1e-3, key


def test_child_is_smaller_and_unknown_parameters_are_refused(anny_body: AnnyBody) -> None:
    assert anny_body.shaped(age=0.25).height < anny_body.shaped().height - 0.3
    with pytest.raises(InputError, match="proportions"):
        anny_body.shaped(wings=1.0)


def test_the_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(MissingExtraError, match=r"pb4u\[anny\]"):
        AnnyBody().shaped()
