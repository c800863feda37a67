"""Simulations and measurements in several threads at once, as the viewer makes them: none changes another."""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Event, current_thread
from typing import Any

import numpy as np
import pytest
import threadpoolctl
import torch
from ball_scene import ball_scene

import pb4u
import pb4u.threads
from pb4u.collision import surface_tree
from pb4u.physics import step_potential
from pb4u.simulation.timeline import BlockedFrames
from pb4u.threads import prefetch, without_library_threads

THREADS = 2


@pytest.fixture
def two_torch_threads() -> Iterator[None]:
    """More than one, so that a count left at one shows."""
    before = torch.get_num_threads()
    torch.set_num_threads(THREADS)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("two_torch_threads")
def test_two_simulations_and_two_measurements_at_once_are_those_one_after_another() -> None:
    scenes = [ball_scene(frames=3, lead_in=0, cells=16, speed=speed) for speed in (0.3, 0.6)]
    assert all(scene.garments[0].garment.triangle_count == 512 for scene in scenes)
    trajectories = [pb4u.load_simulator("solver").simulate(scene) for scene in scenes]
    figures = [pb4u.measure(trajectory) for trajectory in trajectories]
    under_way = [Event(), Event()]

    def simulated(k: int) -> tuple[Any, int]:
        again = pb4u.load_simulator("solver").simulate(scenes[k], progress=lambda *_: under_way[k].set())
        return again, torch.get_num_threads()

    def measured(k: int) -> tuple[Any, int]:
        assert under_way[k].wait(120)
        return pb4u.measure(trajectories[k]), torch.get_num_threads()

    with ThreadPoolExecutor(4) as pool:
        simulating = [pool.submit(simulated, k) for k in range(2)]
        measuring = [pool.submit(measured, k) for k in range(2)]
        results = [future.result() for future in (*simulating, *measuring)]
    for (again, _), expected in zip(results[:2], trajectories, strict=True):
        for name in ("positions", "velocities", "body_positions"):
            np.testing.assert_array_equal(getattr(again, name), getattr(expected, name))
    assert [figure for figure, _ in results[2:]] == figures
    # A thread takes the count over when it first computes, and keeps it.
    assert [count for _, count in results] == [THREADS] * 4
    with ThreadPoolExecutor(1) as fresh:
        assert fresh.submit(torch.get_num_threads).result() == torch.get_num_threads() == THREADS


def product_threads() -> list[int]:
    """Threads of the libraries of products that numpy and scipy have; other packages load theirs later."""
    libraries = [each for each in threadpoolctl.threadpool_info() if each["user_api"] == "blas"]
    return [each["num_threads"] for each in libraries if re.search(r"numpy|scipy", each["filepath"])]


def test_products_have_their_threads_again_after_the_last_of_two_that_overlap() -> None:
    inside, outside = Event(), Event()

    def second() -> None:
        with without_library_threads():
            inside.set()
            assert outside.wait(60)
            assert set(product_threads()) == {1}

    with threadpoolctl.threadpool_limits(THREADS, user_api="blas"), ThreadPoolExecutor(1) as pool:
        before = product_threads()
        assert max(before) > 1
        with without_library_threads():
            running = pool.submit(second)
            assert inside.wait(60)
        outside.set()
        running.result()
        assert product_threads() == before


def test_many_short_lived_packs_in_two_threads_are_measured_as_in_one() -> None:
    """Twenty bodies and garments in turn, more than were ever kept for the next one to find."""
    skinning = pb4u.load_simulator("skinning")
    sizes = (range(2, 12), range(12, 22))
    trajectories = [[skinning.simulate(ball_scene(frames=1, lead_in=0, cells=n)) for n in part] for part in sizes]
    expected = [[pb4u.measure(trajectory) for trajectory in part] for part in trajectories]

    def measured(k: int) -> bool:
        return all([pb4u.measure(t) for t in trajectories[k]] == expected[k] for _ in range(3))

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(measured, range(2))) == [True, True]


def use_threads(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pb4u.threads, "thread_count", lambda: count)


@pytest.mark.parametrize("count", [1, 2])
def test_items_come_out_in_order_one_behind_the_next(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    use_threads(count, monkeypatch)
    made: list[int] = []

    def items() -> Iterator[int]:
        for item in range(5):
            made.append(item)
            yield item

    results = prefetch(lambda item: (item, current_thread()), items())
    for item, (result, thread) in enumerate(results):
        assert result == item
        assert made == list(range(min(item + count, 5)))
        assert (thread is current_thread()) == (count == 1)


@pytest.mark.parametrize("count", [1, 2])
def test_blocks_of_frames_are_computed_once_and_the_next_meanwhile(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    use_threads(count, monkeypatch)
    computed: list[tuple[int, int]] = []
    in_hand = Event()

    def compute(start: int, stop: int) -> torch.Tensor:
        computed.append((start, stop))
        if start == 32:
            in_hand.set()
        if start == 64:
            raise ValueError(f"no frame {start}")
        return torch.arange(start, stop)[:, None]

    frames = BlockedFrames(compute, 70)
    assert frames[0] == 0
    if count == 1:
        assert computed == [(0, 32)]
    else:
        assert in_hand.wait(60)
    assert [int(frames[k]) for k in (31, 32, 5, 63)] == [31, 32, 5, 63]
    with pytest.raises(ValueError, match="no frame 64"):
        frames[64]
    assert computed[:3] == [(0, 32), (32, 64), (64, 70)]


@pytest.mark.parametrize("count", [1, 2])
def test_a_failure_behind_is_raised_where_its_result_is_asked_for(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    use_threads(count, monkeypatch)
    results = prefetch(lambda item: 1 // item, iter([1, 0, 1]))
    assert next(results) == 1
    with pytest.raises(ZeroDivisionError):
        next(results)


@pytest.mark.parametrize("count", [1, 2])
def test_an_interrupt_comes_after_what_was_made(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    use_threads(count, monkeypatch)

    def items() -> Iterator[int]:
        yield from range(3)
        raise KeyboardInterrupt

    results = prefetch(lambda item: item, items())
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(KeyboardInterrupt):
        next(results)


def test_a_run_that_is_given_up_makes_no_further_item(monkeypatch: pytest.MonkeyPatch) -> None:
    use_threads(2, monkeypatch)
    made: list[int] = []

    def items() -> Iterator[int]:
        for item in range(9):
            made.append(item)
            yield item

    results = prefetch(lambda item: item, items())
    assert next(results) == 0
    results.close()  # type: ignore[attr-defined]
    assert made == [0, 1]


def test_a_run_gives_the_same_frames_on_one_thread_and_on_two(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = []
    for module in (surface_tree, step_potential):
        monkeypatch.setattr(module, "_FEW", 0)
    for count in (1, 2):
        use_threads(count, monkeypatch)
        frames.append(pb4u.load_simulator("auto").simulate(ball_scene(frames=4, lead_in=2, cells=16)).positions)
    assert len(frames[0]) == 4
    np.testing.assert_array_equal(*frames)
