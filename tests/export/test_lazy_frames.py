"""Lazy frames answer as the array that they stand for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pb4u.errors import InputWarning
from pb4u.export.finite_frames import hold_finite, spans
from pb4u.export.selection import on_source
from pb4u.scene.trajectory import Trajectory

KEYS: list[Any] = [
    3, -1, np.int64(2), slice(2, 7), slice(None, None, -2), np.array([4, 4, 0]), (slice(None), slice(1, 3)),
    (5, slice(1, 3)), (slice(None), np.array([0, 2])), (slice(None), 2), (3, 2, 1), (Ellipsis, 1),
]  # fmt: skip


@pytest.mark.parametrize("key", KEYS, ids=str)
def test_indexing_agrees_with_the_full_array(trajectory: Trajectory, broken: Trajectory, key: Any) -> None:
    track = trajectory.header.source
    assert track is not None
    corners = trajectory.positions[:, trajectory.faces[track.triangle]]
    carried = np.einsum("vk,tvkd->tvd", track.barycentric, corners)
    np.testing.assert_allclose(on_source(trajectory).positions[key], carried[key], atol=1e-6)
    with pytest.warns(InputWarning):
        held = hold_finite(broken).positions
    np.testing.assert_array_equal(held[key], broken.positions[[1, 1, 2, 3, 4, 4, 4, 7, 8, 9, 10, 11]][key])


def test_a_broken_trajectory_can_be_carried_and_then_held(broken: Trajectory) -> None:
    with pytest.warns(InputWarning):
        held = hold_finite(on_source(broken))
    assert np.isfinite(held.positions).all()
    np.testing.assert_array_equal(held.positions[6], held.positions[5])


def test_iteration_ends(trajectory: Trajectory) -> None:
    carried = on_source(trajectory).positions
    assert len(list(carried)) == len(carried) == 12
    with pytest.raises(IndexError):
        carried[12]


def test_spans_join_runs() -> None:
    assert spans([3, 7, 8, 9, 12]) == "3, 7-9, 12"
