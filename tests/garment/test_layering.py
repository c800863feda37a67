"""Garments laid over each other in the order they are worn, and starts that cross nowhere or are refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cloth_shapes import tube_garment

from pb4u.body.library import load_body
from pb4u.collision.crossings import self_crossings
from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.errors import InputError
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment
from pb4u.garment.layering import LAYER_GAP, layered, worn_order
from pb4u.garment.library import build_garment
from pb4u.garment.tangles import untangled_start

PAIRS = (
    ("tanktop", "cardigan"), ("tshirt", "cardigan"), ("longsleeve", "cardigan"), ("tshirt", "skirt"),
    ("tshirt", "trousers"), ("trousers", "tshirt"), ("skirt", "longsleeve"), ("trousers", "skirt"),
    ("longsleeve", "fitted_dress"),
)  # fmt: skip
"""The nine pairs that people wear: under and over a waistband, sleeves in sleeves, a skirt over trousers."""


@cache
def rest_of(body: str) -> RestBody:
    return RestBody.of(load_body(body))


@cache
def cut_for(body: str, name: str) -> Garment:
    return build_garment(name, load_body(body), 1200)


def joined(places: tuple[np.ndarray, ...], garments: list[Garment]) -> tuple[np.ndarray, np.ndarray]:
    firsts = np.cumsum([0, *(len(x) for x in places[:-1])])
    return np.concatenate(places), np.concatenate([g.faces + k for g, k in zip(garments, firsts, strict=True)])


def beneath(outer: np.ndarray, inner: np.ndarray, garment: Garment) -> np.ndarray:
    """Vertices of the outer garment under the cloth of the inner one."""
    near = TriangleSurface(garment.faces, len(inner)).at(inner).nearest(outer)
    return ((near.signed_distance < 0.0) & ~near.beyond_border).numpy()


@pytest.mark.parametrize(
    ("names", "wearer"),
    [
        pytest.param(names, wearer, marks=[pytest.mark.slow] if (k + number) % 2 else [])
        for k, names in enumerate(PAIRS)
        for number, wearer in enumerate(("woman", "man"))
    ],
)
def test_pairs_of_built_in_garments_are_laid_over_each_other(names: tuple[str, str], wearer: str) -> None:
    body, garments = rest_of(wearer), [cut_for(wearer, name) for name in names]
    places = layered(garments, body)
    assert not len(self_crossings(*joined(places, garments), sharing=True))
    assert beneath(places[1], places[0], garments[0]).sum() <= 2
    assert body.signed_distances(np.concatenate(places)).min() > -0.003
    for place, garment in zip(places, garments, strict=True):
        assert np.linalg.norm(place - garment.vertices, axis=1).max() < 0.11
    start = untangled_start(garments, np.concatenate(places))
    assert np.abs(start - np.concatenate(places)).max() < 2e-3


def tubes(radii: tuple[float, ...]) -> list[Garment]:
    """Tubes around the legs, of one place in height and different meshes."""
    made = [
        tube_garment(low=0.3 + 0.01 * k, high=0.7, radius=radius, around=36 + 5 * k, rows=12 + k)
        for k, radius in enumerate(radii)
    ]
    return [replace(tube, name=f"tube {k}") for k, tube in enumerate(made)]


@pytest.mark.parametrize("radii", [(0.25, 0.25), (0.27, 0.25), (0.25, 0.25, 0.25), (0.28, 0.24, 0.26, 0.25)])
def test_the_order_decides_who_is_over_whom(radii: tuple[float, ...]) -> None:
    garments = tubes(radii)
    places = layered(garments, RestBody.of(load_body("woman")))
    assert not len(self_crossings(*joined(places, garments), sharing=True))
    rings = [np.linalg.norm(place[:, [0, 2]], axis=1).mean() for place in places]
    assert (np.diff(rings) > 0.8 * LAYER_GAP).all()
    for garment, place in zip(garments, places, strict=True):
        assert np.ptp(place[:, 1] - garment.vertices[:, 1]) < 0.02


def test_what_is_tucked_in_goes_beneath_what_is_worn_from_the_waist() -> None:
    shirt = replace(tube_garment(low=0.8, high=1.4), name="shirt")
    trousers, coat = (replace(tube_garment(low=low, high=high), name="x") for low, high in ((0.1, 1.0), (0.6, 1.42)))
    assert worn_order([trousers, shirt, coat], [False, False, False]) == [0, 1, 2]
    assert worn_order([trousers, shirt, coat], [False, True, False]) == [1, 0, 2]
    assert worn_order([coat, trousers, shirt], [False, False, True]) == [0, 2, 1]
    assert worn_order([shirt, trousers, coat], [True, False, False]) == [0, 1, 2]
    with pytest.raises(InputError, match=r"^shirt .*tucked in"):
        worn_order([shirt, coat], [True, False])


def test_one_garment_is_where_it_was_made() -> None:
    (garment,) = tubes((0.25,))
    assert layered([garment], RestBody.of(load_body("woman")))[0] is garment.vertices


def test_an_outfit_that_cannot_be_parted_is_refused_by_name_count_and_place() -> None:
    """A wide dress does not go into trousers."""
    body = load_body("woman")
    garments = [build_garment(name, body, 600) for name in ("dress", "trousers")]
    with pytest.raises(InputError) as refusal:
        untangled_start(garments, np.concatenate(layered(garments, RestBody.of(body))))
    said = str(refusal.value)
    assert said.startswith("The starting position cannot be untangled: dress and trousers cross in ")
    assert "pairs of triangles around (" in said
    assert said.endswith("give the garments in another order, or simulate with --self-contact off.")


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 8))])
def test_a_start_crosses_nowhere_or_is_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    garments = tubes((0.25, 0.252))
    garments[0] = garments[0].with_pins(rng.random(len(garments[0].vertices)) < 0.05)
    positions = np.concatenate([garment.vertices for garment in garments])
    positions = positions + rng.normal(0.0, rng.choice([0.002, 0.01, 0.05]), positions.shape)
    faces = joined(tuple(garment.vertices for garment in garments), garments)[1]
    try:
        start = untangled_start(garments, positions)
    except InputError:
        return
    assert not len(self_crossings(start.astype(np.float32), faces, sharing=True))
    pinned = np.flatnonzero(garments[0].pinned)
    np.testing.assert_array_equal(start[pinned], positions[pinned].astype(np.float32))


def test_two_garments_of_one_name_are_told_apart() -> None:
    garments = [replace(tube, name="x") for tube in tubes((0.25, 0.25))]
    garments = [garment.with_pins(np.ones(len(garment.vertices), dtype=bool)) for garment in garments]
    garments[1] = replace(garments[1], vertices=garments[1].vertices + [0.1, 0.0, 0.0])
    with pytest.raises(InputError, match=r"x and x \(2\) cross in \d+ pairs"):
        untangled_start(garments, np.concatenate([garment.vertices for garment in garments]))


def test_a_garment_that_crosses_itself_by_its_pins_is_refused() -> None:
    (garment,) = tubes((0.25,))
    crossed = garment.vertices.copy()
    crossed[:, 0] *= np.where(crossed[:, 1] > 0.6, -1.0, 1.0)
    garment = garment.with_pins(np.ones(len(crossed), dtype=bool))
    with pytest.raises(InputError, match=r": tube 0 crosses itself in \d+ pairs"):
        untangled_start([garment], crossed)
