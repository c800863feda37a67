"""Contact response: out by at most 2 cm, never faster, far sides and left-out regions respected."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from tests.physics.shapes import DT, at_rest, capsule, collider, colliders, packed, sheet, time_step

from pb4u.physics.contact.contact_set import nearest_planes
from pb4u.scene.colliders import ColliderFrame
from pb4u.scene.packed import PackedGarments
from pb4u.scene.state import State
from pb4u.simulation.penetration_response import ContactResponse


def slab(
    thickness: float = 0.5,
    motion: tuple[float, float, float] = (0.0, 0.0, 0.0),
    top: float = 0.0,
) -> ColliderFrame:
    """A wide box whose top is at y = `top`, moving by `motion` [m] to where it is at the end of the step."""
    import trimesh

    box = trimesh.creation.box(extents=(4.0, thickness, 4.0))
    box.apply_translation([0.0, top - thickness / 2, 0.0])
    return collider(box.vertices - np.array(motion), box.faces, np.array(motion))


def lying(height: float, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[PackedGarments, State]:
    garments = packed(sheet(3, 3, 0.3, 0.3))
    x = garments.rest_positions[:, [0, 2, 1]].clone()
    x[:, 1] += height
    return garments, State(x, torch.tensor(velocity, dtype=torch.float64).expand_as(x).clone(), 1)


class Report(NamedTuple):
    """What a response did: vertices moved, the farthest [m], vertices and depth [m] left inside."""

    pushed: int
    largest_push: float
    left: int
    deepest: float


def answered(
    garments: PackedGarments,
    state: State,
    body: ColliderFrame,
    before: State | None = None,
    ground: float | None = None,
) -> tuple[State, Report]:
    """The response to `state` at the end of a step from `before`, by default the same positions, and its report."""
    response, step = ContactResponse(), time_step(garments, before or state, body, ground=ground)
    after = response.respond(step, state)
    moved = (after.positions - state.positions).norm(dim=1)
    depths = [response.depth(step, x.expand_as(after.positions)) for x in after.positions]
    return after, Report(int((moved > 0).sum()), float(moved.max()), sum(d > 1e-3 for d in depths), max(depths))


def test_out_to_the_clearance_without_gaining_speed() -> None:
    garments, state = lying(-3e-3, (0.4, -0.6, 0.1))
    after, report = answered(garments, state, slab())
    torch.testing.assert_close(after.positions[:, 1], torch.full((16,), 5e-4, dtype=torch.float64))
    torch.testing.assert_close(after.velocities, torch.tensor([0.4, 0.0, 0.1], dtype=torch.float64).expand(16, 3))
    assert (report.pushed, report.left, report.deepest) == (16, 0, 0.0)
    assert report.largest_push == pytest.approx(3.5e-3)


def test_only_the_inward_part_relative_to_the_body_is_removed() -> None:
    rising = slab(motion=(0.0, 0.02, 0.0))
    garments, state = lying(-1e-3, (0.3, 0.2, 0.0))
    after, _ = answered(garments, state, rising)
    assert after.velocities[0].tolist() == pytest.approx([0.3, 0.02 / DT, 0.0])
    leaving = replace(state, velocities=torch.full_like(state.velocities, 2.0))
    after, _ = answered(garments, leaving, rising)
    torch.testing.assert_close(after.velocities, leaving.velocities)


def test_a_push_is_at_most_two_centimetres_and_the_rest_is_reported() -> None:
    garments, state = lying(-0.05)
    after, report = answered(garments, state, slab())
    assert report.largest_push == pytest.approx(0.02)
    assert report.left == 16
    assert report.deepest == pytest.approx(0.03)
    torch.testing.assert_close(after.positions[:, 1], torch.full((16,), -0.03, dtype=torch.float64))


def test_clear_vertices_and_pins_are_left_alone() -> None:
    garments, state = lying(2e-3, (0.0, -1.0, 0.0))
    after, report = answered(garments, state, slab())
    assert torch.equal(after.positions, state.positions)
    assert torch.equal(after.velocities, state.velocities)
    assert report.pushed == 0
    mesh = sheet(3, 3, 0.3, 0.3).with_pins(np.arange(16) == 5)
    after, _ = answered(packed(mesh), lying(-2e-3)[1], slab())
    assert float(after.positions[5, 1]) == -2e-3


def test_back_to_the_side_it_came_from() -> None:
    """Sunk beyond the middle of a thin plate: the nearest surface is the wrong one."""
    plate = slab(thickness=0.02)
    garments, before = lying(1e-3)
    _, state = lying(-0.015)
    after, _ = answered(garments, state, plate, before)
    torch.testing.assert_close(after.positions[:, 1], torch.full((16,), 5e-4, dtype=torch.float64))
    through, _ = answered(garments, state, plate)
    assert float(through.positions[0, 1]) < -0.02


def test_the_ground_too() -> None:
    garments, state = lying(-4e-3, (0.2, -0.5, 0.0))
    after, report = answered(garments, state, slab(top=-3.0), ground=0.0)
    assert float(after.positions[:, 1].min()) == pytest.approx(5e-4)
    assert after.velocities[0].tolist() == pytest.approx([0.2, 0.0, 0.0])
    assert report.pushed == 16


def test_regions_left_out_of_contact_do_not_push() -> None:
    garments = packed(sheet(2, 2, 0.02, 0.02))
    body = capsule(count=16)
    frame = collider(body.vertices, body.faces, contact=np.asarray(body.vertices[:, 1] < -0.3))
    state = at_rest(garments)
    after, report = answered(garments, state, frame)
    assert torch.equal(after.positions, state.positions)
    assert (report.pushed, report.left) == (0, 0)


def test_cloth_that_came_into_a_limb_by_its_open_end_is_pushed_out_of_that() -> None:
    body = capsule()
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    arm = vertices[:, 1] < 0.2
    end = vertices[faces[arm[faces].all(axis=1)], 1].max()
    motion = np.array([0.0, 0.0, 0.01])
    contact = np.concatenate([arm, arm])
    # Two worlds, so that the caps of the second are not counted from those of the first.
    frame = colliders([(vertices, faces), (vertices + [0.3, 0.0, 0.0], faces)], [0, 1], motion, contact=contact)
    garments = packed(sheet(2, 2, 0.02, 0.02), sheet(2, 2, 0.02, 0.02))
    x = garments.rest_positions[:, [0, 2, 1]].clone()
    for world, middle in enumerate((0.0, 0.3)):
        rows = garments.vertex_garment == world
        x[rows] += torch.tensor([middle, end - 0.003, 0.01], dtype=x.dtype) - x[rows].mean(0)
    after, report = answered(garments, at_rest(garments, x), frame)
    assert (report.pushed, report.left) == (len(x), 0)
    torch.testing.assert_close(after.positions[:, [0, 2]], x[:, [0, 2]], rtol=0, atol=1e-3)
    assert float(after.positions[:, 1].min()) > end
    planes = nearest_planes(frame.now, garments, x)
    carried = planes.transported(frame.following) - planes.points
    torch.testing.assert_close(carried, torch.from_numpy(motion).expand_as(carried), rtol=0, atol=1e-9)


def test_single_precision_stays_single() -> None:
    _, state = lying(-3e-3)
    single = State(state.positions.float(), state.velocities.float(), 1)
    after, _ = answered(packed(sheet(3, 3, 0.3, 0.3), dtype=torch.float32), single, slab())
    assert after.positions.dtype == after.velocities.dtype == torch.float32
    assert float(after.positions[:, 1].min()) > 0


def test_a_vertex_that_comes_inside_where_the_body_overlaps_itself_is_found_though_it_was_never_near() -> None:
    import trimesh

    # Two boxes in one body: above the lower one's top, 30 mm up, lies all that is beneath the upper one's, at 70 mm.
    low, high = (trimesh.creation.box(extents=(4.0, 0.5, 4.0)) for _ in range(2))
    low.apply_translation([0.0, -0.25, 0.0])
    high.apply_translation([0.0, 0.07 - 0.25, 0.0])
    both = trimesh.util.concatenate([low, high])
    body = collider(both.vertices, both.faces)
    garments, outside = lying(0.03)
    step = time_step(garments, outside, body)
    nearest_planes(body.following, garments, outside.positions)
    within = replace(outside, positions=outside.positions + torch.tensor([0.0, 0.012, 0.0], dtype=torch.float64))
    assert float(nearest_planes(body.following, garments, within.positions).distance.min()) > 0.0, "known from before"
    response = ContactResponse()
    assert response.depth(step, within.positions) == pytest.approx(0.028)
    pushed = response.respond(step, within).positions
    assert response.depth(step, pushed) == pytest.approx(0.008)


def test_contact_wins_against_a_pin() -> None:
    """Pins that would sink into the body are lifted, edges between them too; those that are clear keep their place."""
    garments, state = lying(0.02)
    pinned = torch.zeros(len(state.positions), dtype=torch.bool)
    pinned[:4] = pinned[12:16] = True
    garments = packed(sheet(3, 3, 0.3, 0.3).with_pins(pinned.numpy()))
    places = state.positions.clone()
    places[:4, 1] = -0.012
    step = replace(time_step(garments, state, slab()), pin_positions=places)
    clear = ContactResponse().with_pins_clear(step).pin_positions
    assert clear is not None
    assert 2e-3 <= float(clear[:4, 1].min()) <= float(clear[:4, 1].max()) < 0.03
    torch.testing.assert_close(clear[:, [0, 2]], places[:, [0, 2]])
    torch.testing.assert_close(clear[4:], places[4:])
    without = replace(time_step(*lying(0.02), slab()), pin_positions=places)
    assert ContactResponse().with_pins_clear(without) is without
