import os
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse
import torch

from pb4u.body.library import load_body
from pb4u.body.skeleton import PoseSequence, joint_positions
from pb4u.body.smpl import JOINT_NAMES, SmplBody
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_axis_angle, multiply

BETAS = {"smpl": 10, "smplh": 16, "smplx": 20}


def synthetic(family: str, vertices: int = 90) -> dict[str, Any]:
    """The members of a model file of `family`, random but consistent."""
    rng = np.random.default_rng(len(family))
    joints = len(JOINT_NAMES[family])
    parents = np.array([0 if j == 0 else rng.integers(max(0, j - 3), j) for j in range(joints)], dtype=np.uint32)
    parents[0] = 2**32 - 1
    regressor = rng.random((joints, vertices)) * (rng.random((joints, vertices)) < 0.2)
    regressor[:, 0] += 1e-3
    weights = np.zeros((vertices, joints))
    for row in weights:
        row[rng.choice(joints, 4, replace=False)] = rng.random(4)
    return {
        "v_template": rng.normal(size=(vertices, 3)),
        "shapedirs": rng.normal(size=(vertices, 3, BETAS[family])) * 0.05,
        "posedirs": rng.normal(size=(vertices, 3, 9 * (joints - 1))) * 0.01,
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "kintree_table": np.stack([parents, np.arange(joints, dtype=np.uint32)]),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "f": rng.integers(0, vertices, (40, 3)).astype(np.uint32),
    }


def save(path: Path, members: dict[str, Any]) -> Path:
    if path.suffix == ".npz":
        np.savez(path, **members)
    else:
        path.write_bytes(pickle.dumps({**members, "bs_type": "lrotmin"}, protocol=2))
    return path


def world_rotations(parents: np.ndarray, local: np.ndarray) -> np.ndarray:
    result = local.copy()
    for joint, parent in enumerate(parents.tolist()):
        if parent >= 0:
            result[:, joint] = multiply(result[:, parent], local[:, joint])
    return result


@pytest.mark.parametrize("family", list(JOINT_NAMES))
@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_shape_pose_and_correctives_agree_with_smplx(family: str, suffix: str, tmp_path: Path) -> None:
    smplx_lbs = pytest.importorskip("smplx.lbs", reason="smplx is not installed")
    members = synthetic(family)
    stored = (
        members if suffix == ".npz" else {**members, "J_regressor": scipy.sparse.csc_matrix(members["J_regressor"])}
    )
    model = SmplBody(save(tmp_path / f"model{suffix}", stored))
    rng = np.random.default_rng(0)
    offered = len(model.shape_parameters)
    betas = rng.normal(size=offered)
    body = model.shaped(**{f"beta{k}": float(value) for k, value in enumerate(betas)})
    assert body.family == family

    frames, joints = 40, len(JOINT_NAMES[family])
    axis_angle = rng.normal(size=(frames, joints, 3)) * 0.4
    parents = body.skeleton.parents
    expected, expected_joints = smplx_lbs.lbs(
        torch.from_numpy(np.tile(betas, (frames, 1))),
        torch.from_numpy(axis_angle.reshape(frames, -1)),
        torch.from_numpy(members["v_template"])[None],
        torch.from_numpy(members["shapedirs"][:, :, :offered]),
        torch.from_numpy(members["posedirs"].reshape(-1, 9 * (joints - 1)).T),
        torch.from_numpy(members["J_regressor"]),
        torch.from_numpy(parents),
        torch.from_numpy(members["weights"]),
    )
    lift = body.skeleton.joints[0] - expected_joints[0, 0].numpy()
    local = from_axis_angle(axis_angle)
    poses = PoseSequence(world_rotations(parents, local), np.tile(body.skeleton.joints[0], (frames, 1)), 30.0)
    posed = body.posed(poses)
    np.testing.assert_allclose(posed.positions(0, frames).numpy(), expected.numpy() + lift, atol=2e-5)
    np.testing.assert_allclose(posed.positions(35, 38).numpy(), expected.numpy()[35:38] + lift, atol=2e-5)
    np.testing.assert_allclose(joint_positions(body.skeleton, poses), expected_joints.numpy() + lift, atol=1e-6)


