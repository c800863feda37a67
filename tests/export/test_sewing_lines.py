"""Hems and turned edges that pictures show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.export.conftest import AROUND, UP

from pb4u.export import picture
from pb4u.export.sewing_lines import HEM, SewingLines, stitches, turned_edges
from pb4u.export.view import View
from pb4u.scene.trajectory import Trajectory


def test_stitches_lie_a_hem_from_the_edge_all_the_way_round(trajectory: Trajectory) -> None:
    header = trajectory.header
    lines, edges = stitches(header), turned_edges(header)
    assert len(edges.face) == 2 * AROUND
    assert len(lines.face) == 4 * AROUND
    heights = lines.of(np.asarray(header.rest_positions))[:, 1]
    np.testing.assert_allclose(np.minimum(heights - 0.6, 1.2 - heights), HEM, atol=2e-3)


def test_one_garment_leaves_no_line_on_another(trajectory: Trajectory) -> None:
    header, count = trajectory.header, AROUND * UP
    both = replace(
        header,
        faces=np.concatenate([header.faces, header.faces + count]),
        rest_positions=np.concatenate([header.rest_positions, header.rest_positions + np.float32([0.0, 0.3, 0.0])]),
        vertex_garment=np.repeat(np.arange(2, dtype=np.int32), count),
    )
    assert len(stitches(both).face) == 8 * AROUND


def test_a_picture_shows_them(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn() -> np.ndarray:
        return next(iter(picture.render(trajectory, [0], View(width=200, height=200)))).astype(int)

    shown = drawn()
    nothing = SewingLines(np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros(0, dtype=np.int64))
    for name in ("stitches", "turned_edges"):
        monkeypatch.setattr(picture, name, lambda header: nothing)
    darker = (drawn() - shown).sum(axis=2) > 20
    assert darker.sum() > 200, "rings around both ends"
    assert darker.mean() < 0.2
