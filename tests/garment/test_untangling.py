"""Cloth that has passed through itself is taken apart, or is said not to be: law, fixed vertices, smallest gap."""

from __future__ import annotations

import numpy as np
import pytest
from tests.network_scenes import sheet
from tests.paper import readable_contours as readable

from pb4u.collision.collision_free import SMALLEST_GAP
from pb4u.collision.crossings import piercings, self_crossings
from pb4u.collision.surface_tree import SurfaceTree
from pb4u.garment import untangling
from pb4u.garment.untangling import FARTHEST, untangle
from pb4u.geometry.topology import Topology


def layers(count: int, gap: float, side: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Sheets one over the other."""
    cloth = sheet(side, side, seed=1)
    vertices = np.concatenate([cloth.vertices + [0.0, gap * k, 0.0] for k in range(count)])
    return vertices, np.concatenate([cloth.faces + k * len(cloth.vertices) for k in range(count)])


def waved() -> tuple[np.ndarray, np.ndarray]:
    """Two sheets that pass through each other in the middle, both ways."""
    vertices, faces = layers(2, 4e-3)
    half = len(vertices) // 2
    middle = vertices[half:, [0, 2]].mean(axis=0)
    across = vertices[half:, [0, 2]] - middle
    vertices[half:] += [2.3e-3, 0.0, 3.1e-3]
    vertices[half:, 1] -= 0.02 * np.exp(-(across**2).sum(axis=1) / 0.03**2)
    return vertices, faces


def tipped() -> tuple[np.ndarray, np.ndarray]:
    """A sheet pushed edge on through another: its contour ends at a border."""
    vertices, faces = layers(2, 0.0)
    half = len(vertices) // 2
    upright = vertices[half:] - vertices[half:].mean(axis=0)
    vertices[half:] = vertices[:half].mean(axis=0) + upright[:, [1, 0, 2]] + [0.0, 0.045, 0.0]
    return vertices, faces


def shaken(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """One sheet that passes through itself in many places, neighbouring triangles too."""
    cloth = sheet(9, 9, seed=3)
    return cloth.vertices + np.random.default_rng(seed).normal(0.0, 0.012, cloth.vertices.shape), cloth.faces


SHAPES = {"waved": waved, "tipped": tipped, "shaken": shaken}


def smallest_distance(vertices: np.ndarray, faces: np.ndarray) -> float:
    edges = Topology(faces, len(vertices)).edges
    tree = SurfaceTree(vertices, faces, edges, np.zeros(len(vertices), dtype=np.int64), [0])
    return float(tree.pairs(vertices, 2e-3).nearest(vertices)[0].min(initial=2e-3))


@pytest.mark.parametrize("shape", SHAPES)
def test_the_edges_that_pierce_faces_are_those_of_the_readable_twin(shape: str) -> None:
    vertices, faces = SHAPES[shape]()
    topology = Topology(faces, len(vertices))
    found = piercings(vertices, topology, self_crossings(vertices, faces, sharing=True))
    expected = readable.crossings(vertices, faces, topology.edges)
    assert len(expected) > 10
    assert list(zip(found.edges.tolist(), found.faces.tolist(), strict=True)) == expected
    ends = vertices[topology.edges[found.edges]]
    on_edge = ends[:, 0] + found.shares[:, None] * (ends[:, 1] - ends[:, 0])
    in_face = np.einsum("pk,pkd->pd", found.barycentric, vertices[faces[found.faces]])
    np.testing.assert_allclose(on_edge, in_face, atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_tangled_cloth_is_freed_and_keeps_a_gap(shape: str) -> None:
    vertices, faces = SHAPES[shape]()
    assert len(self_crossings(vertices, faces, sharing=True)) > 10
    freed = untangle(vertices, faces)
    assert freed.is_free
    assert not len(self_crossings(freed.vertices.astype(np.float32), faces, sharing=True))
    assert freed.gap >= SMALLEST_GAP
    assert min(smallest_distance(freed.vertices, faces), 2.0 * SMALLEST_GAP) == pytest.approx(freed.gap, rel=1e-3)
    assert np.linalg.norm(freed.vertices - vertices, axis=1).max() < 0.08
    edges = Topology(faces, len(vertices)).edges
    length = np.linalg.norm(np.diff(vertices[edges], axis=1), axis=2)
    ratio = np.linalg.norm(np.diff(freed.vertices[edges], axis=1), axis=2) / length
    assert 0.4 < np.quantile(ratio, 0.05) < np.quantile(ratio, 0.95) < 1.8


@pytest.mark.parametrize("seed", range(12))
def test_what_comes_back_is_free_or_says_what_crosses(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However much it was shaken, in however few passes: `is_free` is what the exact test finds of float32."""
    rng = np.random.default_rng(seed)
    vertices, faces = layers(int(rng.integers(1, 4)), 0.002, side=7)
    vertices = vertices + rng.normal(0.0, rng.choice([0.003, 0.02, 0.1]), vertices.shape)
    monkeypatch.setattr(untangling, "MOST_PASSES", int(rng.choice([0, 3, 200])))
    freed = untangle(vertices, faces)
    left = self_crossings(freed.vertices.astype(np.float32), faces, sharing=True)
    assert {tuple(pair) for pair in left.tolist()} == {tuple(pair) for pair in freed.crossings.tolist()}
    assert freed.is_free == (len(left) == 0)
    assert (freed.gap == 0.0) == (len(left) > 0)
    assert np.linalg.norm(freed.vertices - vertices, axis=1).max() <= FARTHEST + 1e-6


def test_cloth_that_crosses_nowhere_comes_back_as_it_was() -> None:
    vertices, faces = layers(3, 4e-3)
    freed = untangle(vertices, faces)
    np.testing.assert_array_equal(freed.vertices, vertices.astype(np.float32))
    assert (freed.is_free, freed.passes) == (True, 0)


def test_cloth_too_near_is_brought_apart() -> None:
    vertices, faces = layers(3, 1e-5)
    freed = untangle(vertices, faces)
    assert freed.is_free
    assert freed.gap >= SMALLEST_GAP
    assert np.linalg.norm(freed.vertices - vertices, axis=1).max() < 1e-3


def test_fixed_vertices_stay_and_slow_ones_move_less() -> None:
    vertices, faces = waved()
    half = len(vertices) // 2
    mobility = np.concatenate([np.zeros(half), np.ones(half)])
    freed = untangle(vertices, faces, mobility)
    assert freed.is_free
    np.testing.assert_array_equal(freed.vertices[:half], vertices[:half].astype(np.float32))
    slow = untangle(vertices, faces, np.concatenate([np.full(half, 0.1), np.ones(half)]))
    way = np.linalg.norm(slow.vertices - vertices, axis=1)
    assert slow.is_free
    assert way[:half].sum() < 0.5 * way[half:].sum()


def test_what_is_fixed_altogether_is_said_to_cross_still() -> None:
    vertices, faces = waved()
    freed = untangle(vertices, faces, np.zeros(len(vertices)))
    assert not freed.is_free
    np.testing.assert_array_equal(freed.vertices, vertices.astype(np.float32))
