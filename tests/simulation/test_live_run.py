"""A run that is touched while it is computed: a hand, a wind, another fabric, and a way back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ball_scene import ball_scene, sheet

from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.material import FABRICS
from pb4u.run import WornGarment
from pb4u.scene.assembly import make_scene
from pb4u.scene.scene import Scene
from pb4u.simulation.live_run import LiveRun
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.touch import GRIP, Hand, Touch

SIDE, CELLS = 0.3, 10


def curtain() -> Garment:
    """A sheet that hangs from one of its sides, its lowest edge at a height of 0.85 m."""
    flat = sheet(CELLS, SIDE, 0.0)
    vertices = flat.vertices[:, [0, 2, 1]] + [0.0, 1.0, 0.0]
    return Garment("curtain", vertices, flat.faces, flat.material, vertices[:, 1] > vertices[:, 1].max() - 1e-6)


def live(scene: Scene | None = None) -> LiveRun:
    scene = scene or make_scene(WornGarment(curtain()), None, frames=60)
    return LiveRun(load_simulator("solver", time_integration="bdf2"), scene, RunRecord())


def positions(run: LiveRun) -> np.ndarray:
    return run._kept[-1].state.positions.numpy()


def hand_at(run: LiveRun, point: tuple[float, float, float], place: tuple[float, float, float]) -> Hand:
    state = run._kept[-1].state
    taken = Hand.at(run.packed, state.positions, point)
    return Hand(taken.vertices, place)


def advance(run: LiveRun, steps: int, touch: Touch | None = None) -> np.ndarray:
    for _ in range(steps):
        run.advance(touch)
    return positions(run)


def test_untouched_it_is_the_run_to_the_bit() -> None:
    scene = ball_scene(frames=4, lead_in=2)
    expected = load_simulator("solver", time_integration="bdf2").simulate(scene)
    run = live(ball_scene(frames=4, lead_in=2))
    frames = [run.advance() for _ in range(6)]
    assert frames[:2] == [None, None]
    assert run.frame == 5
    for number, frame in enumerate(frames[2:]):
        assert frame is not None
        assert np.array_equal(frame.positions, expected.positions[number])
        assert np.array_equal(frame.velocities, expected.velocities[number])
        assert np.array_equal(frame.body_positions, expected.body_positions[number])


def test_a_pulled_point_follows_the_hand_and_the_cloth_follows_the_point() -> None:
    run = live()
    before = advance(run, 3)
    corner = int(np.lexsort((before[:, 0], before[:, 1]))[0])
    place = tuple(before[corner] + [0.0, 0.03, 0.05])
    hand = hand_at(run, tuple(before[corner]), place)
    assert hand.vertices[0] == corner
    first = advance(run, 1, Touch(hand))
    second = advance(run, 1, Touch(hand))
    missing = np.linalg.norm(place - before[corner])
    assert np.linalg.norm(first[corner] - place) < 0.2 * missing
    assert np.linalg.norm(second[corner] - place) < 0.1 * missing
    still = advance(run, 15, Touch(hand))
    assert np.linalg.norm(still[corner] - place) < 0.01
    assert still[:, 2].mean() > before[:, 2].mean() + 0.01
    # Let go, it falls back and swings through.
    heights = [advance(run, 1)[corner, 2] for _ in range(20)]
    assert min(heights) < -0.01
    assert np.abs(positions(run)[curtain().pinned] - before[curtain().pinned]).max() < 1e-6


def test_a_hand_holds_what_is_near_at_rest_and_pulls_no_harder_than_a_person() -> None:
    run = live()
    before = advance(run, 1)
    hand = hand_at(run, tuple(before[0]), (0.0, 50.0, 0.0))
    away = np.linalg.norm(curtain().vertices - curtain().vertices[int(hand.vertices[0])], axis=1)
    assert sorted(hand.vertices.tolist()) == np.flatnonzero(away < 1.5 * curtain().mean_edge_length).tolist()
    assert len(hand.vertices) > 2
    assert curtain().mean_edge_length > GRIP
    pull = hand.pull(run._kept[0].state.positions)
    forces = pull.stiffness * (pull.places - run._kept[0].state.positions[hand.vertices])
    assert float(forces.sum(0).norm()) == pytest.approx(30.0)


def test_a_wind_begins_and_ends_between_two_steps() -> None:
    run = live()
    hem = curtain().vertices[:, 1] < 0.86
    still = advance(run, 3)[hem, 2].mean()
    blown = advance(run, 15, Touch(environment=Environment(wind=(0.0, 0.0, 6.0))))[hem, 2].mean()
    assert abs(still) < 1e-3
    assert blown > 0.05
    assert min(advance(run, 1)[hem, 2].mean() for _ in range(15)) < 0.0


def test_it_goes_on_from_an_earlier_frame_with_the_history_of_the_integrator() -> None:
    """To the tolerance of the solver; without the history a step of the first order follows."""
    run = live()
    touch = Touch(environment=Environment(wind=(0.0, 0.0, 6.0)))
    swung = [advance(run, 1, touch) for _ in range(8)]
    run.go_back(3)
    assert (run.frame, run.written_count) == (3, 4)
    again = [advance(run, 1, touch) for _ in range(4)]
    assert max(np.abs(a - b).max() for a, b in zip(again, swung[4:], strict=True)) < 5e-6
    run.go_back(3)
    run._last = run._last._replace(state=replace(run._kept[3].state, history=()))
    assert np.abs(advance(run, 1, touch) - swung[4]).max() > 5e-5


def test_another_fabric_begins_where_the_cloth_is() -> None:
    run, lighter, light = live(), live(), FABRICS["silk-crepe"]
    wind = Touch(environment=Environment(wind=(0.0, 0.0, 4.0)))
    before = advance(run, 2, wind)
    advance(lighter, 2, wind)
    lighter.dress(0, light)
    assert lighter.header.garments[0]["material"]["density"] == light.density
    share = float(lighter.packed.vertex_masses.sum() / run.packed.vertex_masses.sum())
    assert share == pytest.approx(light.density / sheet().material.density)
    assert np.abs(advance(lighter, 1, wind) - before).max() < 0.1  # as fast as it was
    # The same wind blows lighter cloth further.
    hem = curtain().vertices[:, 1] < 0.86
    assert advance(lighter, 1, wind)[hem, 2].mean() > 1.1 * advance(run, 2, wind)[hem, 2].mean()


def test_the_body_stays_after_the_last_frame() -> None:
    run = live(ball_scene(frames=2, lead_in=0))
    frames = [run.advance() for _ in range(4)]
    assert all(frame is not None for frame in frames)
    bodies = [frame.body_positions for frame in frames if frame is not None]
    assert not np.array_equal(bodies[0], bodies[1])
    assert np.array_equal(bodies[1], bodies[3])


@pytest.mark.parametrize("point", [(0.0, float("nan"), 0.0), (1e9, 0.0, 0.0), ("a", 0, 0), (0.0, 1.0)])
def test_a_place_that_is_none_is_refused(point: tuple) -> None:
    run = live()
    run.advance()
    with pytest.raises(InputError, match="The point to pull to"):
        hand_at(run, point, (0.0, 0.0, 0.0))
