"""Two balls of one body pressed into each other: their skins give way, and a sheet between them stays between them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
import trimesh
from tests.simulation.ball_scene import sheet

from pb4u.body.animated_body import AnimatedBody
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.environment import Environment
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.garment import Garment
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.soft_folds import SoftFolds
from pb4u.simulation.models import load_simulator

RADIUS = 0.12


class TwoBalls(AnimatedBody):
    """Balls beside each other along x, each moved inward by a `way` (frames,) [m] from where they touch not."""

    def __init__(self, way: np.ndarray, apart: float = 0.2) -> None:
        ball = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
        count = len(ball.vertices)
        self._side = np.repeat([-1.0, 1.0], count)
        self.rest_vertices = np.tile(ball.vertices, (2, 1)).astype(np.float64)
        self.rest_vertices[:, 0] += (RADIUS + apart / 2) * self._side
        self.faces = np.concatenate([ball.faces, ball.faces + count]).astype(np.int64)
        self.contact = np.ones(2 * count, dtype=bool)
        self.fps, self.name, self._way = 30.0, "two balls", way - apart / 2

    @property
    def frame_count(self) -> int:
        return len(self._way)

    def positions(self, start: int, stop: int) -> torch.Tensor:
        moved = np.repeat(self.rest_vertices[None], stop - start, axis=0)
        moved[:, :, 0] -= (self._way[start:stop, None] + 0.1) * self._side
        return torch.from_numpy(moved.astype(np.float32))


def pressed(depth: float) -> TwoBalls:
    """The balls so deep [m] inside each other."""
    return TwoBalls(np.array([0.1 + depth / 2]))


def test_skins_that_were_inside_each_other_are_apart_and_the_rest_stays() -> None:
    body = pressed(0.09)
    posed, opened = body.positions(0, 1)[0].numpy(), SoftFolds(body).positions(0, 1)[0].numpy()
    assert len(self_crossings(posed.astype(float), body.faces)) > 0
    assert len(self_crossings(opened.astype(float), body.faces)) == 0
    moved = np.linalg.norm(opened - posed, axis=1)
    # Half of the way each, and some room.
    assert 0.04 < moved.max() < 0.06
    middles = np.array([RADIUS - 0.045, 0.0, 0.0]) * np.array([[-1.0], [1.0]])
    outside = (np.linalg.norm(posed[:, None] - middles, axis=2) > RADIUS - 1e-6).all(axis=1)
    assert moved[outside].max() == 0.0


@pytest.mark.parametrize("depth", [-0.05, 0.0, 0.038])
def test_balls_that_hardly_touch_are_left_as_they_are(depth: float) -> None:
    body = pressed(depth)
    posed = body.positions(0, 1)[0].numpy()
    np.testing.assert_array_equal(SoftFolds(body).opened(posed), posed)


def test_a_fold_opens_without_a_jump() -> None:
    depths = np.linspace(0.0, 0.1, 101)
    opened = [SoftFolds(pressed(depth)).positions(0, 1)[0].numpy() for depth in depths]
    # A vertex that comes inside goes its whole way at once.
    assert np.abs(np.diff(opened, axis=0)).max() < 0.02


def test_what_is_left_out_of_contact_neither_presses_nor_gives_way() -> None:
    body = pressed(0.09)
    body.contact = body._side > 0
    posed = body.positions(0, 1)[0].numpy()
    np.testing.assert_array_equal(SoftFolds(body).opened(posed), posed)


def test_an_open_surface_is_left_as_it_is() -> None:
    body = pressed(0.09)
    body.faces = body.faces[1:]
    np.testing.assert_array_equal(SoftFolds(body).positions(0, 1), body.positions(0, 1))


def hung(body: AnimatedBody, frames: int) -> Scene:
    """A sheet that hangs between the balls, held at its upper border."""
    flat = sheet(10, side=0.4, height=0.0)
    upright = flat.vertices[:, [1, 0, 2]] + [0.0, 0.02, 0.0]
    held = upright[:, 1] > upright[:, 1].max() - 1e-6
    garment = Garment("sheet", upright, flat.faces, flat.material, pinned=held)
    placed = PrescribedPlacement(np.repeat(upright[None], frames, axis=0))
    return Scene((DressedGarment(garment, placed),), (body,), frames, 0, environment=Environment(ground=None))


@pytest.mark.parametrize(
    ("contact", "self_contact", "is_open"), [(True, False, True), (True, True, True), (False, False, False)]
)
def test_folds_are_open_to_contact_alone(contact: bool, self_contact: bool, is_open: bool) -> None:
    body = pressed(0.09)
    simulator = load_simulator("quick-solver", contact=contact, self_contact=self_contact)
    seen = simulator.timeline(hung(body, 1)).body(0).float()
    expected = SoftFolds(body) if is_open else body
    assert torch.equal(seen, expected.positions(0, 1)[0])


def between(folds: Callable[[AnimatedBody], AnimatedBody | SoftFolds], monkeypatch: pytest.MonkeyPatch) -> float:
    """Farthest that a sheet hangs from the middle [m], after balls that closed on it parted and its swing ebbed."""
    monkeypatch.setattr("pb4u.simulation.timeline.SoftFolds", folds)
    way = np.concatenate([np.linspace(0.06, 0.19, 12), np.full(4, 0.19), np.linspace(0.19, 0.0, 14), np.zeros(12)])
    body = TwoBalls(way)
    trajectory = load_simulator("quick-solver").simulate(hung(body, len(way)))
    last = np.array(trajectory.positions[-1], dtype=np.float64)
    skin = body.positions(len(way) - 1, len(way))[0].numpy().astype(np.float64)
    assert len(crossings(last, trajectory.faces, skin, body.faces)) == 0
    return float(np.abs(last[:, 0]).max())


def test_cloth_between_two_parts_is_between_them_when_they_part(monkeypatch: pytest.MonkeyPatch) -> None:
    assert between(SoftFolds, monkeypatch) < 0.06
    # As posed, the balls squeeze it out from between them.
    assert between(lambda body: body, monkeypatch) > 0.2
