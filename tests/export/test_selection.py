"""Choosing frames, and carrying motion to the author's own mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pb4u.errors import InputError, InputWarning
from pb4u.export.selection import looks_are_on_source, on_source, select_frames
from pb4u.geometry.appearance import Appearance, Appearances
from pb4u.scene.author_mesh import SourceTrack
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader


@pytest.fixture
def trajectory() -> Trajectory:
    header = TrajectoryHeader(
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        rest_positions=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float),
        pinned=np.zeros(4, dtype=bool),
        vertex_garment=np.zeros(4, dtype=np.int32),
        body_faces=np.array([[0, 1, 2]]),
        body_contact=np.ones(3, dtype=bool),
        fps=30.0,
    )
    rest = header.rest_positions
    return Trajectory.collect(header, (Frame(rest + t, 0 * rest, np.zeros((3, 3))) for t in range(10)))


def test_frames_are_chosen_and_the_rate_follows(trajectory: Trajectory) -> None:
    chosen = select_frames(trajectory, (2, 9), 3)
    assert chosen.frame_count == 3
    assert chosen.fps == 10.0
    np.testing.assert_allclose(chosen.positions[1, 0], 5.0)


@pytest.mark.filterwarnings("error")
def test_a_range_beyond_the_end_is_warned_of(trajectory: Trajectory) -> None:
    with pytest.warns(InputWarning, match=r"10 frames.*7:100.*7:10"):
        assert select_frames(trajectory, (7, 100), 1).frame_count == 3
    assert select_frames(trajectory, (7, 10), 1).frame_count == 3


@pytest.mark.parametrize("span", [(10, 12), (30, 40)])
def test_an_empty_choice_is_refused(trajectory: Trajectory, span: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="frames 0 to 9"):
        select_frames(trajectory, span, 1)


def test_motion_is_carried_to_the_source_in_its_own_order_with_its_uvs(trajectory: Trajectory) -> None:
    uvs = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]])
    track = SourceTrack(
        faces=np.array([[2, 1, 0]]),
        triangle=np.array([1, 0, 0]),
        barycentric=np.array([[0, 0, 1], [0, 1, 0], [1 / 3, 1 / 3, 1 / 3]]),
        uvs=uvs,
        uv_faces=np.array([[2, 1, 0]]),
    )
    carried = on_source(Trajectory(replace(trajectory.header, source=track), *_arrays(trajectory)))
    expected = np.array([[0, 1, 0], [1, 0, 0], [2 / 3, 1 / 3, 0]])
    np.testing.assert_allclose(carried.positions[4], expected + 4, atol=1e-6)
    np.testing.assert_array_equal(carried.faces, track.faces)
    np.testing.assert_array_equal(carried.header.uvs, uvs)
    (whole,) = carried.header.garments
    assert (whole["vertices"], whole["triangles"]) == ([0, 3], [0, 1])
    assert on_source(trajectory) is trajectory


def test_bands_are_carried_to_the_source_without_what_their_elastic_gathers(trajectory: Trajectory) -> None:
    track = SourceTrack(np.array([[2, 1, 0]]), np.array([0, 0, 1]), np.eye(3))
    layers, trims = np.array([[1.0, 0.0], [0.5, 1.0]]), np.array([[0.0, 1.0], [1e-4, 0.8]])
    header = replace(trajectory.header, source=track, material_layers=layers, trims=trims)
    carried = on_source(Trajectory(header, *_arrays(trajectory))).header
    np.testing.assert_array_equal(carried.material_layers, [[0.5, 1.0]])
    np.testing.assert_array_equal(carried.trims, [[1e-4, 1.0]])


def _arrays(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return trajectory.positions, trajectory.velocities, trajectory.body_positions


def test_the_rows_of_each_garment_are_those_on_the_source(trajectory: Trajectory) -> None:
    worn = [
        {"name": "a", "vertices": [0, 2], "triangles": [0, 1]},
        {"name": "b", "vertices": [2, 4], "triangles": [1, 2]},
    ]
    track = SourceTrack(
        faces=np.array([[0, 1, 2], [3, 4, 5], [3, 5, 6]]),
        triangle=np.array([0, 0, 0, 1, 1, 1, 1]),
        barycentric=np.eye(3)[[0, 1, 0, 1, 1, 2, 2]],
    )
    header = replace(
        trajectory.header, faces=np.array([[0, 1, 1], [2, 3, 3]]), vertex_garment=np.array([0, 0, 1, 1], np.int32),
        source=track, metadata={"garments": worn},
    )  # fmt: skip
    found = on_source(Trajectory(header, *_arrays(trajectory))).header.garments
    assert [(each["vertices"], each["triangles"]) for each in found] == [([0, 3], [0, 1]), ([3, 7], [1, 3])]


def test_colours_on_the_authors_mesh_alone_are_looked_for_garment_by_garment(trajectory: Trajectory) -> None:
    track = SourceTrack(
        faces=np.array([[0, 1, 2], [3, 4, 5]]),
        triangle=np.array([0, 0, 0, 1, 1, 1]),
        barycentric=np.eye(3)[[0, 1, 2] * 2],
    )
    header = replace(
        trajectory.header, faces=np.array([[0, 1, 1], [2, 3, 3]]), vertex_garment=np.array([0, 0, 1, 1], np.int32)
    )
    plain, first, both = (
        Appearances((Appearance("red"),), np.array(of_face)) for of_face in ([-1, -1], [0, -1], [0, 0])
    )
    cases = ((None, None, False), (None, both, True), (first, both, True), (both, both, False), (first, first, False))
    for simulated, author, wanted in (*cases, (first, plain, False)):
        there = replace(header, appearances=simulated, source=replace(track, appearances=author))
        assert looks_are_on_source(there) is wanted
