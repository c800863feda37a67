"""What changes on the way: lengths, weights and rates by fractions of the budget."""

from __future__ import annotations

import pytest

from pb4u.errors import InputError
from pb4u.training.curriculum import Curriculum


def test_windows_lengthen_as_in_the_reference() -> None:
    curriculum = Curriculum()
    # Iteration n of 100,000 has min(5, 1 + n // 5000) steps; in optimiser steps: 5K of one, 10K of two, ...
    starts = {1: 0, 2: 5_000, 3: 15_000, 4: 30_000, 5: 50_000}
    for length, start in starts.items():
        assert curriculum.window_length((start + 500) / 450_000) == length
    assert curriculum.window_length(1.0) == 5


def test_the_rate_halves_in_stages_and_keeps_a_floor() -> None:
    curriculum = Curriculum(learning_rate=1.0, halvings=2, rate_floor=0.01)
    assert curriculum.rate(0.0) == pytest.approx(1.01)
    assert curriculum.rate(0.49) == pytest.approx(1.01)
    assert curriculum.rate(0.5) == pytest.approx(0.51)
    assert curriculum.rate(1.5) == pytest.approx(0.26)


def test_the_rate_rises_from_nothing_while_it_warms_up() -> None:
    curriculum = Curriculum(learning_rate=1.0, halvings=0, rate_floor=0.0, warm_up=0.2)
    assert [curriculum.rate(f) for f in (0.0, 0.1, 0.2, 0.9)] == pytest.approx([0.0, 0.5, 1.0, 1.0])
    with pytest.raises(InputError, match="warm_up"):
        Curriculum(warm_up=1.0)


def test_the_collision_weight_ramps_between_its_points() -> None:
    curriculum = Curriculum(collision_weight=((0.0, 1.0), (0.5, 1.0), (1.0, 3.0)))
    assert [curriculum.collision(f) for f in (0.0, 0.4, 0.75, 1.0, 2.0)] == [1.0, 1.0, 2.0, 3.0, 3.0]


@pytest.mark.parametrize("stages", [(), ((0.1, 1),), ((0.0, 1), (0.0, 2)), ((0.0, 1), (0.5, 2), (0.4, 3)), ((0.0, 0),)])
def test_stages_out_of_order_are_refused(stages: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(InputError, match="window_steps must be"):
        Curriculum(window_steps=stages)
