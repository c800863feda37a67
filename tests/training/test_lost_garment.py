"""A garment is lost when it came apart, came off or sank in, and not before."""

from __future__ import annotations

import pytest
import torch
from tests.training.ball_data import sheet

from pb4u.measures.divergence import DIVERGED_DISTANCE
from pb4u.measures.metrics import strain_percentile
from pb4u.scene.packed import pack
from pb4u.training.lost_garment import MOST_SUNK, SUNK, GarmentWatch, drift_from


@pytest.mark.parametrize(
    ("stretch", "fall", "collision", "lost"),
    [
        (1.0, 0.0, 0.0, False),
        (1.5, 0.0, 0.9 * SUNK, False),
        (1.7, 0.0, 0.0, True),
        (1.0, 0.9 * DIVERGED_DISTANCE, 0.0, False),
        (1.0, 1.1 * DIVERGED_DISTANCE, 0.0, True),
        (float("nan"), 0.0, 0.0, True),
    ],
)
def test_a_garment_is_lost_at_once_when_apart_or_off(stretch, fall, collision, lost):
    garments = pack([sheet(6)])
    rest = garments.rest_positions.clone()
    rest[:, 1] = 0.0
    positions = stretch * rest - torch.tensor([0.0, fall, 0.0])
    # The body is stretched alike, so that only the fall sets them apart.
    drift = drift_from(stretch * rest, garments, positions)
    stretched, deep = strain_percentile(garments, positions), torch.tensor(collision)
    assert bool(GarmentWatch().is_lost(stretched, drift, deep)) is lost


def test_a_garment_that_sinks_in_may_come_out_again():
    watch = GarmentWatch()
    deep, out = 1.1 * SUNK, 0.9 * SUNK
    collisions = [deep] * (MOST_SUNK - 1) + [out] + [deep] * (MOST_SUNK - 1)
    small = torch.tensor(0.1)
    assert not any(watch.is_lost(small, small, torch.tensor(collision)) for collision in collisions)
    assert watch.is_lost(small, small, torch.tensor(torch.nan)), "that is the last step on end"


def test_the_strain_of_a_uniform_stretch_is_its_excess():
    garments = pack([sheet(6)])
    assert strain_percentile(garments, 1.25 * garments.rest_positions) == pytest.approx(0.25, abs=1e-5)
