"""Cloth near itself and through itself: finders against their readable twins, and losses that push the right way."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.network_scenes import sheet
from tests.paper import readable_contours as readable
from tests.paper.scenes import dented, tree_of, two_sheets

from pb4u.garment.garment import Garment
from pb4u.paper.baselines.enclosures import by_contour
from pb4u.paper.baselines.intersection_contours import ContourFinder
from pb4u.paper.baselines.self_contact_edges import (
    ATTRACTION,
    REPULSION,
    ContourLength,
    Ramp,
    Repulsion,
    SelfContactLoss,
    SelfProximityEdges,
    own_proximity,
    squared_segment_lengths,
)
from pb4u.paper.baselines.self_proximity import SelfProximity, facing_pairs
from pb4u.scene.packed import PackedGarments, pack


def shaken() -> tuple[np.ndarray, np.ndarray]:
    """A sheet so shaken that it passes through itself in many places."""
    garment = sheet(6, 7, seed=3)
    shift = np.random.default_rng(0).normal(0.0, 0.014, garment.vertices.shape)
    return garment.vertices + shift, garment.faces


def dent() -> tuple[np.ndarray, np.ndarray]:
    garment = two_sheets(6, 7)
    return dented(garment, width=0.025), garment.faces


def edges_of(packed: PackedGarments) -> SelfProximityEdges:
    return SelfProximityEdges(own_proximity(packed), 0.03)


SHAPES = {"dent": dent, "shaken": shaken}


@pytest.mark.parametrize("shape", SHAPES)
def test_contours_equal_the_readable_twin(shape):
    vertices, faces = SHAPES[shape]()
    finder = ContourFinder(tree_of(vertices, faces))
    contours, edges = finder.find(vertices), finder.topology.edges
    expected = readable.crossings(vertices, faces, edges)
    assert len(expected) > 10
    assert list(zip(contours.edges.tolist(), contours.faces.tolist(), strict=True)) == expected
    segments = readable.segments(expected, faces, edges)
    assert {tuple(sorted(pair)) for pair in contours.segments.tolist()} == segments
    rings = readable.groups(len(expected), segments)
    labels = [frozenset(np.flatnonzero(contours.contour == label).tolist()) for label in range(contours.count)]
    assert set(labels) == set(map(frozenset, rings))
    inside = readable.enclosed(len(vertices), edges, expected, labels)
    enclosed = by_contour(contours, finder.topology).enclosed
    found = [set(enclosed[:, [label]].nonzero()[0].tolist()) for label in range(contours.count)]
    assert found == inside


def test_a_dent_makes_one_closed_contour_that_encloses_both_of_its_sides():
    garment = two_sheets()
    vertices = dented(garment)
    finder = ContourFinder(tree_of(vertices, garment.faces))
    contours = finder.find(vertices)
    assert contours.count == 1
    assert (np.bincount(contours.segments.reshape(-1)) == 2).all()
    enclosed = by_contour(contours, finder.topology).enclosed
    half = len(vertices) // 2
    lower, upper = enclosed[:half].getnnz(), enclosed[half:].getnnz()
    assert 0 < lower < half / 2
    through = vertices[half:, 1] < 1.0
    np.testing.assert_array_equal(enclosed[half:].toarray()[:, 0], through)
    assert upper == through.sum() > 0


def test_cloth_that_does_not_touch_itself_has_no_contours():
    garment = two_sheets()
    finder = ContourFinder(tree_of(garment.vertices, garment.faces))
    contours = finder.find(garment.vertices)
    enclosures = by_contour(contours, finder.topology)
    assert (contours.count, len(contours.segments), enclosures.enclosed.getnnz()) == (0, 0, 0)


@pytest.mark.parametrize("shape", SHAPES)
def test_vertices_over_faces_equal_the_readable_twin(shape):
    vertices, faces = SHAPES[shape]()
    vertex, face, height = facing_pairs(vertices, tree_of(vertices, faces), 0.01)
    expected = readable.facing(vertices, faces, 0.01)
    assert len(expected) > 10
    assert set(zip(vertex.tolist(), face.tolist(), strict=True)) == expected
    assert np.abs(height).max() <= 0.01


def test_who_has_passed_through_is_attracted_and_everyone_else_repelled():
    garment = two_sheets()
    vertices = dented(garment)
    facing = SelfProximity(tree_of(garment.vertices, garment.faces), by_contour).find(vertices, 0.03)
    half, through = len(vertices) // 2, vertices[:, 1] < 1.0
    of_upper = facing.vertices >= half
    np.testing.assert_array_equal(facing.passed[of_upper], through[facing.vertices[of_upper]])
    assert 0 < facing.passed.sum() < len(facing.vertices)
    edges = edges_of(pack([garment])).find(torch.as_tensor(vertices))
    for pairs in (edges[REPULSION].numpy(), edges[ATTRACTION].numpy()):
        assert len(pairs) == len(np.unique(pairs, axis=0)) > 0
        assert ((pairs[:, 0] < half) & (pairs[:, 1] >= half)).all()


def test_garments_of_a_pack_are_not_near_each_other():
    lower = two_sheets()
    upper = Garment("upper", lower.vertices + [0.0, 0.004, 0.0], lower.faces, lower.material)
    together = edges_of(pack([lower, upper])).find(torch.as_tensor(np.concatenate([lower.vertices, upper.vertices])))
    alone = edges_of(pack([lower])).find(torch.as_tensor(lower.vertices))
    count = len(lower.vertices)
    expected = np.concatenate([alone[REPULSION].numpy(), alone[REPULSION].numpy() + count])
    np.testing.assert_array_equal(together[REPULSION].numpy(), expected)


def test_what_is_not_finite_meets_nothing() -> None:
    """And changes nothing about the rest."""
    vertices, faces = dent()
    tree = tree_of(vertices, faces)
    whole, near = ContourFinder(tree).find(vertices), facing_pairs(vertices, tree, 0.03)[:2]
    lost = vertices.copy()
    lost[3], lost[5] = np.nan, np.inf
    with np.errstate(all="raise"):
        contours = ContourFinder(tree).find(lost)
        vertex, face, _ = facing_pairs(lost, tree, 0.03)
    ends = ContourFinder(tree).topology.edges[whole.edges]
    apart = ~np.isin(ends, [3, 5]).any(axis=1) & ~np.isin(faces[whole.faces], [3, 5]).any(axis=1)
    assert apart.sum() > 0
    np.testing.assert_array_equal(contours.faces, whole.faces[apart])
    apart = ~np.isin(near[0], [3, 5]) & ~np.isin(faces[near[1]], [3, 5]).any(axis=1)
    assert 0 < apart.sum() < len(apart)
    np.testing.assert_array_equal(np.stack([vertex, face]), np.stack(near)[:, apart])


def test_cloth_that_has_collapsed_is_given_up() -> None:
    """All at one point: each of some 18,000 faces is near each, a search that would take all memory."""
    garment = sheet(96, 97)
    tree, heap = tree_of(garment.vertices, garment.faces), np.zeros_like(garment.vertices)
    assert len(facing_pairs(heap, tree, 0.03)[0]) == 0
    assert ContourFinder(tree).find(heap).count == 0


@pytest.mark.parametrize("depth", [0.01, 0.012, 0.014])
def test_the_contour_loss_falls_as_a_dent_is_pulled_out_and_its_gradient_says_so(depth):
    garment = two_sheets()
    finder = ContourFinder(tree_of(garment.vertices, garment.faces))
    by = 1e-5
    here, less = (torch.as_tensor(dented(garment, depth=d)).requires_grad_(True) for d in (depth, depth - by))
    length = squared_segment_lengths(finder, here)[0].sum()
    (gradient,) = torch.autograd.grad(length, here)
    told = float((gradient * (less - here) / by).sum().detach())
    measured = float((squared_segment_lengths(finder, less)[0].sum() - length).detach()) / by
    assert told < 0.0
    # The ends of the edges count as fixed, which leaves out how they move up with the dent.
    assert told == pytest.approx(measured, rel=0.1)


def test_repulsion_counts_what_comes_within_3_mm_of_the_side_it_was_on():
    garment = two_sheets(gap=0.005)
    packed = pack([garment])
    before = torch.as_tensor(garment.vertices)
    half = len(before) // 2
    loss = SelfContactLoss(Repulsion(weight=Ramp(0.2, 0.6, 8.0)), packed, own_proximity(packed))

    def at(gap: float, progress: float = 1.0) -> torch.Tensor:
        after = before.clone()
        after[half:, 1] = 1.0 + gap
        return loss.energies(before, after.requires_grad_(True), progress)[0]

    assert float(at(0.0031).detach()) == 0.0
    # Every vertex of one sheet over a face of the other, once each way, at the same depth.
    facing = own_proximity(packed).find(garment.vertices, 0.01)
    area = packed.vertex_areas[torch.as_tensor(facing.vertices)].sum()
    for gap in (0.002, -0.001):
        torch.testing.assert_close(at(gap), 8.0 * area / 1.6e-4 * (0.003 - gap) ** 3)
    torch.testing.assert_close(at(0.001, progress=0.4), 0.5 * at(0.001))
    assert float(at(0.001, progress=0.1).detach()) == 0.0


def test_losses_are_given_garment_by_garment():
    still, through = two_sheets(), two_sheets(9, 10)
    after = torch.as_tensor(np.concatenate([still.vertices, dented(through)]))
    before = torch.as_tensor(np.concatenate([still.vertices, through.vertices]))
    packed = pack([still, through])
    proximity = own_proximity(packed)
    for loss in (SelfContactLoss(kind, packed, proximity) for kind in (ContourLength(), Repulsion())):
        energies = loss.energies(before, after, 1.0)
        assert energies.shape == (2,)
        assert float(energies[0]) == 0.0 < float(energies[1])
        torch.testing.assert_close(loss.energies(before, after, 0.0), torch.zeros(2, dtype=torch.float64))
