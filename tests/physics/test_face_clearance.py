"""Coarse cloth on a ball: corners outside are not enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from ball_scene import ball_scene
from pb4u.physics.contact_planes import collider_surfaces
from pb4u.physics.face_clearance import FaceClearance
from pb4u.simulation.stage import Stage

from pb4u.scene.state import State


def sheet_wrapped_round_the_ball() -> tuple[Stage, State]:
    """Every vertex of the sheet 0.5 mm outside the ball, so that edges cut into it."""
    stage = Stage(ball_scene(cells=10))
    centre = torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64)
    x = stage.skinned(0) - centre
    flat = x.clone()
    flat[:, 1] = 0.0
    angle = flat.norm(dim=1, keepdim=True) / 0.2
    around = torch.cos(angle) * torch.tensor([[0.0, 1.0, 0.0]], dtype=x.dtype) + torch.sin(
        angle
    ) * torch.nn.functional.normalize(flat, dim=1)
    return stage, State(centre + 0.2005 * around, torch.zeros_like(x), 0)


def deepest_middle(stage: Stage, state: State) -> float:
    still = stage.held_collider(0)
    body = collider_surfaces(stage.garments, still).at(still.following)
    middles = state.positions[stage.garments.faces].mean(1)
    return float(body.clearance(middles, stage.garments.face_garment)[0].min())


def test_faces_that_cut_into_the_body_are_lifted_out_of_it() -> None:
    stage, state = sheet_wrapped_round_the_ball()
    collider = stage.held_collider(0)
    assert deepest_middle(stage, state) < -1e-3
    lifted = FaceClearance(passes=4).lift(stage.garments, state, collider)
    assert deepest_middle(stage, lifted) > -1e-4
    moved = (lifted.positions - state.positions).norm(dim=1)
    assert float(moved.max()) < 4 * 5e-3
    torch.testing.assert_close(lifted.velocities, state.velocities)


def test_cloth_that_is_clear_stays_where_it_is() -> None:
    stage, state = sheet_wrapped_round_the_ball()
    away = replace(state, positions=state.positions + 1.0)
    torch.testing.assert_close(
        FaceClearance().lift(stage.garments, away, stage.held_collider(0)).positions, away.positions
    )


def test_pins_do_not_move() -> None:
    stage, state = sheet_wrapped_round_the_ball()
    pinned = torch.from_numpy(np.arange(stage.garments.vertex_count) % 2 == 0)
    garments = replace(stage.garments, pinned=pinned)
    lifted = FaceClearance().lift(garments, state, stage.held_collider(0))
    assert torch.equal(lifted.positions[pinned], state.positions[pinned])
    assert not torch.equal(lifted.positions, state.positions)
