import numpy as np
import pytest
import torch
from cloth_shapes import tube_garment

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.library import load_body
from pb4u.body.skeleton import PoseSequence
from pb4u.garment.dressing import AttachedPlacement, SkinnedPlacement
from pb4u.garment.weight_cache import garment_weights
from pb4u.garment.weight_transfer import INFLUENCES, borrow_weights
from pb4u.geometry.rotation import from_axis_angle, matrix_from_quaternion, multiply
from pb4u.geometry.triangle_mesh import edge_lengths
from pb4u.io.cache_folder import cache_folder


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


@pytest.fixture(scope="module")
def skirt():
    """A wide tube from the waist to the shins."""
    return tube_garment(low=0.25, high=1.05, radius=0.26, around=60, rows=40)


@pytest.fixture(scope="module")
def small():
    """The same with few vertices."""
    return tube_garment(low=0.25, high=1.05, radius=0.26, around=24, rows=10)


def posed(body, turns, frames=2, fps=30.0):
    """Frame 0 at rest; in the others the bones under each name are turned by a rotation vector."""
    skeleton = body.skeleton
    rotations = np.tile([1.0, 0, 0, 0], (frames, skeleton.bone_count, 1))
    for name, vector in turns.items():
        for bone in range(skeleton.bone_count):
            ancestor = bone
            while ancestor >= 0 and skeleton.names[ancestor] != name:
                ancestor = int(skeleton.parents[ancestor])
            if ancestor >= 0:
                rotations[1:, bone] = multiply(from_axis_angle(np.array(vector)), rotations[1:, bone])
    return body.posed(PoseSequence(rotations, np.tile(skeleton.joints[0], (frames, 1)), fps))


@pytest.fixture(scope="module")
def weights(woman, skirt):
    return borrow_weights(skirt, woman)


def test_weights_are_few_and_sum_to_one(weights, skirt):
    assert weights.bones.shape == weights.weights.shape == (len(skirt.vertices), INFLUENCES)
    assert weights.weights.min() >= 0.0
    np.testing.assert_allclose(weights.weights.sum(axis=1), 1.0, atol=1e-5)


def test_the_rest_pose_is_where_the_garment_was_made(woman, small):
    placed = SkinnedPlacement(small, posed(woman, {})).positions(0, 2)
    assert placed.dtype == torch.float32
    np.testing.assert_allclose(placed[1].numpy(), small.vertices, atol=1e-5)


def test_a_rigid_motion_carries_the_garment_rigidly(woman, small):
    turn = from_axis_angle(np.array([0.0, 1.2, 0.0]))
    bones = woman.skeleton.bone_count
    poses = PoseSequence(
        np.tile(turn, (70, bones, 1)), np.tile(woman.skeleton.joints[0] + np.array([1.0, 0, 2.0]), (70, 1)), 30.0
    )
    placed = SkinnedPlacement(small, woman.posed(poses)).positions(65, 70)
    assert placed.shape == (5, len(small.vertices), 3)
    root = woman.skeleton.joints[0]
    rotation = matrix_from_quaternion(torch.from_numpy(turn)).numpy()
    expected = (small.vertices - root) @ rotation.T + root + np.array([1.0, 0, 2.0])
    np.testing.assert_allclose(placed[2].numpy(), expected, atol=1e-4)


def test_a_skirt_does_not_tear_between_the_legs(woman, skirt, weights):
    stride = posed(woman, {"upperleg01.L": (-0.5, 0, 0), "upperleg01.R": (0.5, 0, 0)})
    placed = SkinnedPlacement(skirt, stride, weights).positions(1, 2)[0].numpy()
    stretch = edge_lengths(placed, skirt.topology.edges) / skirt.edge_lengths
    # The feet are 1.1 m apart: weights of the nearest skin alone put that into single edges, 13 times their length.
    assert stretch.max() < 4.0
    assert np.percentile(stretch, 99) < 2.5


def test_cloth_does_not_follow_the_hands(woman, weights):
    hands = [k for k, name in enumerate(woman.skeleton.names) if "finger" in name or "wrist" in name]
    assert weights.weights[np.isin(weights.bones, hands)].sum() < 1e-6


def test_dressing_again_reads_the_cache_and_a_damaged_cache_is_rebuilt(woman, small, monkeypatch):
    first = garment_weights(small, woman)
    (stored,) = (cache_folder() / "skinning").iterdir()
    with monkeypatch.context() as broken:
        broken.setattr("pb4u.garment.weight_transfer.borrow_weights", lambda *_: pytest.fail("the cache was not read"))
        again = garment_weights(small, woman)
    np.testing.assert_array_equal(again.bones, first.bones)
    np.testing.assert_array_equal(again.weights, first.weights)
    for damage in (stored.read_bytes()[:1000], b"", b"no archive"):
        stored.write_bytes(damage)
        np.testing.assert_array_equal(garment_weights(small, woman).weights, first.weights)
    other = tube_garment(low=0.25, high=1.05, radius=0.27, around=24, rows=10)
    garment_weights(other, woman)
    assert len(list((cache_folder() / "skinning").iterdir())) == 2


def test_a_cache_that_cannot_be_written_is_done_without(woman, small, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert len(garment_weights(small, woman).weights) == len(small.vertices)


class Sequence(AnimatedBody):
    def __init__(self, body, frames):
        self.faces, self.contact = body.faces, body.contact
        self.rest_vertices = frames[0].numpy()
        self.fps, self.name, self.frames = 30.0, "sequence", frames

    @property
    def frame_count(self):
        return len(self.frames)

    def positions(self, start, stop):
        return self.frames[start:stop]


def test_a_body_without_bones_holds_the_garment_by_its_surface(woman, skirt):
    still = posed(woman, {"upperleg01.L": (-0.3, 0, 0)}).positions(0, 2)
    turn = matrix_from_quaternion(torch.from_numpy(from_axis_angle(np.array([0.3, 0.8, 0.0])))).float()
    shift = torch.tensor([0.5, 0.1, -2.0])
    frames = torch.stack([still[0], still[0] @ turn.T + shift, still[1]])
    placement = AttachedPlacement(skirt, Sequence(woman, frames))
    placed = placement.positions(0, 3)
    np.testing.assert_allclose(placed[0].numpy(), skirt.vertices, atol=5e-6)
    expected = torch.from_numpy(skirt.vertices).float() @ turn.T + shift
    np.testing.assert_allclose(placed[1].numpy(), expected.numpy(), atol=1e-4)
    raised = np.linalg.norm(placed[2].numpy() - skirt.vertices, axis=1)
    assert raised[skirt.vertices[:, 1] > 1.0].max() < 0.03
    assert raised.max() > 0.1
