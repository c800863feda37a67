"""The law that no step of any kind brings a body through cloth that was clear of it, between vertices either."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import example, given, settings, strategies as st
from tests.laws.test_self_contact import PAIRED, OneMethod, methods
from tests.simulation.ball_scene import sheet

from pb4u.body.animated_body import AnimatedBody
from pb4u.collision import collision_free
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.environment import STANDARD_GRAVITY, Environment
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.physics.contact.obstacle import Obstacle
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.terms.friction import Friction
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.simulation.first_frame import AsPlaced
from pb4u.simulation.refinement import ImplicitSteps
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.timeline import Timeline

NO_GROUND = Environment(ground=None)
FELT = IncrementalPotential().with_self_contact(bodies=True)
METHODS = methods(FELT)


class Rigid(AnimatedBody):
    """A mesh that is moved as a whole along a path (frames, 3) [m]."""

    def __init__(self, mesh: trimesh.Trimesh, path: np.ndarray) -> None:
        self.rest_vertices = np.asarray(mesh.vertices, dtype=np.float64)
        self.faces = np.asarray(mesh.faces, dtype=np.int64)
        self.contact = np.ones(len(self.rest_vertices), dtype=bool)
        self.fps, self.name, self._path = 30.0, "rigid", path

    @property
    def frame_count(self) -> int:
        return len(self._path)

    def positions(self, start: int, stop: int) -> torch.Tensor:
        return torch.from_numpy((self.rest_vertices + self._path[start:stop, None]).astype(np.float32))


def upright(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh along z stood up along y."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return mesh


def spike() -> trimesh.Trimesh:
    """A cone 0.3 m high whose point is at the height of 0.6 m: finer than any cell of a sheet."""
    mesh = upright(trimesh.creation.cone(radius=0.06, height=0.3, sections=16))
    mesh.apply_translation([0.017, 0.3, 0.011])
    return mesh


def ball(radius: float = 0.12) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    mesh.apply_translation([0.0, 0.6 - radius, 0.0])
    return mesh


def arm(bend: float = 1.2) -> trimesh.Trimesh:
    """Two capsules, an elbow between them, in one closed surface each."""
    upper = trimesh.creation.capsule(height=0.25, radius=0.045, count=[12, 12])
    lower = upper.copy()
    lower.apply_transform(trimesh.transformations.rotation_matrix(bend, [0, 1, 0]))
    return upright(trimesh.util.concatenate([upper, lower]))


def moved(up: float, frames: int, side: float = 0.0) -> np.ndarray:
    """A path that goes up (and to a side) by so much, evenly."""
    return np.linspace(0.0, 1.0, frames)[:, None] * np.array([side, up, 0.0])


FRAMES = 5
SCENES = {
    "spike comes up": (spike, moved(0.1, FRAMES), "corners"),
    "ball pushed through a held sheet": (ball, moved(0.12, FRAMES), "border"),
    "ball slides beneath": (ball, moved(0.0, FRAMES, 0.06), "none"),
    "spike leaps": (spike, moved(0.4, FRAMES), "corners"),
}


def scene_of(name: str, cells: int = 6, height: float = 0.603) -> Scene:
    """A sheet above a body."""
    shape, path, held = SCENES[name]
    garment = sheet(cells, 0.3, height)
    x = garment.vertices
    edge = (np.abs(x[:, 0]) > 0.149).astype(int) + (np.abs(x[:, 2]) > 0.149)
    garment = garment.with_pins(edge >= {"corners": 2, "border": 1, "none": 3}[held])
    placed = PrescribedPlacement(np.repeat(x[None], FRAMES, axis=0))
    return Scene((DressedGarment(garment, placed),), (Rigid(shape(), path),), FRAMES, environment=NO_GROUND)


def crossed(scene: Scene, states: Iterator) -> list[int]:
    """Pairs of triangles of cloth and body that cross in each state."""
    timeline = Timeline.of(scene)
    faces, body = timeline.garments.faces.numpy(), np.asarray(scene.colliders[0].faces)
    return [len(crossings(s.positions.numpy(), faces, timeline.body(s.frame).numpy(), body)) for s in states]


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", METHODS)
def test_no_step_of_any_kind_brings_a_body_through_cloth(name: str, method: str) -> None:
    scene = scene_of(name)
    start, network, refinement, contact, first = METHODS[method]
    taken = StepMethod(start, network, refinement, contact, FELT)
    record = RunRecord()
    counts = crossed(scene, OneMethod(first, taken).rollout(scene, record))
    assert record.failed_at is None
    assert counts == [0] * FRAMES


def test_without_it_the_spike_comes_through() -> None:
    scene = scene_of("spike comes up")
    start, network, refinement, contact, first = methods(PAIRED)["quick solver"]
    taken = StepMethod(start, network, refinement, contact, PAIRED)
    assert max(crossed(scene, OneMethod(first, taken).rollout(scene, RunRecord()))) > 0


def test_a_move_goes_past_a_body_that_moves_the_other_way() -> None:
    """Cloth that wants to stay where a ball goes is taken along by it, and keeps its distance."""
    scene = scene_of("ball pushed through a held sheet")
    timeline = Timeline.of(scene)
    step = timeline.step_from(timeline.skinned_state(0))
    x, obstacle = step.state.positions, step.obstacle
    assert obstacle is not None
    assert not obstacle.passed.any()
    reached, after = FELT.self_contact.collision_free_move(timeline.garments, x, x.clone(), obstacle=obstacle)
    assert after is not None
    assert not after.passed.any()
    assert float((reached - x)[:, 1].max()) > 0.02
    body, faces = np.asarray(scene.colliders[0].faces), timeline.garments.faces.numpy()
    assert len(crossings(reached.numpy(), faces, timeline.body(1).numpy(), body)) == 0
    assert len(crossings(x.numpy(), faces, timeline.body(1).numpy(), body)) > 0
    # What met it is led further off than the smallest gap: else skin that bends would leave no room to the next move.
    ended = np.concatenate([reached.numpy(), after.before])
    pairs = obstacle.tree.pairs(ended, 1.5 * collision_free.SMALLEST_GAP, np.zeros_like(ended))
    mixed = (pairs.corners >= obstacle.tree.first_obstacle).any(axis=1)
    assert pairs.nearest(ended)[0][mixed].min(initial=np.inf) > 1.5 * collision_free.SMALLEST_GAP


@given(
    wish=st.sampled_from([0.0, 1e-3, 0.03, 1.0]),
    motion=st.sampled_from(["up", "aside", "swells", "turns", "leaps"]),
    near=st.sampled_from([1.2e-4, 3e-3]),
    seed=st.integers(0, 10**6),
)
@example(wish=1e-3, motion="swells", near=1.2e-4, seed=23)
@settings(max_examples=12, deadline=None)
def test_no_move_crosses_a_moving_body_but_where_it_is_let_through(
    wish: float, motion: str, near: float, seed: int
) -> None:
    """From beside a ball to anywhere, while the ball moves; where there is room nothing is let through."""
    timeline = Timeline.of(scene_of("ball slides beneath", height=0.6 + near))
    garments, x, rng = timeline.garments, timeline.skinned(0), np.random.default_rng(seed)
    obstacle = Obstacle.at(garments, timeline.pose(0), x)
    assert obstacle is not None
    body = obstacle.before
    middle, turn = body.mean(axis=0), trimesh.transformations.rotation_matrix(0.3, rng.normal(size=3))[:3, :3]
    after = {
        "up": body + [0.0, 0.03, 0.0],
        "aside": body + [0.05, 0.01, 0.0],
        "swells": middle + 1.05 * (body - middle),
        "turns": middle + (body - middle) @ turn.T,
        "leaps": body + rng.normal(size=3),
    }[motion]
    wanted = x + wish * torch.from_numpy(rng.normal(size=x.shape))
    moving = replace(obstacle, after=after)
    reached, ended = FELT.self_contact.collision_free_move(garments, x, wanted, obstacle=moving)
    assert ended is not None
    faces = garments.faces.numpy()
    skin = obstacle.tree.faces[len(faces) :] - obstacle.tree.first_obstacle
    through = crossings(reached.numpy(), faces, after, skin)
    assert ended.passed[faces[through[:, 0]]].any(axis=1).all()
    assert not len(self_crossings(reached.numpy(), faces))
    if motion != "leaps" and wish <= 1e-3:
        assert not ended.passed.any()


def test_what_bodies_are_through_is_known_and_let_through() -> None:
    """A spike that is through already stops nothing that is near it, nor is it stopped."""
    scene = scene_of("spike comes up")
    timeline = Timeline.of(scene)
    x = timeline.skinned(0) - torch.tensor([0.0, 0.05, 0.0], dtype=torch.float64)
    obstacle = Obstacle.at(timeline.garments, timeline.pose(0), x)
    assert obstacle is not None
    assert 0 < obstacle.passed.sum() < 9
    away = x + torch.tensor([0.0, 0.1, 0.0], dtype=torch.float64)
    reached, _ = FELT.self_contact.collision_free_move(timeline.garments, x, away, obstacle=obstacle)
    torch.testing.assert_close(reached, away, rtol=0.0, atol=1e-12)


def test_two_bodies_that_close_on_cloth_are_let_through_it() -> None:
    """Cloth between two balls that pass through each other: finite, and clear of itself."""
    below, above = ball(), ball()
    above.apply_translation([0.0, 0.25, 0.0])
    garment = sheet(6, 0.3, 0.604)
    placed = PrescribedPlacement(np.repeat(garment.vertices[None], FRAMES, axis=0))
    bodies = (Rigid(below, moved(0.06, FRAMES)), Rigid(above, moved(-0.06, FRAMES)))
    scene = Scene((DressedGarment(garment, placed),), bodies, FRAMES, environment=NO_GROUND)
    start, network, refinement, contact, first = METHODS["quick solver"]
    record = RunRecord()
    states = list(OneMethod(first, StepMethod(start, network, refinement, contact, FELT)).rollout(scene, record))
    assert record.failed_at is None
    lengths = (states[-1].positions[torch.from_numpy(garment.topology.edges)].diff(dim=1)).norm(dim=2)[:, 0].numpy()
    assert (lengths / garment.edge_lengths).max() < 3.0
    assert np.abs(states[-1].positions.numpy() - garment.vertices).max() < 0.3


def test_where_one_move_finds_no_room_smaller_ones_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spike that leaps 10 cm, past which no move of 3 cm is found, is passed; what was near keeps its gap."""
    timeline = Timeline.of(scene_of("spike leaps", height=0.60005))
    step = timeline.step_from(timeline.skinned_state(0))
    x, obstacle = step.state.positions, step.obstacle
    assert obstacle is not None
    in_one, starts = collision_free._in_one_move, []

    def found(tree, before, wanted, masses, known, passed, began, impulses):
        starts.append(began)
        if np.abs(wanted - before).max() > 0.03:
            return wanted, np.ones(len(before), dtype=bool)
        return in_one(tree, before, wanted, masses, known, passed, began, impulses)

    monkeypatch.setattr(collision_free, "_in_one_move", found)
    reached, after = FELT.self_contact.collision_free_move(timeline.garments, x, x.clone(), obstacle=obstacle)
    assert after is not None
    assert not after.passed.any()
    body, faces = timeline.colliders.faces.numpy(), timeline.garments.faces.numpy()
    assert len(crossings(reached.numpy(), faces, timeline.body(1).numpy(), body)) == 0
    # Cloth nearer than the smallest gap keeps nine tenths of its distance in the whole move, not in each.
    before, ended = (np.concatenate(of) for of in ((x.numpy(), obstacle.before), (reached.numpy(), obstacle.after)))
    assert all(np.array_equal(began, before) for began in starts)
    pairs = obstacle.tree.pairs(before, 1e-3, ended - before)
    gaps = collision_free.smallest_gaps(pairs, before, obstacle.tree.first_obstacle)
    assert (pairs.nearest(ended)[0] > gaps).all()


