"""Several steps in a frame, and frames of a network at its own rate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.run import Run, WornGarment
from pb4u.simulation.run_simulation import simulate

SMALL = (WornGarment("tshirt", "default", triangles=500),)


@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_the_last_of_the_steps_of_a_frame_is_written(tmp_path: Path) -> None:
    at_thirty = simulate(Run(SMALL, frames=3, lead_in=2, model="quick-solver", substeps=2), tmp_path / "a.npz")
    at_sixty = simulate(Run(SMALL, frames=5, lead_in=4, fps=60.0, model="quick-solver"))
    assert (at_thirty.fps, at_thirty.frame_count, at_thirty.metadata["lead_in"]) == (30.0, 3, 2)
    np.testing.assert_array_equal(at_thirty.positions, at_sixty.positions[::2])
    np.testing.assert_array_equal(at_thirty.body_positions, at_sixty.body_positions[::2])


@pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
def test_a_network_at_half_its_rate_writes_every_other_frame() -> None:
    whole = simulate(Run(SMALL, frames=5, lead_in=2, model="pb4u-small", refine=0))
    half = simulate(Run(SMALL, frames=3, lead_in=1, fps=15.0, model="pb4u-small", refine=0))
    assert (half.fps, half.frame_count) == (15.0, 3)
    np.testing.assert_array_equal(half.positions, whole.positions[::2])


def test_a_network_keeps_its_step() -> None:
    with pytest.raises(InputError, match="pb4u-small keeps the time step of its training, 1/30 s: leave out"):
        simulate(Run(SMALL, frames=2, model="pb4u-small", substeps=4))


@pytest.mark.parametrize("count", [0, 10_000, 1.5])
def test_absurd_substeps_are_refused(count: float) -> None:
    with pytest.raises(InputError, match="substeps must be a whole number from 1 to 100"):
        Run(substeps=count)  # type: ignore[arg-type]
