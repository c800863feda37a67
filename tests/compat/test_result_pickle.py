"""Results in the layout of the released code."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pb4u.compat.result_pickle import open_trajectory, read_result
from pb4u.errors import InputError
from pb4u.export.registry import export
from pb4u.io.restricted_pickle import load_pickle
from pb4u.scene.trajectory import Trajectory


def result(frames: int = 3) -> dict[str, Any]:
    rng = np.random.default_rng(3)
    return {
        "pred": rng.normal(size=(frames, 4, 3)).astype(np.float32),
        "obstacle": rng.normal(size=(frames, 5, 3)).astype(np.float32),
        "metrics": {"stretching_energy_loss": [1.0] * frames},
        "cloth_faces": np.array([[0, 1, 2], [1, 3, 2]]),
        "obstacle_faces": np.array([[0, 1, 4]]),
    }


def written(path: Path, content: Any) -> Path:
    path.write_bytes(pickle.dumps(content))
    return path


def test_a_result_is_read_and_comes_back_as_it_was(tmp_path: Path) -> None:
    given = result()
    trajectory = open_trajectory(written(tmp_path / "theirs.pkl", given))
    np.testing.assert_array_equal(trajectory.positions, given["pred"])
    np.testing.assert_allclose(trajectory.velocities[1], 30 * (given["pred"][1] - given["pred"][0]), rtol=1e-6)
    export(trajectory, tmp_path / "ours.npz")
    export(Trajectory.open(tmp_path / "ours.npz"), tmp_path / "back.pkl")
    back = load_pickle(tmp_path / "back.pkl")
    for name in ("pred", "obstacle", "cloth_faces", "obstacle_faces"):
        np.testing.assert_array_equal(back[name], given[name])
        assert back[name].dtype == given[name].dtype
    # Their viewers load it with pickle itself, under a numpy older than 2.
    assert b"numpy._core" not in (tmp_path / "back.pkl").read_bytes()
    assert pickle.loads((tmp_path / "back.pkl").read_bytes())["pred"].shape == (3, 4, 3)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"pred": np.zeros((3, 4))}, "pred has the shape .3, 4., not .frames, vertices, 3."),
        ({"obstacle": np.zeros((2, 5, 3))}, "not .frames = 3, body vertices, 3."),
        ({"cloth_faces": np.array([[0, 1, 9]])}, "cloth_faces has indices beyond its 4 vertices"),
        ({"obstacle_faces": np.zeros((1, 3))}, "whole numbers"),
    ],
)
def test_a_result_that_does_not_fit_itself_is_refused(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_result(written(tmp_path / "odd.pkl", {**result(), **changes}))


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no obstacle"):
        read_result(written(tmp_path / "odd.pkl", {"pred": np.zeros((1, 2, 3))}))
    with pytest.raises(InputError, match="not a dictionary"):
        read_result(written(tmp_path / "odd.pkl", [1]))
    with pytest.raises(InputError, match="There is no trajectory"):
        read_result(tmp_path / "absent.pkl")


def test_a_released_result_opens(compat: Path) -> None:
    trajectory = read_result(compat / "files/output_pb4u.pkl")
    golden = np.load(compat / "golden/pb4u_dress.npz")
    for step in range(4):
        np.testing.assert_array_equal(trajectory.positions[step], golden[f"case0/step{step}/pred_pos_f32"])
    assert trajectory.body_positions.shape == (4, 362, 3)
