"""A bar that moves through a sheet between its vertices, which all stay outside it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from shapes import at_rest, capsule, collider, packed, sheet, time_step

from pb4u.physics.contact.contact_set import nearest_planes
from pb4u.physics.time_step import TimeStep
from pb4u.simulation.pierced_edges import newly_pierced

RADIUS, STRETCH = 0.035, 1.6


def pierced(first: float, last: float, stretch: float = STRETCH) -> tuple[TimeStep, torch.Tensor]:
    """A step in which the bar's axis goes from z = `first` to `last` [m], and a sheet stretched across z = 0."""
    cloth = packed(sheet(7, 6, 0.35, 0.3))
    x = cloth.rest_positions.clone()
    x[:, 0] = stretch * (x[:, 0] - 0.175)
    bar = capsule(height=0.6, radius=RADIUS)
    body = collider(bar.vertices + np.array([0.0, 0.15, first]), bar.faces, np.array([0.0, 0.0, last - first]))
    return time_step(cloth, at_rest(cloth, x), body), x


def test_a_bar_that_ends_between_vertices_hooks_the_edges_across_it() -> None:
    step, x = pierced(-0.08, 0.0)
    assert step.bodies is not None
    # Contact at vertices sees nothing of it.
    assert float(nearest_planes(step.bodies.following, step.garments, x).distance.min()) > 0.004
    surface = step.bodies.following.surfaces[0]
    assert surface is not None
    middles = surface.nearest(x[step.garments.edges].mean(1))
    deep = middles.signed_distance < -0.5 * step.garments.mean_edge_lengths[0]
    assert newly_pierced(step, x) == int(deep.sum()) > 5


def test_what_an_earlier_look_up_at_the_pose_found_farther_away_hides_nothing() -> None:
    step, x = pierced(-0.08, 0.0, stretch=2.0)
    asked_before, _ = pierced(-0.08, 0.0, stretch=2.0)
    assert asked_before.bodies is not None
    nearest_planes(asked_before.bodies.following, asked_before.garments, x + torch.tensor([0.2, 0.0, 0.0]))
    assert newly_pierced(asked_before, x) == newly_pierced(step, x) > 5


@pytest.mark.parametrize(("first", "last"), [(-0.08, -0.04), (0.0, 0.0)])
def test_a_bar_that_stays_before_the_sheet_or_was_through_it_hooks_nothing_new(first: float, last: float) -> None:
    step, x = pierced(first, last)
    assert newly_pierced(step, x) == 0


def test_without_a_body_nothing_is_hooked() -> None:
    cloth = packed(sheet(3, 3))
    assert newly_pierced(time_step(cloth), cloth.rest_positions) == 0
