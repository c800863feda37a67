from pathlib import Path

import numpy as np
import pytest
import torch

from pb4u.body.baked_body import BakedBody, shape_basis
from pb4u.body.built_in import BUILT_IN
from pb4u.body.skeleton import PoseSequence
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.errors import InputError
from pb4u.geometry.rotation import from_axis_angle

# Positions that Anny 0.6.2 itself gives to a few vertices, at rest and in one pose, brought into this package's axes.
GOLDEN_ROWS = [0, 1900, 4000, 5200, 7000, 8200, 10200, 12800]
GOLDEN = {
    "woman": (
        {},
        [[-0.03498, 1.65901, 0.13806], [-0.50194, 1.01262, 0.26992], [0.0, 1.16592, -0.02142],
         [-0.0352, 1.57156, 0.13059], [0.04266, 1.72161, 0.11948], [0.05317, 1.42588, 0.09608],
         [0.45315, 1.06911, 0.18112], [0.1724, 0.08807, 0.06894]],
        [[0.22022, 1.73841, -0.08195], [-0.26052, 1.18986, 0.00446], [0.33563, 1.28316, -0.29909],
         [0.25423, 1.65786, -0.0743], [0.27063, 1.82434, -0.10112], [0.30157, 1.51783, -0.16105],
         [0.69692, 1.19507, -0.02005], [0.47667, 0.25476, -0.13675]],
    ),
    "man": (
        {"height": 0.8, "weight": 0.3, "muscle": 0.9},
        [[-0.04074, 2.10585, 0.1728], [-0.66216, 1.31442, 0.39594], [0.0, 1.50549, -0.06796],
         [-0.04174, 1.99809, 0.15937], [0.05006, 2.17681, 0.1518], [0.06201, 1.80453, 0.12634],
         [0.60134, 1.38143, 0.27682], [0.23763, 0.10583, 0.0795]],
        [[0.22103, 1.85739, -0.02641], [-0.42646, 1.20103, 0.13755], [0.33994, 1.32484, -0.34984],
         [0.26306, 1.75738, -0.02122], [0.2807, 1.9559, -0.04775], [0.30515, 1.57724, -0.12664],
         [0.84382, 1.19181, 0.10328], [0.53978, -0.02537, -0.09647]],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BUILT_IN)
def test_rest_surface_is_closed_outward_and_stands_on_the_ground(name: str) -> None:
    body = BakedBody.built_in(name).shaped()
    animated = body.posed(PoseSequence(np.tile([1.0, 0, 0, 0], (1, 104, 1)), body.skeleton.joints[:1], 30.0))
    assert body.vertices.shape == (13348, 3)
    assert body.faces.shape == (26692, 3)
    assert animated.is_closed
    assert animated.topology.is_consistently_oriented
    assert len(np.unique(animated.topology.piece_of_vertex)) == 1
    corners = body.vertices[body.faces]
    volume = np.einsum("fc,fc->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0.04 < volume < 0.12
    assert body.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-12)
    toes = body.skeleton.joints[body.skeleton.index("toe2-1.L")]
    heel = body.skeleton.joints[body.skeleton.index("foot.L")]
    assert toes[2] > heel[2] + 0.05, "it faces +Z"
    assert heel[0] > 0.05, "its left is +X"


@pytest.mark.parametrize("name", BUILT_IN)
def test_rest_and_posed_vertices_agree_with_anny(name: str) -> None:
    shape, rest, posed = GOLDEN[name]
    body = BakedBody.built_in(name).shaped(**shape)
    np.testing.assert_allclose(body.vertices[GOLDEN_ROWS], rest, atol=1e-4)
    rotations = from_axis_angle(np.random.default_rng(7).normal(size=(1, 104, 3)) * 0.25)
    moved = body.posed(PoseSequence(rotations, np.array([[0.3, 1.1, -0.2]]), 30.0)).positions(0, 1)
    np.testing.assert_allclose(moved[0, GOLDEN_ROWS], posed, atol=5e-4)


def test_height_of_the_defaults_and_the_effect_of_the_height_parameter() -> None:
    woman = BakedBody.built_in("woman")
    assert woman.shaped().height == pytest.approx(1.769, abs=1e-3)
    assert BakedBody.built_in("man").shaped().height == pytest.approx(1.908, abs=1e-3)
    low, middle, high = (woman.shaped(height=h) for h in (0.3, 0.5, 0.7))
    # Anny is linear in height.
    assert high.height - middle.height == pytest.approx(middle.height - low.height, abs=1e-4)
    assert high.height > 1.95
    head = high.skeleton.index("head")
    assert high.skeleton.joints[head, 1] > middle.skeleton.joints[head, 1] + 0.15, "the skeleton follows"


def test_contact_leaves_out_fingers_and_the_mouth_and_little_else() -> None:
    body = BakedBody.built_in("woman").shaped()
    owner = np.array(body.skeleton.names)[body.weights.bones[:, 0]]
    beyond = np.array([name.startswith("finger") and "-1" not in name for name in body.skeleton.names])
    finger, palm = body.weights.share_of(beyond) > 0.5, np.char.startswith(owner, "metacarpal")
    assert not body.contact[finger].any()
    assert body.contact[palm].mean() > 0.95
    # A point beside a hand is inside the surface that contact sees only where it is inside the body.
    hand = body.vertices[finger | palm]
    beside = np.random.default_rng(0).uniform(hand.min(axis=0) - 0.1, hand.max(axis=0) + 0.1, (20_000, 3))
    whole = TriangleSurface(body.faces, len(body.vertices)).at(body.vertices).nearest(torch.from_numpy(beside))
    touched = TriangleSurface(body.faces, len(body.vertices), body.contact, capped=True).at(body.vertices)
    wrong = touched.nearest(torch.from_numpy(beside)).signed_distance[whole.signed_distance > 2e-3] < -2e-3
    assert not wrong.any()
    torso_and_limbs = np.isin(
        np.char.partition(owner, ".")[:, 0],
        ["spine05", "spine04", "spine03", "spine02", "upperarm01", "upperarm02", "upperleg01", "upperleg02"],
    )
    assert body.contact[torso_and_limbs].mean() > 0.995
    assert 500 < (~body.contact & (owner == "head")).sum() < 1500
    head_top = np.argmax(body.vertices[:, 1])
    assert body.contact[head_top]


def test_weights_are_sorted_sum_to_one_and_name_real_bones() -> None:
    body = BakedBody.built_in("man").shaped()
    np.testing.assert_allclose(body.weights.weights.sum(axis=1), 1.0, atol=1e-6)
    assert (np.diff(body.weights.weights, axis=1) <= 1e-6).all()
    assert body.weights.bones.min() >= 0
    assert body.weights.bones.max() < body.skeleton.bone_count
    assert (body.skeleton.parents[1:] < np.arange(1, 104)).all()
    assert body.skeleton.parents[0] == -1


def test_shape_basis_spans_functions_that_bend_at_the_default() -> None:
    terms = np.array([[0, 0], [1, 0], [0, 1], [0, 2], [1, 2]])
    np.testing.assert_allclose(shape_basis(np.array([0.2, -0.3]), terms), [1, 0.2, -0.3, 0, 0])
    np.testing.assert_allclose(shape_basis(np.array([-0.2, 0.3]), terms), [1, -0.2, 0.3, 0.3, -0.06])


def test_reading_needs_no_anny(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "anny", None)
    path = Path(sys.modules["pb4u.body.baked_body"].__file__ or "").parent / "data" / "woman.npz"
    BakedBody(path).shaped()
    assert path.stat().st_size < 2_000_000


@pytest.mark.parametrize("parameters", [{"heigth": 0.5}, {"height": 1.2}, {"height": float("nan")}])
def test_shape_parameters_that_do_not_fit_are_refused(parameters: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"height.*0 to 1"):
        BakedBody.built_in("woman").shaped(**parameters)


def test_files_that_are_no_baked_bodies_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", format_version=1, vertices=np.zeros((2, 3)))
    with pytest.raises(InputError, match="parameter_names"):
        BakedBody(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("nothing")
    with pytest.raises(InputError, match="not a readable"):
        BakedBody(tmp_path / "text.npz")
    source = Path(__file__).parents[2] / "src/pb4u/body/data/woman.npz"
    with np.load(source) as archive:
        members = dict(archive)
    np.savez(tmp_path / "newer.npz", **{**members, "format_version": np.int64(99)})
    with pytest.raises(InputError, match="format 99"):
        BakedBody(tmp_path / "newer.npz")
    for name, value, told in (
        ("weights", members["weights"][:, 0], "weights has the shape"),
        ("weights", 0 * members["weights"], "weights has negative or empty rows"),
        ("parameter_ranges", members["parameter_ranges"][0], "parameter_ranges has the shape"),
        ("parameter_ranges", members["parameter_ranges"][:, ::-1], "its parameters have no range"),
        ("parameter_names", np.array(["height"] * 3), "or no names of their own"),
        ("term_basis", members["term_basis"] + np.uint8(3), "other than 0, 1 and 2"),
        ("term_joints", np.nan * members["term_joints"], "term_joints is not finite"),
        ("faces", np.full((3, 3), 13348), "faces has indices beyond its 13348 vertices"),
        ("weight_bones", members["weight_bones"] + np.uint8(100), "weight_bones has indices beyond its 104 bones"),
        ("bone_parents", members["bone_parents"][::-1], "a bone comes before its parent"),
        ("term_vertices", members["term_vertices"].astype(complex), "term_vertices holds complex128"),
    ):
        np.savez(tmp_path / "odd.npz", **{**members, name: value})
        with pytest.raises(InputError, match=told):
            BakedBody(tmp_path / "odd.npz")
    np.savez(tmp_path / "far.npz", **{**members, "term_joints": 1e300 * members["term_joints"]})
    with pytest.raises(InputError, match="over 10000 m away"):
        BakedBody(tmp_path / "far.npz").shaped()
