"""Coarse cloth on a ball: corners outside are not enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from ball_scene import ball_scene

from pb4u.physics.contact.face_clearance import FaceClearance
from pb4u.physics.contact.planes import clearances
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
    return float(clearances(timeline.pose(0), middles, timeline.garments.face_garment)[0].min())


def test_faces_that_cut_into_the_body_are_lifted_out_of_it() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    assert deepest_middle(timeline, state) < -1e-3
    lifted = FaceClearance(passes=4).lift(timeline.garments, state, timeline.pose(0))
    assert deepest_middle(timeline, lifted) > -1e-4
    moved = (lifted.positions - state.positions).norm(dim=1)
    assert float(moved.max()) < 4 * 5e-3
    torch.testing.assert_close(lifted.velocities, state.velocities)


def test_cloth_that_is_clear_stays_where_it_is() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    away = replace(state, positions=state.positions + 1.0)
    torch.testing.assert_close(
        FaceClearance().lift(timeline.garments, away, timeline.pose(0)).positions, away.positions
    )


def test_pins_do_not_move() -> None:
    timeline, state = sheet_wrapped_round_the_ball()
    pinned = torch.from_numpy(np.arange(timeline.garments.vertex_count) % 2 == 0)
    garments = replace(timeline.garments, pinned=pinned)
    lifted = FaceClearance().lift(garments, state, timeline.pose(0))
    assert torch.equal(lifted.positions[pinned], state.positions[pinned])
    assert not torch.equal(lifted.positions, state.positions)
