"""Edges of self-contact of the released ContourCraft, on cloth of our own and against what its code computed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.paper.scenes import dented, tree_of, two_sheets
from tests.simulation.golden_scenes import GoldenScene, predicted

from pb4u.compat.released_weights import read_released
from pb4u.garment.garment import Garment
from pb4u.network.graph.builder import FoundEdges
from pb4u.network.graph.pins import SeenGarments
from pb4u.paper.baselines.directed_self_contact import DirectedProximityEdges
from pb4u.paper.baselines.enclosures import by_side
from pb4u.paper.baselines.intersection_contours import ContourFinder
from pb4u.paper.baselines.self_contact_edges import ATTRACTION, REPULSION
from pb4u.paper.baselines.self_proximity import facing_pairs
from pb4u.scene.packed import pack

Edges = dict[str, Counter]


def found(garments: list[Garment], positions: np.ndarray, targets: np.ndarray | None = None) -> Edges:
    packed = pack(garments, worlds=[0] * len(garments))
    at, pinned = torch.as_tensor(positions), packed.pinned[:, None]
    there = at if targets is None else torch.where(pinned, torch.as_tensor(targets), at)
    seen = SeenGarments(at, there, torch.zeros_like(at), there, pinned)
    edges = DirectedProximityEdges(packed, 0.03).found(seen)
    return {kind: _counted(of) for kind, of in edges.items()}


def _counted(edges: FoundEdges) -> Counter:
    assert edges.future is not None
    assert bool((edges.receivers.index.diff() >= 0).all())
    rows = zip(edges.senders.index.tolist(), edges.receivers.index.tolist(), edges.future[:, 0].tolist(), strict=True)
    return Counter(rows)


def test_every_face_below_a_vertex_gives_one_edge_to_its_nearest_corner() -> None:
    garment = two_sheets()
    edges = found([garment], garment.vertices)
    vertices, faces, _ = facing_pairs(garment.vertices, tree_of(garment.vertices, garment.faces), 0.03)
    expected: Counter = Counter()
    for vertex, face in zip(vertices.tolist(), faces.tolist(), strict=True):
        corners = garment.faces[face]
        away = [float(np.linalg.norm(garment.vertices[c] - garment.vertices[vertex])) for c in corners]
        expected[vertex, int(corners[int(np.argmin(away))]), 0.0] += 1
    assert edges[REPULSION] == expected
    assert expected
    assert not edges[ATTRACTION]


def test_two_garments_of_a_world_are_one_cloth() -> None:
    both = two_sheets()
    half, of_lower = len(both.vertices) // 2, len(both.faces) // 2
    lower = Garment("lower", both.vertices[:half], both.faces[:of_lower], both.material)
    upper = Garment("upper", both.vertices[half:], both.faces[of_lower:] - half, both.material)
    assert found([lower, upper], both.vertices) == found([both], both.vertices)


def test_pins_are_also_joined_to_where_they_will_be() -> None:
    garment = two_sheets(gap=0.05)
    half = len(garment.vertices) // 2
    pinned = np.zeros(len(garment.vertices), dtype=bool)
    pinned[half + 66] = True
    held = garment.with_pins(pinned)
    assert not found([held], held.vertices)[REPULSION], "too far apart now"
    there = held.vertices - [0.0, 0.045, 0.0]
    joined = found([held], held.vertices, there)[REPULSION]
    assert joined
    assert {(sender, future) for sender, _, future in joined} == {(half + 66, 1.0)}


def test_a_closed_side_encloses_what_has_passed_through_and_both_sides_do() -> None:
    garment = two_sheets()
    vertices = dented(garment)
    finder = ContourFinder(tree_of(garment.vertices, garment.faces))
    sides = by_side(finder.find(vertices), finder.topology)
    half = len(vertices) // 2
    assert sides.enclosed.shape[1] == 2
    assert not sides.at_open.any()
    enclosed = sides.enclosed.toarray()
    of_upper = int(enclosed[half:].any(axis=0).argmax())
    np.testing.assert_array_equal(enclosed[half:, of_upper], vertices[half:, 1] < 1.0)
    assert 0 < enclosed[:half, 1 - of_upper].sum() < half / 2
    edges = found([garment], vertices)
    attracted = {sender for sender, _, _ in edges[ATTRACTION]}
    assert attracted
    assert attracted <= set(np.flatnonzero(enclosed.any(axis=1)).tolist())
    # What is enclosed has no edge that repels.
    assert not {sender for sender, _, _ in edges[REPULSION]} & set(np.flatnonzero(enclosed.any(axis=1)).tolist())


def test_a_side_that_cuts_nothing_off_attracts_the_ends_of_its_crossing_edges() -> None:
    garment = two_sheets()
    vertices = garment.vertices.copy()
    half = len(vertices) // 2
    # A flap at the border of the upper sheet hangs through the lower one: neither is cut apart.
    flap = half + np.flatnonzero(vertices[half:, 0] < 0.03)
    vertices[flap, 1] -= 0.014
    finder = ContourFinder(tree_of(garment.vertices, garment.faces))
    contours = finder.find(vertices)
    sides = by_side(contours, finder.topology)
    assert contours.count >= 1
    assert sides.at_open.any()
    lower_open = sides.at_open[:half]
    assert lower_open.any(), "the lower sheet is pierced but not cut through"
    assert set(np.flatnonzero(sides.at_open)) <= set(np.unique(finder.topology.edges[contours.edges]))
    attracted = {sender for sender, _, _ in found([garment], vertices)[ATTRACTION]}
    assert set(np.flatnonzero(sides.at_open)) & attracted


@pytest.mark.parametrize(("case", "number"), [(0, 1), (1, 0)])
def test_the_edges_of_the_released_code_are_found(compat: Path, case: int, number: int) -> None:
    checkpoint = read_released(compat / "checkpoints/contourcraft.pth").checkpoint(torch.float64)
    golden = GoldenScene(compat / "golden/contourcraft_outfit.npz", case)
    graph, _, _ = predicted(checkpoint, golden.time_step(number))
    layout = checkpoint.model.network.configuration.layout
    future = [feature.name for feature in layout.columns("found_edge")].index("future_pinned")
    assert future == 6
    for kind in (REPULSION, ATTRACTION):
        edges = graph.edges[kind]
        ours = zip(
            edges.senders.index.tolist(), edges.receivers.index.tolist(), edges.features[:, 12].tolist(), strict=True
        )
        theirs = (*golden.value(number, f"{kind}_edge_index").tolist(), golden.value(number, f"{kind}_label").tolist())
        assert Counter(ours) == Counter(zip(*theirs, strict=True))


@pytest.mark.parametrize(("case", "number"), [(0, 0), (0, 1), (0, 2), (1, 0)])
def test_a_step_with_edges_found_alone_is_met(compat: Path, case: int, number: int) -> None:
    """In step 2 contours of single vertices touch: edges cross at two of them, and one crosses three times."""
    checkpoint = read_released(compat / "checkpoints/contourcraft.pth").checkpoint(torch.float64)
    golden = GoldenScene(compat / "golden/contourcraft_outfit.npz", case)
    _, acceleration, _ = predicted(checkpoint, golden.time_step(number))
    assert np.abs(acceleration.numpy() - golden.value(number, "pred_acceleration")).max() < 1e-9
