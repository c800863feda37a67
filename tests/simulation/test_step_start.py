"""Where a time step starts: free flight, or part of the way that the body carries."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from ball_scene import Ball, sheet
from torch import Tensor

from pb4u.environment import USUAL
from pb4u.errors import InputError
from pb4u.network.acceleration_model import AccelerationModel, NetworkConfiguration
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.registry import NETWORKS
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.colliders import ColliderFrame, pack_colliders
from pb4u.scene.packed import pack
from pb4u.scene.state import State
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.step import StepMethod, take
from pb4u.simulation.step_start import BodyMotionWarmStart, start_accelerations, start_of

SIX = IncrementalPotential()
SHARES = (0.25, 0.5, 0.75, 1.0)
DT = 1.0 / 30.0


def sheets_on_balls(*speeds: float, pinned: bool = False) -> TimeStep:
    """A sheet at rest on each of several balls, which move along X at these speeds [m/s] from now on."""
    garment = sheet()
    if pinned:
        garment = replace(garment, pinned=torch.arange(len(garment.vertices)).numpy() < 5)
    garments = pack([garment] * len(speeds), torch.float64)
    ball = Ball(2)
    rest = torch.from_numpy(ball.rest_vertices)
    now = torch.cat([rest] * len(speeds))
    moved = torch.cat([torch.tensor([[speed * DT, 0.0, 0.0]]).double().expand(len(rest), 3) for speed in speeds])
    faces, contact = torch.as_tensor(ball.faces), torch.as_tensor(ball.contact)
    bodies = pack_colliders([faces] * len(speeds), [contact] * len(speeds), range(len(speeds)))
    still = bodies.pose(now)
    collider = ColliderFrame(still, still, bodies.pose(now + moved))
    start = garments.rest_positions.clone()
    carried = torch.zeros_like(start)
    carried[:, 0] = torch.tensor(speeds).double()[garments.vertex_garment] * DT
    state = State(start, torch.zeros_like(start), 0)
    return TimeStep(garments, state, collider, DT, USUAL, start + carried, carried)


def risen(collider: ColliderFrame, by: Tensor) -> ColliderFrame:
    """The bodies end the step `by` (3,) or (body vertices, 3) [m] from where they stand."""
    return replace(collider, following=collider.colliders.pose(collider.now.positions + by))


def sheet_on_a_rising_ball(height: float, pinned: bool = False) -> TimeStep:
    """A sheet at rest on a ball that comes up through it by `height` [m] and would carry it along."""
    at = sheets_on_balls(0.0, pinned=pinned)
    up = torch.tensor([0.0, height, 0.0], dtype=torch.float64)
    motion = at.skinned_motion + up
    return replace(at, collider=risen(at.collider, up), skinned_motion=motion, pin_positions=at.state.positions + up)


def energies_at(step: TimeStep, accelerations: Tensor) -> Tensor:
    return IncrementalPotential().of(step).energies(integrate(step, accelerations).positions).per_garment


def test_the_papers_start_is_free_flight() -> None:
    at = sheets_on_balls(1.0)
    assert not start_accelerations(None, at).any()


def test_a_start_has_least_potential_of_all_that_may_be_chosen() -> None:
    moved = []
    for at in (sheets_on_balls(0.2), sheet_on_a_rising_ball(0.005), sheet_on_a_rising_ball(0.03)):
        start = BodyMotionWarmStart(SIX, SHARES).accelerations(at)
        moved.append(float(start.norm(dim=1).max()))
        chosen = energies_at(at, start)
        # The start is chosen with the body's tangent planes; twice-looked-up contacts may differ in the last digits.
        for share in (0.0, *SHARES):
            assert float(chosen) <= float(energies_at(at, share * at.skinned_motion)) + 1e-6
    assert moved[0] == 0.0
    assert moved[2] > 0.0


def test_cloth_drawn_into_the_body_is_carried() -> None:
    rising = sheet_on_a_rising_ball(0.03)
    start = BodyMotionWarmStart(SIX, SHARES).accelerations(rising)
    assert float(start[:, 1].min()) >= 0.25 * 0.03
    assert float(energies_at(rising, start)) < float(energies_at(rising, torch.zeros_like(start)))


def test_what_the_body_overruns_is_lifted_where_nothing_carries_it() -> None:
    at = sheets_on_balls(0.0, 0.0)
    rises = (at.collider.colliders.vertex_world == 1)[:, None] * torch.tensor([0.0, 0.02, 0.0]).double()
    at = replace(at, collider=risen(at.collider, rises))
    start = BodyMotionWarmStart(SIX, SHARES).accelerations(at)
    first = at.garments.vertex_garment == 0
    assert not start[first].any()
    potential = IncrementalPotential().of(at)
    over = potential.contact_at(at.state.positions)
    inside = over.touchable & (over.distance < -5e-3)
    assert bool(inside.any())
    lifted = potential.contact_at(at.state.positions + start)
    assert float(lifted.distance[inside].min()) > -1e-3
    assert float(energies_at(at, start)[1]) < float(energies_at(at, torch.zeros_like(start))[1])


def test_every_garment_of_a_pack_has_its_own_share() -> None:
    both = sheets_on_balls(0.0, 0.0)
    up = torch.tensor([0.0, 0.03, 0.0], dtype=torch.float64)
    rises = (both.collider.colliders.vertex_world == 1)[:, None] * up
    carried = (both.garments.vertex_garment == 1)[:, None] * up
    # What would carry the first garment away is of no use to it.
    carried = carried + (both.garments.vertex_garment == 0)[:, None] * torch.tensor([0.1, 0.1, 0.0]).double()
    at = replace(both, collider=risen(both.collider, rises), skinned_motion=carried)
    start = BodyMotionWarmStart(SIX, SHARES).accelerations(at)
    first = at.garments.vertex_garment == 0
    assert not start[first].any()
    assert float(start[~first, 1].min()) > 0.0


def test_pinned_vertices_are_left_to_their_pins() -> None:
    at = sheet_on_a_rising_ball(0.03, pinned=True)
    start = BodyMotionWarmStart(SIX, (1.0,)).accelerations(at)
    assert start.any()
    assert not start[at.garments.pinned].any()


@pytest.mark.parametrize("name", ["pb4u_small_carried", "mgn_small", "hood_small", "eslr_small", "contourcraft_small"])
def test_a_network_that_adds_nothing_ends_at_the_start(name: str) -> None:
    torch.manual_seed(0)
    model = AccelerationModel(replace(NETWORKS[name], width=8).network())
    for parameter in model.network.decoder.parameters():
        torch.nn.init.zeros_(parameter)
    at = sheet_on_a_rising_ball(0.03)
    assert BodyMotionWarmStart(SIX, SHARES).accelerations(at).any()
    prepared = model.prepare(pack(at.garments.garments, torch.float32))
    expected = integrate(at, BodyMotionWarmStart(SIX, SHARES).accelerations(at))
    passes = NetworkPass(model, prepared, StepFeatures(prepared, SIX), model.network.configuration.passes)
    method = StepMethod(start_of(model.network, SIX), passes)
    assert torch.allclose(take(at, method).state.positions, expected.positions)


@pytest.mark.parametrize("network", [Pb4uConfiguration(), NETWORKS["eslr"], NETWORKS["contourcraft"]])
@pytest.mark.parametrize("shares", [(0.0,), (-0.5,), (0.5, 1.5)])
def test_shares_beyond_the_bodys_motion_are_refused(network: NetworkConfiguration, shares: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="warm_start_shares must be"):
        replace(network, warm_start_shares=shares)
