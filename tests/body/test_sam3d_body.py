"""Bodies as SAM 3D Body gives them: one file a frame, in the axes of the camera."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pb4u.body.library import load_body
from pb4u.errors import InputError, InputWarning

BODY = trimesh.creation.capsule(1.2, 0.25).apply_transform(
    trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
)
LEVEL = "the ground is assumed to be level for the camera"


def frames(count: int = 20) -> np.ndarray:
    """A body (frames, vertices, 3) that walks along X on the ground, Y up [m]."""
    upright = np.asarray(BODY.vertices) - [0.0, BODY.vertices[:, 1].min(), 0.0]
    return upright + np.outer(np.arange(count) / 30.0, [1.0, 0.0, 0.0])[:, None]


def write_frames(folder, places, **more) -> None:
    """Files of the estimator: vertices about the body's middle, and where that is for the camera."""
    folder.mkdir()
    for k, place in enumerate(places):
        seen = (place + [0.0, -1.4, -4.0]) * [1.0, -1.0, -1.0]
        middle = seen.mean(axis=0)
        np.savez(
            folder / f"frame_{k}.npz",
            pred_vertices=(seen - middle).astype(np.float32),
            pred_cam_t=middle.astype(np.float32),
            focal_length=np.float32(1000.0),
            **more,
        )


@pytest.mark.parametrize("where", ["member", "faces.npy", "ply"])
def test_a_folder_of_frames_stands_on_the_ground(tmp_path, where):
    write_frames(tmp_path / "sam", frames(), **({"faces": BODY.faces} if where == "member" else {}))
    if where == "faces.npy":
        np.save(tmp_path / "sam/faces.npy", BODY.faces)
    if where == "ply":
        BODY.export(tmp_path / "sam/dancing_mesh_000.ply")
    with pytest.warns(InputWarning, match=LEVEL):
        body = load_body(tmp_path / "sam")
    assert body.is_closed
    positions = body.positions(0, 20).numpy()
    wanted = frames() - frames()[0].mean(axis=0) * [1.0, 0.0, 1.0]
    assert np.abs(positions - wanted).max() < 1e-5


def test_frames_in_one_file_and_trembling(tmp_path):
    rng = np.random.default_rng(0)
    shaken = frames(60) + 0.01 * rng.normal(size=(60, 1, 3))
    write_frames(tmp_path / "sam", shaken, faces=BODY.faces)
    held = [np.load(tmp_path / f"sam/frame_{k}.npz") for k in range(60)]
    stacked = {name: np.stack([each[name] for each in held]) for name in ("pred_vertices", "pred_cam_t")}
    np.savez(tmp_path / "all.npz", **stacked, faces=BODY.faces)
    with pytest.warns(InputWarning, match=LEVEL):
        body, folder = load_body(tmp_path / "all.npz"), load_body(tmp_path / "sam")
    np.testing.assert_array_equal(body.positions(0, 60), folder.positions(0, 60))
    calm = body.smoothed(6.0)

    def jerk(sequence) -> float:
        return float(np.abs(np.diff(sequence.positions(0, 60).numpy(), 2, axis=0)).mean())

    assert jerk(calm) < 0.25 * jerk(body)


@pytest.mark.parametrize(("fps", "stored"), [(24, 24.0), ([59.94], 59.94), (None, 30.0)])
def test_a_rate_in_the_files_is_taken(tmp_path, fps, stored):
    write_frames(tmp_path / "sam", frames(3), faces=BODY.faces, **({} if fps is None else {"fps": fps}))
    with pytest.warns(InputWarning, match=LEVEL):
        assert load_body(tmp_path / "sam").stored_fps == stored


@pytest.mark.parametrize("fps", ["fast", [24.0, 25.0], 0.0])
def test_a_rate_that_is_none_is_refused(tmp_path, fps):
    write_frames(tmp_path / "sam", frames(3), faces=BODY.faces, fps=fps)
    with pytest.raises(InputError, match=r'"fps"|frame rate'):
        load_body(tmp_path / "sam")


def test_what_is_missing_is_told(tmp_path):
    write_frames(tmp_path / "sam", frames(2))
    with pytest.raises(InputError, match="no faces"):
        load_body(tmp_path / "sam")
    np.savez(tmp_path / "sam/frame_1.npz", pred_vertices=np.zeros((5, 3), dtype=np.float32))
    with pytest.raises(InputError, match=r"frame_1\.npz.* 5 .*frame_0\.npz"):
        load_body(tmp_path / "sam")
    np.savez(tmp_path / "sam/frame_1.npz", other=np.zeros(2))
    with pytest.raises(InputError, match='has no "pred_vertices"'):
        load_body(tmp_path / "sam")
