"""Hems and turned edges that pictures show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.export.conftest import AROUND, UP

from pb4u.export import picture, still_renderer
from pb4u.export.registry import export
from pb4u.export.sewing_lines import HEM, sewing_lines
from pb4u.export.shading import cloth_parts
from pb4u.export.view import View
from pb4u.scene.assembly import make_scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import SkinningSimulator


def test_stitches_lie_a_hem_from_the_edge_all_the_way_round(trajectory: Trajectory) -> None:
    header = trajectory.header
    both = sewing_lines(header)
    for width, depth in ((0.005, 0.0025), (0.0015, HEM)):
        lines = both.at(both.width == width)
        assert len(lines.face) == 4 * AROUND
        heights = lines.of(np.asarray(header.rest_positions))[:, 1]
        np.testing.assert_allclose(np.minimum(heights - 0.6, 1.2 - heights), depth, atol=2e-3)


def test_one_garment_leaves_no_line_on_another(trajectory: Trajectory) -> None:
    header, count = trajectory.header, AROUND * UP
    higher = np.array([0.0, 0.3, 0.0], dtype=np.float32)
    both = replace(
        header,
        faces=np.concatenate([header.faces, header.faces + count]),
        rest_positions=np.concatenate([header.rest_positions, header.rest_positions + higher]),
        vertex_garment=np.repeat(np.arange(2, dtype=np.int32), count),
    )
    assert len(sewing_lines(both).face) == 16 * AROUND


@pytest.mark.parametrize("with_uvs", [True, False])
def test_a_picture_shows_them(trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch, with_uvs: bool) -> None:
    if not with_uvs:
        trajectory = replace(trajectory, header=replace(trajectory.header, uvs=None, uv_faces=None))

    def drawn() -> np.ndarray:
        return next(iter(picture.render(trajectory, [0], View(width=200, height=200)))).astype(int)

    shown, nothing = drawn(), np.zeros(8 * AROUND, dtype=bool)
    monkeypatch.setattr(
        still_renderer, "sewn_parts", lambda header, _: (cloth_parts(header), sewing_lines(header).at(nothing))
    )
    plain = drawn()
    darker = (plain - shown).sum(axis=2) > 8
    background = plain[0, 0]
    assert ((plain == background).all(axis=2) & (shown != background).any(axis=2)).sum() < 40, "within the outline"
    assert darker.sum() > 100, "rings around both ends"
    assert darker.mean() < 0.2


def test_seams_of_a_built_in_garment_are_smooth_lines_between_its_panels() -> None:
    header = SkinningSimulator().header(make_scene("tshirt", frames=1, triangles=1200))
    lines = sewing_lines(header)
    rest = np.asarray(header.rest_positions, dtype=float)
    ends = lines.of(rest)[:, :2].reshape(-1, 2, 2)
    stitched = lines.width == 0.0015
    aside = stitched & (np.abs(ends[..., 0]).min(axis=1) > 0.1) & (np.abs(ends[..., 1] - 1.05).max(axis=1) < 0.1)
    # Both sides, of panels whose triangles meet in zigzags of 2 cm.
    ends = np.abs(ends[aside].reshape(-1, 2))
    assert len(ends) > 12
    assert np.abs(ends[:, 0] - np.polyval(np.polyfit(ends[:, 1], ends[:, 0], 2), ends[:, 1])).max() < 0.02


def test_glb_has_them_as_an_image(trajectory: Trajectory, tmp_path: Path) -> None:
    mesh = trimesh.load_scene(export(trajectory, tmp_path / "tube.glb")).geometry["garment"]
    pixels = np.asarray(mesh.visual.material.baseColorTexture)
    # Its UVs span the width once, and 0.6 m of height from 0.1 to 0.9.
    dark = np.flatnonzero((pixels < 255).mean(axis=1) > 0.8)
    heights = 0.6 * ((1.0 - dark / len(pixels)) - 0.1) / 0.8
    for depth in (0.0025, HEM):
        assert (np.abs(heights - depth) < 2e-3).any()
        assert (np.abs(0.6 - heights - depth) < 2e-3).any()
    assert (np.minimum(heights, 0.6 - heights) < HEM + 3e-3).all()
    # Where UVs leave the unit square an image would come again.
    header = replace(trajectory.header, uvs=2.0 * np.asarray(trajectory.header.uvs))
    (part,) = cloth_parts(header)
    assert sewing_lines(header).drawn_on(header, part) is None