def rode(coefficient: float, share: float, frames: int = 10, settling: int = 4) -> tuple[float, float]:
    """Speed [m/s] and slip [m] of a sheet on a plate that speeds up sideways, by a share of what friction can give.

    The speed is in units of what it gains by friction alone in that time.
    """
    plate = trimesh.creation.box(extents=[2.0, 0.1, 0.6])
    plate.apply_translation([0.0, 0.55, 0.0])
    garment, limit = sheet(3, 0.15, 0.6018), coefficient * STANDARD_GRAVITY
    garment = garment.with_material(replace(garment.material, friction=coefficient))
    seconds = np.maximum(np.arange(settling + frames) - settling, 0) / 30.0
    path = (0.5 * share * limit * seconds**2)[:, None] * np.array([1.0, 0.0, 0.0])
    placed = PrescribedPlacement(np.repeat(garment.vertices[None], len(path), axis=0))
    scene = Scene((DressedGarment(garment, placed),), (Rigid(plate, path),), len(path), environment=NO_GROUND)
    potential = FELT.with_term(Friction())
    method = StepMethod(refinement=ImplicitSteps(potential), potential=potential)
    *_, last = OneMethod(AsPlaced(), method).rollout(scene, RunRecord())
    way = (last.positions.numpy() - garment.vertices)[:, 0].mean()
    return float(last.velocities[:, 0].mean()) / (limit * seconds[-1]), float(path[-1, 0] - way)


@pytest.mark.parametrize("coefficient", [0.2, 0.5])
def test_a_plate_takes_cloth_along_as_far_as_friction_can(coefficient: float) -> None:
    speed, slip = rode(coefficient, 0.8)
    # The last step's mean speed is that of half a step before its end.
    assert speed == pytest.approx(0.8 * (1.0 - 0.5 / 9), rel=0.01)
    assert abs(slip) < 2e-3
    speed, slip = rode(coefficient, 1.5)
    assert speed == pytest.approx(1.0, rel=0.05)
    assert slip == pytest.approx(0.5 * 0.5 * coefficient * STANDARD_GRAVITY * 0.3**2, rel=0.25)
