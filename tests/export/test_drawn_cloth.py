"""Cloth as it is drawn: smooth where its mesh is coarse, with its lines on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.export.conftest import AROUND, UP, tube_at

from pb4u.export.drawn_cloth import DrawnCloth
from pb4u.export.sewing_lines import HEM, sewing_lines
from pb4u.geometry.subdivision import split_faces
from pb4u.scene.trajectory import Trajectory


def roundness(points: np.ndarray, faces: np.ndarray) -> float:
    """Largest angle [degrees] between faces that share an edge."""
    a, b, c = points[faces].transpose(1, 0, 2).astype(float)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    halves = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, edge, count = np.unique(halves, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.ravel(), kind="stable")
    pairs = order[np.flatnonzero(count[edge.ravel()[order]] == 2)].reshape(-1, 2) // 3
    return float(np.rad2deg(np.arccos(np.clip((normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1), -1, 1))).max())


def round_tube() -> np.ndarray:
    angle, height = np.meshgrid(2 * np.pi * np.arange(AROUND) / AROUND, np.linspace(0.6, 1.2, UP))
    return np.stack([0.2 * np.cos(angle), height, 0.2 * np.sin(angle)], axis=-1).reshape(-1, 3).astype(np.float32)


def test_a_tube_is_rounder_and_no_thinner(trajectory: Trajectory) -> None:
    drawn = DrawnCloth(trajectory.header)
    assert len(drawn.faces) == 4 * len(trajectory.faces)
    smooth = drawn.at(round_tube())
    assert roundness(smooth, drawn.faces) < 0.65 * roundness(round_tube(), trajectory.faces)
    radius = np.linalg.norm(smooth[:, [0, 2]], axis=1)
    # Between the vertices, chords are nearer to the middle: skin under them would show more than it does now.
    assert 0.2 * np.cos(np.pi / AROUND) < radius.min() < radius.max() < 0.2005
    assert (smooth[:, 1].min(), smooth[:, 1].max()) == pytest.approx((0.6, 1.2), abs=1e-6)


def test_dense_garments_are_drawn_as_they_are(trajectory: Trajectory) -> None:
    drawn = DrawnCloth(trajectory.header, coarse=len(trajectory.faces))
    np.testing.assert_array_equal(drawn.faces, trajectory.faces)
    np.testing.assert_array_equal(drawn.at(tube_at(3)), tube_at(3))


@pytest.mark.parametrize("coarse", [0, 8000])
def test_lines_lie_on_the_faces_that_they_are_said_to(trajectory: Trajectory, coarse: int) -> None:
    header = trajectory.header
    drawn, given = DrawnCloth(header, coarse), sewing_lines(header)
    lines = drawn.lines(given)
    corners = drawn.faces[lines.face]
    for end in lines.ends.reshape(-1, 4).T:
        assert (corners == end[:, None]).any(axis=1).all()
    # Cut in pieces, they are as long as they were, and at their distance from the edge.
    rest = np.asarray(header.rest_positions, dtype=np.float64)
    chosen = np.full(len(header.faces), len(header.faces) < coarse)
    flat = split_faces(header.faces, len(rest), chosen).between(rest)
    pieces, whole = (
        np.linalg.norm(np.diff(ends.reshape(-1, 2, 3), axis=1), axis=2).sum()
        for ends in (lines.of(flat), given.of(rest))
    )
    assert pieces == pytest.approx(whole, rel=1e-6)
    stitches = lines.at(lines.width == 0.0015)
    heights = stitches.of(flat)[:, 1]
    np.testing.assert_allclose(np.minimum(heights - 0.6, 1.2 - heights), HEM, atol=2e-3)


def test_uvs_are_cut_in_straight_lines(trajectory: Trajectory) -> None:
    header = trajectory.header
    drawn = DrawnCloth(header)
    assert drawn.uv_faces is not None
    uvs = drawn.uvs(header.uvs)
    assert uvs is not None
    assert header.uvs is not None
    assert header.uv_faces is not None
    middle = uvs[drawn.uv_faces].mean(axis=1).reshape(-1, 4, 2).mean(axis=1)
    np.testing.assert_allclose(middle, header.uvs[header.uv_faces].mean(axis=1), atol=1e-12)
    bare = replace(header, uvs=None, uv_faces=None)
    assert DrawnCloth(bare).uvs(None) is None
