"""What a page does to cloth that is simulated: it reaches the steps, and what is absurd is refused."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from tests.viewer.test_browser_window import until

from pb4u.errors import InputError
from pb4u.run import Run, WornGarment
from pb4u.simulation.touch import Touch
from pb4u.viewer.browser_window import BrowserWindow
from pb4u.viewer.clip import GrowingClip
from pb4u.viewer.live_simulation import Ending, LiveSimulation
from pb4u.viewer.touches import Touches

SKIRT = Run((WornGarment("skirt", triangles=400),), frames=4, lead_in=0, model="quick-solver", refine=3)


def simulated(touches: Touches, each: Callable[[GrowingClip], None] = lambda _: None, **other: Any) -> LiveSimulation:
    """A simulation to its end, told of every step."""
    told: list[tuple[str, Ending]] = []
    made = LiveSimulation(
        replace(SKIRT, **other), lambda clip, *_: each(clip), lambda _, *how: told.append(how), touches=touches
    )
    run_to_its_end(made)
    assert told[0][1] is Ending.finished, told
    return made


def run_to_its_end(simulation: LiveSimulation) -> None:
    simulation.start()
    assert simulation.join(120.0)


@pytest.fixture(scope="module")
def untouched() -> LiveSimulation:
    return simulated(Touches())


def cloth(simulation: LiveSimulation) -> np.ndarray:
    assert simulation._clip is not None
    return np.asarray(simulation._clip.trajectory().positions)


def test_a_hand_draws_the_cloth_and_the_clip_says_so(untouched: LiveSimulation) -> None:
    touches = Touches()

    def grab(clip: GrowingClip) -> None:
        if clip.frame_count == 1:
            hem = clip.garment(0)[clip.garment(0)[:, 1].argmin()]
            point = tuple((hem - [clip.body(0)[:, 0].mean(), 0.0, 0.0]).tolist())
            touches.grab(made_live(clip), clip, 0, point, follows=False)
            touches.draw((point[0], point[1], point[2] + 0.2))

    holder: list[LiveSimulation] = []

    def made_live(_: GrowingClip) -> Any:
        return holder[0].live

    made = LiveSimulation(SKIRT, lambda clip, *_: grab(clip), lambda *_: None, touches=touches)
    holder.append(made)
    run_to_its_end(made)
    moved = np.linalg.norm(cloth(made) - cloth(untouched), axis=2).max(axis=1)
    assert moved[0] == 0.0
    assert moved[1] > 0.04
    assert moved[3] > moved[1]
    assert touches.held_at is None, "it lets go at the end"
    assert made._clip.trajectory().metadata["notes"][-1] == "A hand pulled at the cloth while it was simulated."


def test_wind_comes_from_where_it_is_said_to(untouched: LiveSimulation) -> None:
    touches = Touches()
    for degrees in (0.0, 90.0):
        touches.blow(10.0, degrees, gusts=False)
        live = untouched.live
        assert live is not None
        touch = touches.of_step(live, untouched._clip.until(1))
        assert isinstance(touch, Touch)
        heading = untouched._clip.header.metadata["heading"]
        ahead, left = np.array([np.sin(heading), 0, np.cos(heading)]), np.array([np.cos(heading), 0, -np.sin(heading)])
        assert np.allclose(touch.environment.wind, -10.0 * (ahead if degrees == 0.0 else left), atol=1e-9)
    touches.blow(0.0, 90.0, gusts=True)
    assert touches.of_step(live, untouched._clip.until(1)) is None


def test_a_simulation_that_ended_goes_on_from_a_frame_and_after_the_last(untouched: LiveSimulation) -> None:
    first, before = untouched._clip, cloth(untouched).copy()
    with pytest.raises(InputError, match="This is the last frame"):
        untouched.resumed(3)
    again = untouched.resumed(1)
    run_to_its_end(again)
    assert cloth(again).shape == before.shape
    assert np.array_equal(cloth(again)[:2], before[:2])
    # Three iterations a step do not go to the solver's tolerance.
    assert np.abs(cloth(again) - before).max() < 0.03
    assert again._clip is not first
    assert np.array_equal(first.trajectory().positions, before), "what is shown meanwhile stays as it is"
    again.touches.endless = True
    further = again.resumed(3)
    further._advanced = lambda clip, *_: further.cancel() if clip.frame_count == 6 else None
    run_to_its_end(further)
    assert further._clip.frame_count == 6
    bodies = further._clip.trajectory().body_positions
    assert np.array_equal(bodies[3], bodies[5])
    assert not np.array_equal(bodies[2], bodies[3])


def test_another_fabric_has_its_own_colour_and_is_noted() -> None:
    touches, headers = Touches(), []

    def dress(clip: GrowingClip) -> None:
        headers.append(clip.header)
        if clip.frame_count == 2:
            touches.dress(0, "denim-14oz")

    made = simulated(touches, dress)
    before, after = (headers[n].garments[0]["material"]["density"] for n in (1, 2))
    assert after > 1.5 * before
    assert made._clip.trajectory().metadata["notes"][-1] == "From frame 2 on, skirt was made of denim-14oz."
    assert made._clip.frame_count == 4


def test_slow_motion_takes_its_time() -> None:
    times: list[float] = []
    made = LiveSimulation(SKIRT, lambda *_: times.append(time.monotonic()), lambda *_: None, speed=lambda: 1.0 / 12.0)
    run_to_its_end(made)
    assert times[3] - times[1] > 0.6  # two frames at 30 a second, twelve times as long


@pytest.mark.parametrize(
    ("do", "says"),
    [
        (lambda t: t.blow(float("nan"), 0.0, False), "speed of the wind"),
        (lambda t: t.blow(20.5, 0.0, False), "from 0 to 20, not 20.5"),
        (lambda t: t.blow("strong", 0.0, False), "speed of the wind"),
        (lambda t: t.blow(1.0, -1.0, False), "direction must be a number from 0 to 360"),
        (lambda t: t.dress(0, "../denim.json"), "There is no material"),
        (lambda t: t.draw((0.0, float("inf"), 0.0)), "The point to pull to"),
    ],
)
def test_what_a_page_may_not_do_is_refused(do: Callable[[Touches], None], says: str) -> None:
    with pytest.raises(InputError, match=says):
        do(Touches())


@pytest.fixture
def window() -> Iterator[BrowserWindow]:
    client = MagicMock()
    client.camera.image_height = 0
    client.gui.add_html.side_effect = lambda *_, **__: MagicMock()
    made = BrowserWindow(client, ())
    yield made
    assert made.close(timeout=20.0)


def test_a_mouse_pulls_while_it_is_simulated_and_the_page_follows_the_newest_frame(window: BrowserWindow) -> None:
    window.touches.endless = True
    window.simulate(SKIRT)
    until(lambda: window.state.touchable and window.state.clock.frame_count > 1)
    hem = window.state.clips[0].garment(0)[0]
    x, y, z = hem.tolist()
    window.change(lambda state: setattr(state, "follow", False))
    window._drag("start", (x, y, z), (x, y, z))
    window._drag("update", (x, y, z), (x, y, z + 0.1))
    assert window.state.hand == (x, y, z + 0.1)
    window.change(lambda state: setattr(state, "overlay", "strain"))
    window.change(lambda state: setattr(state.clock, "speed", 0.5))
    assert window.state.follows_newest
    assert window._speed() == 0.5
    window._drag("update", (x, y, z), (float("nan"), y, z))
    assert "The point to pull to" in window._client.add_notification.call_args.args[1]
    window._drag("end", (x, y, z), (x, y, z))
    assert window.state.hand is None
    until(lambda: window.state.clock.frame_count > 6)
    window.change(lambda state: state.clock.pause_at(2))
    assert window._speed() == np.inf
    window.go_on()
    until(lambda: window.state.clips[0].frame_count < 6)
    until(lambda: window.state.follows_newest and window.state.clips[0].frame_count > 5)
    window.cancel()
    until(lambda: not window.simulation.running)
    assert not window.state.touchable
    assert window.touch_panel._unfelt.visible is False
    assert [call.args[0] for call in window._client.gui.add_dropdown.call_args_list].count("1: skirt") == 1


def test_what_feels_no_hand_says_so(window: BrowserWindow) -> None:
    window.simulate(replace(SKIRT, model="skinning"))
    until(lambda: window.simulation and not window.simulation.running)
    assert window.touch_panel._unfelt.visible is True
    with pytest.raises(InputError, match="There is no simulation to continue"):
        window.go_on()
