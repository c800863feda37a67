"""Coarse cloth on a ball: corners outside are not enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from ball_scene import ball_scene
from test_pierced_edges import pierced

from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.geometry.triangle_mesh import area_weighted_normals
from pb4u.physics.contact.penetration_cleanup import FaceClearance
from pb4u.physics.contact.penetration_loops import cut_back
from pb4u.physics.contact.skin_cover import SkinCover
from pb4u.scene.state import State
from pb4u.simulation.timeline import Timeline


def sheet_wrapped_round_the_ball() -> tuple[Timeline, State]:
    """Every vertex of the sheet 0.5 mm outside the ball, so that edges cut into it."""
    timeline = Timeline.of(ball_scene(cells=10))
    centre = torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64)
    x = timeline.skinned(0) - centre
    flat = x.clone()
    flat[:, 1] = 0.0
    angle = flat.norm(dim=1, keepdim=True) / 0.2
    around = torch.cos(angle) * torch.tensor([[0.0, 1.0, 0.0]], dtype=x.dtype) + torch.sin(
        angle
    ) * torch.nn.functional.normalize(flat, dim=1)
    return timeline, State(centre + 0.2005 * around, torch.zeros_like(x), 0)


def deepest_middle(timeline: Timeline, state: State) -> float:
    middles = state.positions[timeline.garments.faces].mean(1)
    surface = timeline.pose(0).surfaces[0]
    assert surface is not None
    return float(surface.nearest(middles).signed_distance.min())


def test_faces_that_cut_into_the_body_are_lifted_out_of_it() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    assert deepest_middle(timeline, state) < -1e-3
    lifted = FaceClearance(passes=4).lift(timeline.garments, state, timeline.pose(0), None)
    assert deepest_middle(timeline, lifted) > -1e-4
    moved = (lifted.positions - state.positions).norm(dim=1)
    assert float(moved.max()) < 4 * 5e-3
    torch.testing.assert_close(lifted.velocities, state.velocities)


def skin_that_shows(timeline: Timeline, state: State, body: np.ndarray) -> int:
    surface = TriangleSurface(timeline.garments.faces.numpy(), timeline.garments.vertex_count).at(state.positions)
    return int(SkinCover.at(body, area_weighted_normals(body, timeline.colliders.faces.numpy()), surface).shown.sum())


def test_skin_between_the_middles_of_faces_is_covered() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    clear = FaceClearance(passes=4).lift(timeline.garments, state, timeline.pose(0), None)
    centre = np.array([0.0, 0.5, 0.0])
    body = timeline.body(0).numpy().copy()
    # Pimples of 8 mm, which the middles of the cloth's elements know nothing of.
    near = np.flatnonzero(body[:, 1] > 0.65)[::5]
    body[near] += 0.008 * (body[near] - centre) / 0.2
    pose = timeline.colliders.pose(torch.from_numpy(body))
    assert skin_that_shows(timeline, clear, body) > 3
    lifted = FaceClearance().lift(timeline.garments, clear, pose, None)
    assert skin_that_shows(timeline, lifted, body) == 0
    assert float((lifted.positions - clear.positions).norm(dim=1).max()) < 0.02


def readable_lift(timeline: Timeline, x: np.ndarray, body: np.ndarray, passes: int) -> np.ndarray:
    """Positions (vertices, 3) [m] after some passes, everything looked at anew in each."""
    garments, clearance = timeline.garments, FaceClearance().clearance
    faces, sag = garments.faces.numpy(), garments.vertex_edge_lengths.numpy() ** 2 / (32.0 * 0.03)
    elements = [np.arange(len(x))[:, None], garments.edges.numpy(), faces]
    surface, cloth = timeline.colliders.pose(torch.from_numpy(body)).surfaces[0], TriangleSurface(faces, len(x))
    assert surface is not None
    places, normals = body, area_weighted_normals(body, timeline.colliders.faces.numpy())
    x = x.copy()
    for _ in range(passes):
        direction, size = np.zeros_like(x), np.zeros(len(x))
        lifts = []
        for kind, corners in enumerate(elements):
            near = surface.nearest(x[corners].mean(axis=1))
            gap = clearance + (sag[corners[:, 0]] if kind else 0.0) - near.signed_distance.numpy()
            low = (gap > 0.0) & ~near.beyond_border.numpy()
            elements[kind] = corners[low]
            lifts.append((corners[low], np.full(corners[low].shape, 1.0 / (kind + 1)), gap[low], near.normals[low]))
        cover = SkinCover.at(places, normals, cloth.at(x))
        near_cloth = cover.distances < 0.02
        low = cover.belongs & near_cloth & (cover.heights < clearance)
        lifts.append((faces[cover.faces[low]], cover.barycentric[low], clearance - cover.heights[low], normals[low]))
        places, normals = places[near_cloth], normals[near_cloth]
        for corners, shares, gap, along in lifts:
            moves = gap[:, None] * shares / (shares**2).sum(axis=1, keepdims=True)
            np.maximum.at(size, corners, moves)
            np.add.at(direction, corners, moves[:, :, None] * np.asarray(along)[:, None, :])
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        x += np.minimum(size, 5e-3)[:, None] * direction / np.maximum(length, 1e-300)
    return x


def test_passes_that_remember_what_they_found_lift_as_passes_that_look_at_everything() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    body, centre = timeline.body(0).numpy().copy(), np.array([0.0, 0.5, 0.0])
    near = np.flatnonzero(body[:, 1] > 0.65)[::5]
    body[near] += 0.008 * (body[near] - centre) / 0.2
    pose, x = timeline.colliders.pose(torch.from_numpy(body)), state.positions.numpy()
    for passes in (1, 2, 5):
        clean_up = FaceClearance(passes=passes, most_stretch=9.0)
        expected = readable_lift(timeline, x, body, passes)
        assert np.abs(expected - x).max() > 1e-3
        found = clean_up.lift(timeline.garments, state, pose, None).positions.numpy()
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_vertex_inside_is_lifted_out_though_the_middles_around_it_are_clear() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    centre = torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64)
    x = centre + 1.1 * (state.positions - centre)
    inside = int((x - centre)[:, 1].argmax())
    x[inside] = centre + 0.199 * (state.positions[inside] - centre) / 0.2005
    within = replace(state, positions=x)
    assert deepest_middle(timeline, within) > 5e-3
    lifted = FaceClearance().lift(timeline.garments, within, timeline.pose(0), None)
    assert float((lifted.positions[inside] - centre).norm()) > 0.1999


def test_cloth_that_is_clear_stays_where_it_is() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    away = replace(state, positions=state.positions + 1.0)
    torch.testing.assert_close(
        FaceClearance().lift(timeline.garments, away, timeline.pose(0), None).positions, away.positions
    )


def test_pins_do_not_move() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    pinned = torch.from_numpy(np.arange(timeline.garments.vertex_count) % 2 == 0)
    garments = replace(timeline.garments, pinned=pinned)
    lifted = FaceClearance().lift(garments, state, timeline.pose(0), None)
    assert torch.equal(lifted.positions[pinned], state.positions[pinned])
    assert not torch.equal(lifted.positions, state.positions)


def test_skin_that_only_torn_cloth_would_cover_stays_bare() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    clear = FaceClearance(passes=4).lift(timeline.garments, state, timeline.pose(0), None)
    body = timeline.body(0).numpy().copy()
    # A thorn higher than an edge is long, the foot of which the cloth lies around.
    body[body[:, 1].argmax()] += [0.0, 0.019, 0.0]
    pose, edges = timeline.colliders.pose(torch.from_numpy(body)), timeline.garments.edges

    def longest(state: State) -> float:
        a, b = state.positions[edges].unbind(1)
        return float(((a - b).norm(dim=1) / timeline.garments.edge_lengths).max())

    assert longest(clear) < 1.2
    most = 1.0 + 0.9 * (longest(FaceClearance(most_stretch=9.0).lift(timeline.garments, clear, pose, None)) - 1.0)
    assert most > longest(clear)
    assert longest(FaceClearance(most_stretch=most).lift(timeline.garments, clear, pose, None)) <= most


def test_what_a_cut_lift_would_tear_in_turn_is_cut_as_well() -> None:
    before = np.arange(14.0)[:, None] * np.array([1.0, 0.0, 0.0])
    lifted, edges = before * 20.0, np.stack([np.arange(13), np.arange(1, 14)], axis=1)
    shares = np.ones(14)
    shares[0] = 0.0
    x = cut_back(before, lifted, shares, edges, np.full(13, 1.8))
    assert float(np.linalg.norm(x[1:] - x[:-1], axis=1).max()) <= 1.8 + 1e-9
    assert np.array_equal(x[0], before[0])


def test_the_lift_takes_no_vertex_deeper_into_a_limb_that_is_through_the_cloth() -> None:
    step, x = pierced(0.0, 0.0)
    x[:, 0] += 0.01
    assert step.bodies is not None
    pose = step.bodies.following
    lifted = FaceClearance(most_stretch=9.0).lift(step.garments, replace(step.state, positions=x), pose, None).positions
    surface = pose.surfaces[0]
    assert surface is not None
    before, after = (surface.nearest(positions).signed_distance for positions in (x, lifted))
    assert float((after - before.clamp_max(0.0)).min()) > -1e-9
    assert not torch.equal(lifted, x)


class HalfTheWay:
    """Stops one vertex inside the ball, as cloth in a fold may."""

    feels_bodies = False

    def __init__(self, stopped: int, inside: torch.Tensor) -> None:
        self.stopped, self.inside = stopped, inside

    def collision_free_move(self, garments, before, wanted, cloth=None, held=None, obstacle=None):
        reached = wanted.clone()
        if not torch.equal(wanted[self.stopped], before[self.stopped]):
            reached[self.stopped] = self.inside
        return reached, obstacle


class PushedAside(HalfTheWay):
    """Pushes one vertex into the ball, as cloth that is lifted beside it may, unless it gives way to nothing."""

    def collision_free_move(self, garments, before, wanted, cloth=None, held=None, obstacle=None):
        reached = wanted.clone()
        if not held[self.stopped]:
            reached[self.stopped] = self.inside
        return reached, obstacle


@pytest.mark.parametrize("kind", [HalfTheWay, PushedAside])
def test_a_lift_that_cloth_ends_inside_the_body_is_not_made(kind: type[HalfTheWay]) -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    pose, centre = timeline.pose(0), torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64)
    free = FaceClearance(passes=4).lift(timeline.garments, state, pose, None).positions
    stopped = int((free - state.positions).norm(dim=1).argmax())
    held = kind(stopped, centre + 0.9 * (state.positions[stopped] - centre))
    lifted = FaceClearance(passes=4).lift(timeline.garments, state, pose, held).positions
    assert torch.equal(lifted[stopped], state.positions[stopped])
    others = torch.arange(len(free)) != stopped
    torch.testing.assert_close(lifted[others], free[others])
