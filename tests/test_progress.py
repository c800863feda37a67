"""How long work takes: an estimate from its first parts, and a bar where somebody looks."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable

import pytest
from tests.simulation.ball_scene import ball_scene

from pb4u.progress import Estimate, no_progress
from pb4u.simulation.simulator import SkinningSimulator


def told_of(seconds: Callable[[int], float], total: int, alike: bool = True) -> list[str]:
    """What an estimate says of work whose parts 1, 2, .. take so long [s]."""
    told: list[str] = []
    now = 0.0
    estimate = Estimate(told.append, "step", alike, clock=lambda: now)
    for done in range(1, total + 1):
        now += seconds(done)
        estimate(done, total)
    return told


def test_long_work_is_estimated_once_and_without_its_first_part() -> None:
    # Parts after the first take 2 s; that loads for a minute.
    assert told_of(lambda k: 60.0 if k == 1 else 2.0, 200) == ["196 more steps take about 7 minutes, 2 s each."]
    assert told_of(lambda _: 30.0, 1000) == ["996 more steps take about 8.3 hours, 30 s each."]


def test_work_of_parts_that_differ_is_estimated_by_the_mean_of_more() -> None:
    # Every other part takes 9 s, the rest 1 s.
    assert told_of(lambda k: 9.0 if k % 2 else 1.0, 200, alike=False) == [
        "195 more steps take about 16 minutes, 5 s each."
    ]


def test_work_that_gets_slower_is_estimated_again() -> None:
    # Cloth is easy for ten steps, then caught: each step takes 20 times as long.
    said = told_of(lambda k: 0.5 if k <= 10 else 10.0, 150)
    assert said[0] == "145 more steps take about 1 minute, 0.5 s each."
    assert len(said) == 2
    assert re.fullmatch(r"Slower than at first: 13\d more steps take about 2\d minutes, 10 s each\.", said[1])
    # What was too short to tell of is told of once it is long.
    (late,) = told_of(lambda k: 0.1 if k <= 40 else 4.0, 90)
    assert late.startswith("Slower than at first: ")


def test_slower_work_that_stays_within_what_was_said_is_not_told_of() -> None:
    # The first steps take 4 s, most of them 0.3 s, and the last 10 s.
    (first,) = told_of(lambda k: 4.0 if k <= 10 else 0.3 if k <= 150 else 10.0, 200)
    assert first.startswith("196 more steps take about 13 minutes")


@pytest.mark.parametrize(("each", "total"), [(0.1, 300), (10.0, 4), (30.0, 3)])
def test_short_work_is_not(each: float, total: int) -> None:
    assert told_of(lambda _: each, total) == []


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_simulation_from_python_shows_a_bar_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ball_scene()
    for stream, quiet, seen in ((Terminal(), False, True), (Terminal(), True, False), (io.StringIO(), False, False)):
        monkeypatch.setattr(sys, "stderr", stream)
        SkinningSimulator().simulate(scene, *([no_progress] if quiet else []))
        assert ("skinning" in stream.getvalue()) is seen


def test_parts_in_which_something_is_compiled_do_not_count_for_the_rest() -> None:
    assert told_of(lambda k: 8.0 if k <= 3 else 0.2, 90) == []
