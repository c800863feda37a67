"""Windows: the same sample whenever drawn, the right pose, noise, push and material."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from tests.training.ball_data import TINY, ball_data
from torch import Tensor

from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.garment.material import MATERIALS
from pb4u.scene.packed import PackedGarments, pack
from pb4u.simulation.timeline import Timeline
from pb4u.training.wardrobe import Wardrobe
from pb4u.training.windows import Sample, Sampler, Window, WindowLoader


def loaded(*samples: Sample, length: int = 3, dtype: torch.dtype = torch.float64) -> Window:
    return WindowLoader(Wardrobe(ball_data(), "cpu", dtype)).load(samples, length)


def frames_of(window: Window, name: str) -> Tensor:
    """(frames, vertices, 3) [m] of the "body" or "skinned" garments of a window."""
    return torch.stack([getattr(window.timeline, name)(frame) for frame in range(window.length + 2)])


def changed(window: Window, shift: Tensor | float = 0.0, garments: PackedGarments | None = None) -> Window:
    """The window with its skinned garments shifted [m], or other garments in it."""
    was = window.timeline
    skinned = frames_of(window, "skinned") + shift
    body = frames_of(window, "body")
    made = Timeline(garments or was.garments, was.colliders, body, skinned, was.dt, was.environment)
    return replace(window, timeline=made)


def test_a_sample_is_the_same_whenever_it_is_drawn() -> None:
    one, other = (Sampler(ball_data(), TINY) for _ in range(2))
    forwards = [one.sample(i, 3) for i in range(20)]
    backwards = [other.sample(i, 3) for i in reversed(range(20))]
    assert forwards == backwards[::-1]
    assert len({s.material.bending for s in forwards}) == 20
    assert {s.clip for s in forwards} == {0, 1}, "the validation clip must not be trained on"
    assert [one.propagation_steps(7, s, 9) for s in range(20)] == [other.propagation_steps(7, s, 9) for s in range(20)]
    assert {one.propagation_steps(i, 0, 9) for i in range(60)} == {1, 2, 3}
    assert Sampler(ball_data(), replace(TINY, most_propagation_steps=0)).propagation_steps(3, 0, 9) == 9


def test_materials_lie_within_their_ranges() -> None:
    sampler = Sampler(ball_data(), TINY)
    materials = [sampler.sample(i, 1).material for i in range(300)]
    for name, (low, high) in vars(TINY.material).items():
        values = np.array([getattr(m, name) for m in materials])
        assert low <= values.min() < values.max() <= high
    assert np.mean(np.log([m.bending for m in materials])) == pytest.approx(
        np.mean(np.log(TINY.material.bending)), abs=0.8
    )


def test_a_joined_pack_is_the_pack_of_the_garments_themselves() -> None:
    data = ball_data()
    materials = [MATERIALS["silk"], MATERIALS["denim"]]
    ours = Wardrobe(data, "cpu", torch.float64).packed([1, 0], materials)
    theirs = pack([data.outfits[o].garment.with_material(m) for o, m in zip((1, 0), materials, strict=True)])
    for entry in fields(theirs):
        a, b = getattr(ours, entry.name), getattr(theirs, entry.name)
        if isinstance(b, Tensor):
            assert torch.allclose(a.double(), b.double(), rtol=1e-12, atol=0), entry.name
        elif entry.name != "garments":
            assert a == b, entry.name


def test_turning_a_window_turns_bodies_and_garments_alike() -> None:
    straight, turned = (loaded(Sample(0, 0, 4, MATERIALS["default"], yaw)) for yaw in (0.0, np.pi / 2))
    quarter = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], dtype=torch.float64)
    for name in ("body", "skinned"):
        assert torch.allclose(frames_of(straight, name) @ quarter.T, frames_of(turned, name), atol=1e-6)


def test_bodies_stand_at_the_origin_where_windows_start() -> None:
    window = loaded(Sample(0, 1, 12, MATERIALS["default"], 1.0))
    body = frames_of(window, "body")
    middle = body[1].mean(0)
    assert torch.allclose(middle[[0, 2]], torch.zeros(2, dtype=torch.float64), atol=1e-5)
    speed = (body[2] - body[1]).norm(dim=1) * 30.0
    assert torch.allclose(speed, torch.full_like(speed, 0.6), atol=1e-4)


def test_noise_is_of_its_size_and_independent_before_and_now() -> None:
    window = loaded(Sample(1, 0, 3, MATERIALS["default"], 0.0, (5,)))
    lifted = changed(window, torch.tensor([0.0, 0.2, 0.0]))
    state = lifted.start(3e-3, 2e-3)
    shift = state.positions - lifted.timeline.skinned(1)
    assert float(shift.std()) == pytest.approx(3e-3, rel=0.15)
    before = state.positions - state.velocities * window.timeline.dt - lifted.timeline.skinned(0)
    assert float(before.std()) == pytest.approx(3e-3, rel=0.15)
    assert abs(float(torch.corrcoef(torch.stack([shift.reshape(-1), before.reshape(-1)]))[0, 1])) < 0.2
    assert torch.equal(lifted.start(3e-3, 2e-3).positions, state.positions)


def test_vertices_inside_the_body_are_pushed_out_and_pins_stay() -> None:
    window = loaded(Sample(1, 0, 3, MATERIALS["default"]))
    sunk = changed(window, torch.tensor([0.0, -0.012, 0.0]))
    body = window.timeline.body(1)
    surface = TriangleSurface(window.timeline.colliders.faces.numpy(), len(body)).at(body)
    assert float(surface.nearest(sunk.timeline.skinned(1)).signed_distance.min()) < -5e-3
    pushed = sunk.start(0.0, 2e-3)
    assert float(surface.nearest(pushed.positions).signed_distance.min()) > 1.5e-3
    assert torch.allclose(pushed.velocities, sunk.timeline.skinned_velocity(1), atol=1e-6)
    garments = sunk.timeline.garments
    held = changed(sunk, garments=replace(garments, pinned=torch.ones_like(garments.pinned))).start(3e-3, 2e-3)
    assert torch.equal(held.positions, sunk.timeline.skinned(1))