def test_a_whole_file_agrees_with_the_model_of_smplx(tmp_path: Path) -> None:
    smplx = pytest.importorskip("smplx", reason="smplx is not installed")
    members = synthetic("smpl", vertices=6890)
    body = load_body(save(tmp_path / "basicmodel.npz", members), {"beta1": 1.5})
    reference = smplx.SMPL(model_path="", data_struct=SimpleNamespace(**members), num_betas=10)
    betas = torch.zeros(1, 10)
    betas[0, 1] = 1.5
    with torch.no_grad():
        expected = reference(betas=betas).vertices[0].numpy()
    expected = expected - [0.0, expected[:, 1].min(), 0.0]
    np.testing.assert_allclose(
        body.rest_vertices if hasattr(body, "rest_vertices") else body.vertices, expected, atol=1e-4
    )


def test_rest_stands_on_the_ground_and_hands_make_no_contact(tmp_path: Path) -> None:
    members = synthetic("smplh")
    members["kintree_table"][0, 22:] = [20 if name.startswith("left") else 21 for name in JOINT_NAMES["smplh"][22:]]
    body = SmplBody(save(tmp_path / "model.npz", members)).shaped()
    assert body.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-12)
    hand = [j for j, name in enumerate(JOINT_NAMES["smplh"]) if j >= 20]
    np.testing.assert_array_equal(~body.contact, members["weights"][:, hand].sum(axis=1) > 0.5)
    assert 0 < body.contact.sum() < len(body.contact)


def test_smplx_offers_its_shape_directions_without_the_expressions(tmp_path: Path) -> None:
    model = SmplBody(save(tmp_path / "model.npz", synthetic("smplx")))
    assert list(model.shape_parameters) == [f"beta{k}" for k in range(10)]


def broken(members: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    return {name: entry for name, entry in {**members, key: value}.items() if entry is not None}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("weights", None, "has no weights"),
        ("posedirs", np.zeros((90, 3, 10)), "10 pose features"),
        ("J_regressor", np.zeros((24, 7)), "J_regressor has the shape"),
        ("v_template", np.full((90, 3), np.nan), "not finite"),
        ("posedirs", np.full((90, 3, 207), 1e300), "beyond 10000"),
        ("kintree_table", np.zeros((2, 30), dtype=np.int64), "joints = 30"),
        ("kintree_table", np.full((2, 24), 23), "before its parent"),
        ("f", np.full((3, 3), 90), "beyond its 90 vertices"),
        ("weights", np.zeros((90, 24)), "empty rows"),
        ("shapedirs", np.zeros((90, 3)), "shapedirs has the shape"),
        ("v_template", np.zeros((2, 3, 4)), "v_template has the shape"),
        ("v_template", np.float64(3), "v_template has the shape"),
    ],
)
def test_bad_members_are_refused(key: str, value: Any, message: str, tmp_path: Path) -> None:
    path = save(tmp_path / "model.npz", broken(synthetic("smpl"), key, value))
    with pytest.raises(InputError, match=message):
        SmplBody(path)


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_a_body_without_skin_is_refused(suffix: str, tmp_path: Path) -> None:
    members = synthetic("smpl")
    empty = {"v_template": (0, 3), "shapedirs": (0, 3, 10), "posedirs": (0, 3, 207), "J_regressor": (24, 0)}
    empty |= {"weights": (0, 24)}
    path = save(
        tmp_path / f"model{suffix}",
        {**members, **{key: np.zeros(shape) for key, shape in empty.items()}, "f": np.zeros((0, 3), dtype=np.int64)},
    )
    with pytest.raises(InputError, match="it has 0 vertices"):
        load_body(path)


def test_a_malicious_model_file_is_refused_and_did_not_run(tmp_path: Path) -> None:
    class Attack:
        def __reduce__(self) -> tuple[Any, tuple[str]]:
            return os.system, (f"touch {tmp_path / 'proof'}",)

    path = tmp_path / "model.pkl"
    path.write_bytes(pickle.dumps({**synthetic("smpl"), "J_regressor": Attack()}))
    with pytest.raises(InputError, match="system"):
        load_body(path)
    assert not (tmp_path / "proof").exists()


def test_shape_parameters_are_checked(tmp_path: Path) -> None:
    path = save(tmp_path / "model.npz", synthetic("smpl"))
    with pytest.raises(InputError, match="beta0"):
        load_body(path, {"height": 0.5})
    with pytest.raises(InputError, match="-10 to 10"):
        load_body(path, {"beta0": 40.0})
