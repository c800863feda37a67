"""Where a time step starts: free flight, or part of the way that the body carries."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from ball_scene import Ball, sheet
from pb4u.physics.integrator import integrate
from pb4u.simulation.network_simulator import NetworkPredictor
from torch import Tensor

from pb4u.errors import InputError
from pb4u.model.pb4u_gnet import Pb4uConfiguration
from pb4u.nn.acceleration_model import AccelerationModel, NetworkConfiguration
from pb4u.presets.networks import network_preset
from pb4u.scene.packed import ColliderFrame, pack
from pb4u.scene.state import State
from pb4u.simulation.step import Situation
from pb4u.simulation.step_start import Carried, FreeFlight

SHARES = (0.25, 0.5, 0.75, 1.0)
DT = 1.0 / 30.0


def sheets_on_balls(*speeds: float, pinned: bool = False) -> Situation:
    """A sheet at rest on each of several balls, which move along X at these speeds [m/s] from now on."""
    garment = sheet()
    if pinned:
        garment = replace(garment, pinned=torch.arange(len(garment.vertices)).numpy() < 5)
    garments = pack([garment] * len(speeds), torch.float64)
    ball = Ball(2)
    rest = torch.from_numpy(ball.rest_vertices)
    now = torch.cat([rest] * len(speeds))
    moved = torch.cat([torch.tensor([[speed * DT, 0.0, 0.0]]).double().expand(len(rest), 3) for speed in speeds])
    faces = torch.as_tensor(ball.faces)
    collider = ColliderFrame(
        previous=now,
        now=now,
        following=now + moved,
        faces=torch.cat([faces + index * len(rest) for index in range(len(speeds))]),
        contact=torch.ones(len(now), dtype=torch.bool),
        vertex_garment=torch.arange(len(speeds)).repeat_interleave(len(rest)),
    )
    start = garments.rest_positions.clone()
    carried = torch.zeros_like(start)
    carried[:, 0] = torch.tensor(speeds).double()[garments.vertex_garment] * DT
    state = State(start, torch.zeros_like(start), 0)
    gravity = torch.tensor([0.0, -9.81, 0.0], dtype=torch.float64)
    return Situation(garments, state, collider, start + carried, carried, DT, gravity)


def sheet_on_a_rising_ball(height: float, pinned: bool = False) -> Situation:
    """A sheet at rest on a ball that comes up through it by `height` [m] and would carry it along."""
    at = sheets_on_balls(0.0, pinned=pinned)
    up = torch.tensor([0.0, height, 0.0], dtype=torch.float64)
    collider = replace(at.collider, following=at.collider.now + up)
    return replace(at, collider=collider, carried=at.carried + up, pin_positions=at.state.positions + up)


def energies_at(situation: Situation, accelerations: Tensor) -> Tensor:
    state = integrate(situation.state, accelerations, situation.dt, situation.garments.pinned, situation.pin_positions)
    return situation.potential.energies(state.positions).per_garment


def test_the_papers_start_is_free_flight() -> None:
    at = sheets_on_balls(1.0)
    assert not FreeFlight().accelerations(at).any()


def test_a_start_has_least_potential_of_all_that_may_be_chosen() -> None:
    moved = []
    for at in (sheets_on_balls(0.2), sheet_on_a_rising_ball(0.005), sheet_on_a_rising_ball(0.03)):
        start = Carried(SHARES).accelerations(at)
        moved.append(float(start.norm(dim=1).max()))
        chosen = energies_at(at, start)
        # The start is chosen with the body's tangent planes; twice-looked-up contacts may differ in the last digits.
        for share in (0.0, *SHARES):
            assert float(chosen) <= float(energies_at(at, share * at.carried)) + 1e-6
    assert moved[0] == 0.0
    assert moved[2] > 0.0


def test_cloth_drawn_into_the_body_is_carried() -> None:
    rising = sheet_on_a_rising_ball(0.03)
    start = Carried(SHARES).accelerations(rising)
    assert float(start[:, 1].min()) >= 0.25 * 0.03
    assert float(energies_at(rising, start)) < float(energies_at(rising, torch.zeros_like(start)))


def test_what_the_body_overruns_is_lifted_where_nothing_carries_it() -> None:
    at = sheets_on_balls(0.0, 0.0)
    rises = (at.collider.vertex_garment == 1)[:, None] * torch.tensor([0.0, 0.02, 0.0]).double()
    at = replace(at, collider=replace(at.collider, following=at.collider.now + rises))
    start = Carried(SHARES).accelerations(at)
    first = at.garments.vertex_garment == 0
    assert not start[first].any()
    over = at.potential.contact_at(at.state.positions)
    inside = over.touchable & (over.distance < -5e-3)
    assert bool(inside.any())
    lifted = at.potential.contact_at(at.state.positions + start)
    assert float(lifted.distance[inside].min()) > -1e-3
    assert float(energies_at(at, start)[1]) < float(energies_at(at, torch.zeros_like(start))[1])


def test_every_garment_of_a_pack_has_its_own_share() -> None:
    both = sheets_on_balls(0.0, 0.0)
    up = torch.tensor([0.0, 0.03, 0.0], dtype=torch.float64)
    rises = (both.collider.vertex_garment == 1)[:, None] * up
    carried = (both.garments.vertex_garment == 1)[:, None] * up
    # What would carry the first garment away is of no use to it.
    carried = carried + (both.garments.vertex_garment == 0)[:, None] * torch.tensor([0.1, 0.1, 0.0]).double()
    at = replace(both, collider=replace(both.collider, following=both.collider.now + rises), carried=carried)
    start = Carried(SHARES).accelerations(at)
    first = at.garments.vertex_garment == 0
    assert not start[first].any()
    assert float(start[~first, 1].min()) > 0.0


def test_pinned_vertices_are_left_to_their_pins() -> None:
    at = sheet_on_a_rising_ball(0.03, pinned=True)
    start = Carried((1.0,)).accelerations(at)
    assert start.any()
    assert not start[at.garments.pinned].any()


@pytest.mark.parametrize("name", ["pb4u_small_carried", "mgn_small", "hood_small", "eslr_small", "contourcraft_small"])
def test_a_network_that_adds_nothing_ends_at_the_start(name: str) -> None:
    torch.manual_seed(0)
    model = AccelerationModel(replace(network_preset(name), width=8).network())
    for parameter in model.network.decoder.parameters():
        torch.nn.init.zeros_(parameter)
    at = sheet_on_a_rising_ball(0.03)
    assert Carried(SHARES).accelerations(at).any()
    prepared = model.prepare(pack(at.garments.garments, torch.float32))
    expected = integrate(at.state, Carried(SHARES).accelerations(at), DT, at.garments.pinned, at.pin_positions)
    assert torch.allclose(NetworkPredictor(model, prepared).predict(at).positions, expected.positions)


@pytest.mark.parametrize("network", [Pb4uConfiguration(), network_preset("eslr"), network_preset("contourcraft")])
@pytest.mark.parametrize("shares", [(0.0,), (-0.5,), (0.5, 1.5)])
def test_shares_beyond_the_bodys_motion_are_refused(network: NetworkConfiguration, shares: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="Shares of the body's motion"):
        replace(network, carried_shares=shares)
