"""The training pack: exact, whole or refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.training.ball_data import ball_data

from pb4u.body.library import load_body
from pb4u.body.skinning import bone_transforms
from pb4u.errors import InputError
from pb4u.motion.library import load_motion
from pb4u.training.packed_data import load_training_data, rounded_poses, save_training_data


def test_a_pack_gives_back_exactly_what_was_packed(tmp_path: Path) -> None:
    data = ball_data()
    levels = (np.array([[0, 2], [2, 4]]), np.array([[0, 4]]))
    first = replace(data.outfits[0], garment=replace(data.outfits[0].garment, coarse_edges=levels))
    data = replace(data, outfits=(first, *data.outfits[1:]))
    save_training_data(replace(data, bodies=data.bodies), tmp_path / "pack.npz")
    again = load_training_data(tmp_path / "pack.npz")
    for a, b in zip(data.outfits, again.outfits, strict=True):
        assert np.array_equal(a.garment.vertices, b.garment.vertices)
        assert np.array_equal(a.garment.faces, b.garment.faces)
        assert np.array_equal(a.weights.weights, b.weights.weights)
        assert len(a.garment.coarse_edges) == len(b.garment.coarse_edges)
        assert all(map(np.array_equal, a.garment.coarse_edges, b.garment.coarse_edges))
        assert (a.body, a.garment.name, a.garment.material) == (b.body, b.garment.name, b.garment.material)
    for c, d in zip(data.clips, again.clips, strict=True):
        assert np.array_equal(c.poses.rotations, d.poses.rotations)
        assert np.array_equal(c.poses.root_positions, d.poses.root_positions)
        assert (c.name, c.split, c.body, c.poses.fps) == (d.name, d.split, d.body, d.poses.fps)
    assert np.array_equal(data.bodies[0].vertices, again.bodies[0].vertices)
    assert [p.name for p in tmp_path.iterdir()] == ["pack.npz"]


def test_rounding_poses_moves_no_joint_by_more_than_a_twentieth_of_a_millimetre() -> None:
    body = load_body("woman")
    poses = load_motion("dance", seed=3).poses(body, 30.0, 20)
    exact, rounded = (bone_transforms(body.skeleton, p) for p in (poses, rounded_poses(poses)))
    hands = np.append(body.skeleton.joints[body.skeleton.index("wrist.L")], 1.0).astype(np.float32)
    moved = np.abs((exact - rounded).numpy() @ hands)
    assert 0.0 < moved.max() < 5e-5


def test_damaged_and_foreign_packs_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "pack.npz"
    with pytest.raises(InputError, match="no training pack"):
        load_training_data(path)
    save_training_data(ball_data(), path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="not a readable"):
        load_training_data(path)
    np.savez(path, foreign=np.zeros(3))
    with pytest.raises(InputError, match="not a complete training pack"):
        load_training_data(path)
    with pytest.raises(InputError, match="Cannot write"):
        save_training_data(ball_data(), tmp_path / "absent" / "pack.npz")


def test_flipped_bits_are_refused_in_a_sentence_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "pack.npz"
    save_training_data(ball_data(), path)
    content = path.read_bytes()
    refused = 0
    for place in np.linspace(40, len(content) - 40, 60).astype(int).tolist():
        path.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            load_training_data(path)
        except InputError:
            refused += 1
    assert refused > 30


def test_a_body_with_nothing_to_do_is_refused() -> None:
    data = ball_data()
    with pytest.raises(InputError, match="no motion to train on"):
        replace(data, clips=data.clips[2:])
