"""SMPL recordings that are played as they are."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.body.smpl import read_contact
from pb4u.compat.recording_as_released import RecordingAsItIs, read_smpl_sequence
from pb4u.errors import InputError
from pb4u.geometry.rotation import angle_between
from pb4u.run import Run, WornGarment
from pb4u.scene.assembly import build_scene


def recording(frames: int = 4) -> dict[str, Any]:
    rng = np.random.default_rng(2)
    return {
        "body_pose": 0.2 * rng.normal(size=(frames, 69)),
        "global_orient": 0.2 * rng.normal(size=(frames, 3)),
        "transl": rng.normal(size=(frames, 3)),
        "betas": 0.5 * rng.normal(size=10),
    }


def written(path: Path, content: Any) -> Path:
    path.write_bytes(pickle.dumps(content))
    return path


def test_all_files_of_one_recording_are_the_same_motion(tmp_path: Path) -> None:
    made = recording()
    poses = np.concatenate([made["global_orient"], made["body_pose"]], axis=1)
    vto = {"pose": poses, "translation": made["transl"], "shape": np.tile(made["betas"], (4, 1))}
    first = read_smpl_sequence(written(tmp_path / "a.pkl", made))
    second = read_smpl_sequence(written(tmp_path / "b.pkl", vto))
    for name in ("poses", "translations", "betas"):
        np.testing.assert_allclose(getattr(first, name), getattr(second, name))


def test_hands_lie_flat_and_arms_are_held_away_about_z(tmp_path: Path) -> None:
    path = written(tmp_path / "a.pkl", recording())
    still, away = RecordingAsItIs(path), RecordingAsItIs(path, arms_away_degrees=20.0)
    np.testing.assert_array_equal(still._local[:, 22:], np.broadcast_to([1.0, 0, 0, 0], (4, 2, 4)))
    for joint in (16, 17):
        turned = angle_between(still._local[:, joint], away._local[:, joint])
        np.testing.assert_allclose(np.rad2deg(turned), 20.0, atol=1e-6)
    np.testing.assert_array_equal(np.delete(still._local, (16, 17), axis=1), np.delete(away._local, (16, 17), axis=1))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"body_pose": np.zeros((4, 63))}, "another skeleton"),
        ({"global_orient": np.zeros((3, 3))}, "another skeleton"),
        ({"transl": np.zeros((3, 3))}, "do not belong to"),
        ({"transl": np.full((4, 3), np.nan)}, "not finite"),
        ({"betas": np.full(10, 99.0)}, "outside"),
        ({"betas": "wide"}, "no array|not an array"),
        ({"transl": [[10**400, 0, 0]] * 4}, "not an array"),
        ({"transl": np.full((4, 3), 1j)}, "not an array"),
        ({"transl": [[1.0], [1.0, 2.0]]}, "not an array"),
    ],
)
def test_a_recording_that_does_not_fit_is_refused(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    path = written(tmp_path / "odd.pkl", {**recording(), **changes})
    with pytest.raises(InputError, match=told):
        RecordingAsItIs(path)


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no body_pose"):
        RecordingAsItIs(written(tmp_path / "odd.pkl", {"faces": 1}))
    with pytest.raises(InputError, match="not the dictionary"):
        RecordingAsItIs(written(tmp_path / "list.pkl", [1]))
    with pytest.raises(InputError, match="no motion file"):
        RecordingAsItIs(tmp_path / "absent.pkl")
    with pytest.raises(InputError, match="crop"):
        RecordingAsItIs(written(tmp_path / "a.pkl", recording()), crop=(2, 9))
    poses, translations = np.zeros((4, 156)), np.zeros((4, 3))
    np.savez(tmp_path / "slow.npz", poses=poses, trans=translations, betas=np.zeros(16), mocap_framerate=5)
    whole, body = RecordingAsItIs(written(tmp_path / "a.pkl", recording())), load_body("woman")
    assert isinstance(body, ShapedBody)
    with pytest.raises(InputError, match="30 frames per second"):
        whole.led_in(body, 60.0, 0)
    with pytest.raises(InputError, match="another skeleton"):
        whole.led_in(body, 30.0, 0)
    with pytest.raises(InputError, match="30 or more"):
        RecordingAsItIs(tmp_path / "slow.npz")
    with pytest.raises(InputError, match="another skeleton"):
        build_scene(Run(motion=written(tmp_path / "a.pkl", recording()), as_recorded=True))
    with pytest.raises(InputError, match="give its"):
        build_scene(Run(motion="walk", as_recorded=True))


@pytest.mark.parametrize(("rate", "step", "told"), [(120.0, 4, ""), (100.0, 3, "0.90"), (59.94, 1, "0.50")])
def test_amass_is_cropped_at_its_own_rate_and_told_where_it_plays_slower(
    tmp_path: Path, rate: float, step: int, told: str
) -> None:
    translations = np.arange(60.0).reshape(20, 3) * [1.0, 0.0, 0.0]
    np.savez(
        tmp_path / "a.npz", poses=np.zeros((20, 156)), trans=translations, betas=np.zeros(16), mocap_framerate=rate
    )
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        kept = read_smpl_sequence(tmp_path / "a.npz", (2, 15))
    np.testing.assert_array_equal(kept.translations[:, 0], translations[2:15:step, 0])
    assert [str(each.message).endswith(f"{told} times the recorded speed.") for each in heard] == (
        [True] if told else []
    )


def test_body_vertices_are_left_out_of_contact_by_file(tmp_path: Path) -> None:
    types = np.array([[1], [2], [1], [2]])
    np.testing.assert_array_equal(
        read_contact(written(tmp_path / "aux.pkl", {"vertex_type": types}), 4), [True, False, True, False]
    )
    (tmp_path / "list.txt").write_text("1, 3\n")
    np.testing.assert_array_equal(read_contact(tmp_path / "list.txt", 4), [True, False, True, False])
    with pytest.raises(InputError, match="does not have"):
        read_contact(tmp_path / "list.txt", 3)
    with pytest.raises(InputError, match="for each of the 5"):
        read_contact(tmp_path / "aux.pkl", 5)
    with pytest.raises(InputError, match="There is no file"):
        read_contact(tmp_path / "absent.pkl", 5)


@pytest.mark.parametrize(("case", "degrees"), [("as_recorded", 0.0), ("arms_separated", 20.0)])
@pytest.mark.parametrize("garment", ["garments_dict.pkl:dress", "garments_dict_skirt.pkl:skirt"])
def test_body_and_garment_are_where_the_released_code_puts_them(
    compat: Path, case: str, degrees: float, garment: str
) -> None:
    files, golden = compat / "files", np.load(compat / "golden/recording_frames.npz")
    scene = build_scene(
        Run(
            (WornGarment(f"{files}/{garment}"),),
            body=files / "SMPL_FEMALE.pkl",
            motion=files / "recording.pkl",
            as_recorded=True,
            arms_away=degrees,
            lead_in=0,
            omitted=files / "smpl_aux.pkl",
        )
    )
    body, worn = scene.colliders[0].positions(0, 8), scene.garments[0].placement.positions(0, 8)
    # Both are skinned in single precision, at a metre from the origin.
    assert np.abs(body.numpy() - golden[f"{case}/body"]).max() < 1e-6
    assert np.abs(worn.numpy() - golden[f"{case}/{garment.partition(':')[2]}"]).max() < 1e-6
    assert (~scene.colliders[0].contact).sum() == 61


@pytest.mark.parametrize(
    ("name", "led_in"),
    [
        ("recording.pkl", "recording_leadin.pkl"),
        ("recording_amass.npz", "recording_leadin.pkl"),
        ("recording_vto.pkl", "recording_from_vto.pkl"),
    ],
)
def test_the_released_lead_in_is_met(compat: Path, name: str, led_in: str) -> None:
    files = compat / "files"
    ours, theirs = RecordingAsItIs(files / name), RecordingAsItIs(files / led_in)
    body: Any = load_body(files / "SMPL_FEMALE.pkl", ours.shape)
    made, given = ours.led_in(body, 30.0, 5), theirs.led_in(body, 30.0, 0)
    assert len(made) == len(given) == 13
    np.testing.assert_allclose(angle_between(made.rotations, given.rotations), 0.0, atol=1e-7)
    np.testing.assert_allclose(made.root_positions, given.root_positions, atol=1e-12)
