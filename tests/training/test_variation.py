"""Varied cuts can be worn, uneven meshes are uneven, and both follow from their seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.errors import InputError
from pb4u.garment.cuts import CUTS
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.training import variation
from pb4u.training.collection import collect
from pb4u.training.configuration import DataSelection
from pb4u.training.variation import before_refining, cape, uneven, varied_cut, varied_garment


@pytest.fixture(scope="module")
def woman() -> ShapedBody:
    body = load_body("woman")
    assert isinstance(body, ShapedBody)
    return body


def _lengths(garment: Garment) -> np.ndarray:
    a, b = garment.vertices[garment.topology.edges.T]
    return np.linalg.norm(a - b, axis=1)


def test_cuts_differ_by_seed_and_keep_their_kind() -> None:
    for name, standard in CUTS.items():
        cuts = [varied_cut(standard, np.random.default_rng(seed)) for seed in (0, 0, *range(1, 30))]
        assert cuts[0] == cuts[1]
        assert len(set(cuts)) == 30
        assert {(cut.top, cut.hem, cut.legs, cut.loose, cut.sleeve > 0.0) for cut in cuts} == {
            (standard.top, standard.hem, standard.legs, standard.loose, standard.sleeve > 0.0)
        }
        hems = [cut.hem_offset for cut in cuts]
        assert max(hems) - min(hems) > 0.08, name
        if standard.top == "waist":
            assert {cut.ease[:2] for cut in cuts} == {standard.ease[:2]}


@pytest.mark.parametrize(
    "name", ["skirt", *(pytest.param(name, marks=pytest.mark.slow) for name in ("tanktop", "cardigan"))]
)
def test_a_varied_garment_is_another_one_in_one_piece(woman: ShapedBody, name: str) -> None:
    made = varied_garment(name, woman, 500, np.random.default_rng(4))
    standard = build_garment(name, woman, 500)
    assert made.topology.piece_of_vertex.max() == 0
    assert len(made.topology.boundary_loops) == len(standard.topology.boundary_loops)
    near = TriangleSurface(standard.faces, len(standard.vertices)).at(standard.vertices).nearest(made.vertices)
    assert np.linalg.norm(near.positions.numpy() - made.vertices, axis=1).max() > 0.01
    assert made.pinned.any() == standard.pinned.any()


@pytest.mark.slow
def test_a_cut_that_cannot_be_worn_is_left_for_the_standard_one(
    woman: ShapedBody, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without straps it is a tube, which nothing holds up.
    monkeypatch.setattr(variation, "varied_cut", lambda cut, rng: replace(cut, strap=0.003))
    made = varied_garment("tanktop", woman, 400, np.random.default_rng(0))
    assert np.array_equal(made.vertices, build_garment("tanktop", woman, 400).vertices)


def test_an_uneven_mesh_has_edges_of_two_sizes_off_the_skin(woman: ShapedBody) -> None:
    even = build_garment("skirt", woman, before_refining(900))
    made = uneven(even, woman, np.random.default_rng(1))
    assert 700 < made.triangle_count < 1100
    low, high = np.quantile(_lengths(made), (0.1, 0.9))
    narrow, wide = np.quantile(_lengths(even), (0.1, 0.9))
    assert high / low > 1.3 * wide / narrow
    # The waist is pinned all round, its new vertices too.
    waist = max(made.topology.boundary_loops, key=lambda loop: float(made.vertices[loop, 1].mean()))
    assert made.pinned[waist].all()
    assert made.pinned.sum() == len(waist)
    surface = TriangleSurface(woman.faces, len(woman.vertices)).at(woman.vertices)
    assert float(surface.nearest(made.vertices[~made.pinned]).signed_distance.min()) > 0.0


@pytest.mark.slow
def test_a_cape_hangs_down_the_back_from_pins_on_both_shoulders(woman: ShapedBody) -> None:
    made = cape(woman, 500, np.random.default_rng(2))
    mesh = made.topology
    assert mesh.piece_of_vertex.max() == 0
    assert len(mesh.boundary_loops) == 1
    pinned = made.vertices[made.pinned]
    assert (pinned[:, 0] > 0.05).any()
    assert (pinned[:, 0] < -0.05).any()
    assert pinned[:, 1].min() > np.quantile(woman.vertices[:, 1], 0.6)
    assert np.ptp(made.vertices[:, 1]) > 0.5
    # Nothing of it lies in front of the chest.
    low = made.vertices[:, 1] < pinned[:, 1].min() - 0.1
    assert made.vertices[low, 2].max() < woman.vertices[:, 2].max() - 0.05
    collected = collect(DataSelection(("cape",), (300,), ("woman",), 1, ("walk",), 1, 8, uneven=1.0))
    worn = collected.outfits[0].garment
    assert np.sign(worn.vertices[worn.pinned, 0]).min() == -1.0
    assert np.sign(worn.vertices[worn.pinned, 0]).max() == 1.0


@pytest.mark.slow
def test_collected_garments_are_the_same_again_and_unlike_each_other() -> None:
    selection = DataSelection(
        garments=("skirt",), triangles=(300, 400), bodies=("woman",), shapes=1, motions=("walk",), clips=1,
        clip_frames=8, varied=1.0, uneven=0.5,
    )  # fmt: skip
    first, again = collect(selection, seed=3), collect(selection, seed=3)
    for a, b in zip(first.outfits, again.outfits, strict=True):
        assert np.array_equal(a.garment.vertices, b.garment.vertices)
    heights = [float(np.ptp(outfit.garment.vertices[:, 1])) for outfit in first.outfits]
    assert abs(heights[0] - heights[1]) > 0.01


def test_shares_and_shapes_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="shares from 0 to 1"):
        DataSelection(varied=1.5)
    with pytest.raises(InputError, match="drawn_shapes must be"):
        DataSelection(drawn_shapes=(0.5, 0.2))
