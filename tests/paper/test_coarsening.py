"""HOOD's levels against their readable twin, and what they must be on any mesh."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, shortest_path
from tests.network_scenes import sheet, sheet_of
from tests.paper.readable_coarsening import coarser, eccentricity, edges_of, neighbours_of
from tests.paper.scenes import two_sheets

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.paper.baselines.coarsening import coarse_levels, graph_centres, hops_from, level_labels
from pb4u.paper.baselines.hood import LevelsByHops


def holed() -> Garment:
    """A sheet with two holes and a slit, so that ways lead round them."""
    whole = sheet(15, 13, seed=4)
    centres = whole.vertices[whole.faces].mean(axis=1)[:, [0, 2]]
    kept = np.linalg.norm(centres - [0.06, 0.05], axis=1) > 0.026
    kept &= np.linalg.norm(centres - [0.15, 0.12], axis=1) > 0.03
    return Garment("holed", whole.vertices, whole.faces[kept], whole.material)


def links(garment: Garment, edges: np.ndarray) -> csr_matrix:
    both = np.concatenate([edges, edges[:, ::-1]])
    return csr_matrix((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(len(garment.vertices),) * 2)


GARMENTS = {"sheet": sheet(14, 11), "holed": holed(), "two pieces": two_sheets(8, 9), "tiny": sheet(2, 2)}


@pytest.mark.parametrize("name", GARMENTS)
def test_levels_equal_the_readable_twin(name):
    garment = GARMENTS[name]
    edges = garment.topology.edges
    graph = neighbours_of(edges, len(garment.vertices))
    centres = graph_centres(links(garment, edges), garment.vertices)
    for level in coarse_levels(edges, garment.vertices, 3):
        graph = coarser(graph, centres)
        assert set(map(tuple, level.tolist())) == edges_of(graph)


@pytest.mark.parametrize("name", ["sheet", "holed", "two pieces"])
def test_the_centre_is_least_eccentric_of_every_piece(name):
    garment = GARMENTS[name]
    graph = neighbours_of(garment.topology.edges, len(garment.vertices))
    centres = graph_centres(links(garment, garment.topology.edges), garment.vertices)
    pieces = garment.topology.piece_of_vertex
    sized = [piece for piece in np.unique(pieces) if (pieces == piece).sum() > 1]
    assert [pieces[centre] for centre in centres] == sized
    for centre, piece in zip(centres, sized, strict=True):
        least = min(eccentricity(graph, vertex) for vertex in np.flatnonzero(pieces == piece).tolist())
        assert eccentricity(graph, centre) == least


def test_hops_are_those_of_a_shortest_path():
    garment = holed()
    graph = links(garment, garment.topology.edges)
    expected = shortest_path(graph, unweighted=True, indices=7)
    np.testing.assert_array_equal(hops_from(graph, 7), np.where(np.isfinite(expected), expected, -1))


def test_an_edge_of_a_level_spans_2_4_8_16_mesh_edges():
    garment = sheet(50, 46)
    edges = garment.topology.edges
    hops = shortest_path(links(garment, edges), unweighted=True)
    for number, level in enumerate(coarse_levels(edges, garment.vertices, 4)):
        spanned = hops[level[:, 0], level[:, 1]]
        assert spanned.max() == 2 ** (number + 1)
        # All but the repairs at rims and within rings span exactly as much.
        assert (spanned == 2 ** (number + 1)).mean() > 0.6


@pytest.mark.parametrize("name", ["sheet", "holed", "two pieces"])
def test_every_level_holds_fewer_vertices_and_keeps_pieces_whole(name):
    garment = GARMENTS[name]
    levels = coarse_levels(garment.topology.edges, garment.vertices, 3)
    labels = level_labels(levels, len(garment.vertices))
    pieces = garment.topology.piece_of_vertex
    before = len(garment.vertices)
    for number, level in enumerate(levels, start=1):
        present = np.unique(level)
        np.testing.assert_array_equal(present, np.flatnonzero(labels >= number))
        assert len(present) < 0.7 * before
        before = len(present)
        _, joined = connected_components(links(garment, level), directed=False)
        assert len(np.unique(joined[present])) == len(np.unique(pieces[present]))


def test_the_levels_of_38_000_triangles_take_seconds():
    garment = sheet_of(38000)
    levels = coarse_levels(garment.topology.edges, garment.vertices, 4)
    assert [len(level) > 1000 for level in levels] == [True] * 4


def test_levels_that_do_not_rise_are_refused():
    for near, far in ((1, 1), (-1, 1)):
        with pytest.raises(InputError):
            LevelsByHops(near, far)
