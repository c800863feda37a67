"""A window without a browser: its requests from several threads at once, and the end of its work."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import count
from unittest.mock import MagicMock

import numpy as np
import pytest
from PIL import Image
from tests.viewer.clips import trajectory

from pb4u.errors import InputError
from pb4u.run import Run, WornGarment
from pb4u.viewer.browser_window import BrowserWindow
from pb4u.viewer.clip import RecordedClip
from pb4u.viewer.film import Film
from pb4u.viewer.worker import route_warnings

TINY = Run((WornGarment(triangles=400),), frames=4, lead_in=2, model="skinning")


@pytest.fixture
def client() -> MagicMock:
    """Stands for a page that takes everything in at once."""
    made = MagicMock()
    made.camera.image_height = 0
    return made


@pytest.fixture
def window(client: MagicMock) -> Iterator[BrowserWindow]:
    made = BrowserWindow(client, tuple(RecordedClip(trajectory(20, fps=fps), f"{fps:g}") for fps in (30.0, 60.0)))
    yield made
    assert made.close(timeout=10.0)


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_two_clips_are_measured_while_many_threads_seek(client: MagicMock, window: BrowserWindow) -> None:
    def seek(first: int) -> None:
        for _ in range(200):
            window.change(lambda state: state.clock.toggle())
            window.change(lambda state: state.clock.pause_at(first))

    with ThreadPoolExecutor(4) as users:
        for ended in [users.submit(seek, 5 * n) for n in range(4)]:
            ended.result()
    window.change(lambda state: state.clock.pause_at(7))
    until(lambda: [measurement.done for measurement in window.measurements] == [20, 20])
    assert window.state.clock.frame == 7
    first, second = (measurement.series("stretch") for measurement in window.measurements)
    assert first.tolist() == second.tolist()
    assert [measurement.failure for measurement in window.measurements] == [None, None]
    client.add_notification.assert_not_called()


def test_warnings_of_an_export_are_said_on_the_page(client: MagicMock) -> None:
    window = BrowserWindow(client, (RecordedClip(trajectory(3, lost=(1,)), "walk.npz"),))
    undo = route_warnings()
    try:
        assert "1 of 3 frames are not finite" in window.export(".glb", 0)
    finally:
        undo()
        assert window.close(timeout=10.0)


def test_one_simulation_at_a_time_and_a_refusal_leaves_it_alone(client: MagicMock, window: BrowserWindow) -> None:
    window.simulate(TINY)
    running = window.simulation
    assert running is not None
    with pytest.raises(InputError, match="A simulation is running in this window"):
        window.simulate(TINY)
    assert window.simulation is running
    until(lambda: not running.running)
    assert window.state.clips[0].frame_count == 4
    assert window.state.clock.playing
    until(lambda: window.measurements[0].done == 4)
    client.add_notification.assert_not_called()
    with pytest.raises(InputError, match="triangles must lie between"):
        window.simulate(Run((WornGarment(triangles=7),)))


def test_what_cannot_be_painted_is_said_once_and_shown_shaded(client: MagicMock, window: BrowserWindow) -> None:
    window.change(lambda state: setattr(state, "overlay", "penetration"))
    until(lambda: window.display.looks)
    client.add_notification.assert_not_called()
    made = trajectory(2)
    open_body = replace(made, header=replace(made.header, body_faces=made.header.body_faces[1:]))
    other = BrowserWindow(client, (RecordedClip(open_body, "open"),))
    other.change(lambda state: setattr(state, "overlay", "penetration"))
    until(lambda: client.add_notification.called)
    assert "not a closed surface" in client.add_notification.call_args.args[1]
    until(lambda: other.display.looks)
    assert [look.scale for look in other.display.looks] == [None]
    time.sleep(0.7)
    assert client.add_notification.call_count == 1
    assert other.close(timeout=10.0)


def test_a_film_is_taken_one_at_a_time_and_can_be_stopped(client: MagicMock, window: BrowserWindow) -> None:
    seen = threading.Event()
    taken = count(10, 10)
    client.get_render.side_effect = lambda *_, **__: (
        np.full((11, 21, 4), next(taken), dtype=np.uint8) if seen.wait(30.0) else None
    )
    window.film(".gif")
    with pytest.raises(InputError, match="Pictures are being taken"):
        window.film(".png")
    window.stop_filming()
    seen.set()
    until(lambda: window._film is None)
    client.send_file_download.assert_not_called()
    window.film(".gif")
    until(lambda: client.send_file_download.called)
    name, content = client.send_file_download.call_args.args
    assert name == "30.gif"
    with Image.open(io.BytesIO(content)) as film:
        assert (film.size, film.n_frames) == ((20, 10), 10)  # even, and every other one of twenty at 30 a second
    client.add_notification.assert_not_called()


def test_a_film_that_cannot_be_taken_is_said(client: MagicMock, window: BrowserWindow) -> None:
    client.get_render.side_effect = TimeoutError
    window.film(".png")
    until(lambda: client.add_notification.called)
    assert "keep its window visible" in client.add_notification.call_args.args[1]
    until(lambda: window._film is None)
    with pytest.raises(InputError, match="There is no format"):
        window.film(".exe")
    window.change(lambda state: state.load(()))
    with pytest.raises(InputError, match="nothing to show yet"):
        window.film(".png")
    with pytest.raises(InputError, match=r"1,200 frames.* 1,201"):
        Film(".gif", list(range(1201)), RecordedClip(trajectory(2), "a"))
