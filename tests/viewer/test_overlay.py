"""Numbers on the cloth: the right ones, in the colours of their legend."""

from __future__ import annotations

import json
import struct
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from tests.viewer.clips import frame, header, trajectory, tube

from pb4u.collision.crossings import self_crossings
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.material import load_material
from pb4u.scene.packed import pack
from pb4u.scene.trajectory import Trajectory
from pb4u.viewer.clip import RecordedClip
from pb4u.viewer.overlay import OVERLAYS, ColourScale, Penetration, SelfIntersections, Strain, UpdateScale
from pb4u.viewer.surface import coloured_glb


def test_strain_of_a_widened_tube_is_its_widening() -> None:
    overlay = Strain(RecordedClip(trajectory(2, widen=0.02), "wide"))
    # Between the rings all edges around are a tenth longer, and nothing else changes.
    np.testing.assert_allclose(overlay.values(0), 0.1, atol=2e-3)


def test_penetration_is_the_signed_distance_to_the_body() -> None:
    outside = Penetration(RecordedClip(trajectory(2), "a")).values(1)
    inside = Penetration(RecordedClip(trajectory(2, widen=-0.04), "b")).values(1)
    flat = np.cos(np.pi / 12)
    np.testing.assert_allclose(outside, 0.20 - 0.17, atol=0.03 * (1 - flat) + 1e-3)
    assert (inside < -0.005).all()


def test_penetration_needs_a_closed_body() -> None:
    closed = trajectory(2)
    head = header(lids=False)
    open_body = Trajectory(head, closed.positions, closed.velocities, closed.body_positions[:, :-2])
    with pytest.raises(InputError, match="not a closed surface"):
        Penetration(RecordedClip(open_body, "open"))


def test_cloth_that_crosses_is_painted_and_no_other() -> None:
    made = trajectory(2)
    # One vertex of the second frame is drawn through the tube and out on its other side.
    made.positions[1, 40] *= [-2.0, 1.0, -2.0]
    overlay = SelfIntersections(RecordedClip(made, "a"))
    assert not overlay.values(0).any()
    pairs = self_crossings(made.positions[1], made.faces)
    assert len(pairs)
    np.testing.assert_array_equal(np.flatnonzero(overlay.values(1)), np.unique(made.faces[pairs]))


def test_update_scale_is_the_mean_edge_at_a_vertex_over_the_reference() -> None:
    overlay = UpdateScale(RecordedClip(trajectory(2), "a"))
    points, faces = tube(0.20, 0.8, 1.3, lids=False)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    at = (edges == 40).any(axis=1)
    lengths = np.linalg.norm(points[edges[at, 0]] - points[edges[at, 1]], axis=1)
    assert overlay.values(0)[40] == pytest.approx(lengths.mean() / 0.015, rel=1e-5)
    assert "K = 2 by the paper's rule" in overlay.notes[0]  # floor(0.225 m / 0.11 m)


def test_every_garment_has_its_own_propagation_steps() -> None:
    """Two tubes packed, the outer one twice as large in every direction, so that its edges are twice as long."""
    points, faces = tube(0.20, 0.8, 1.3, lids=False)
    inner, outer = (
        Garment(name, size * points, faces, load_material("default"), np.zeros(len(points), dtype=bool))
        for name, size in (("inner", 1.0), ("outer", 2.0))
    )
    overlay = UpdateScale(RecordedClip(trajectory(2), "a"))
    alone = overlay.notes[0].split("mean edge ")[1]
    overlay = UpdateScale(RecordedClip(trajectory(2), "a"))
    overlay.ruler = SimpleNamespace(garments=pack([inner, outer]))  # type: ignore[assignment]
    overlay.clip.header.metadata["propagation_steps"] = 2  # the most of all garments
    first, second = overlay.notes
    assert first.startswith("a, inner: K = 2 by the paper's rule")
    assert first.endswith(alone)
    assert second.startswith("a, outer: K = 1 by the paper's rule")
    values = overlay.values(0)
    np.testing.assert_allclose(values[len(points) :], 2 * values[: len(points)], rtol=1e-6)


def test_painted_frames_are_kept() -> None:
    overlay = Strain(RecordedClip(trajectory(3, widen=0.02), "a"))
    assert overlay.colours(1) is overlay.colours(1)
    assert overlay.colours(0) is not overlay.colours(1)


def test_colours_run_between_the_ends_and_stay_there() -> None:
    scale = ColourScale("x", 0.0, 2.0, "0", "2", "gray")
    colours = scale.vertex_colours(np.array([-1.0, 0.0, 1.0, 2.0, 9.0, np.nan]))
    assert colours[:, 0].tolist()[:2] == [0, 0]
    assert colours[3].tolist() == colours[4].tolist() == [255, 255, 255, 255]
    # Half of the way on the screen is about a fifth of the light.
    assert colours[2, 0] == pytest.approx(0.212 * 255, abs=3)
    assert colours[5].tolist() == colours[1].tolist()
    legend = scale.legend(("a < b",))
    assert "#000000" in legend
    assert "#ffffff" in legend
    assert "a &lt; b" in legend


def test_a_coloured_mesh_is_read_back_by_another_reader() -> None:
    points, colours = frame(0).positions, np.full((len(frame(0).positions), 4), 255, dtype=np.uint8)
    colours[7] = (10, 20, 30, 255)
    data = coloured_glb(points, colours, header().faces)
    mesh = trimesh.load(trimesh.util.wrap_as_stream(data), file_type="glb", process=False, force="mesh")
    np.testing.assert_array_equal(mesh.vertices, points)
    np.testing.assert_array_equal(mesh.faces, header().faces)
    (size,) = struct.unpack("<I", data[12:16])
    document = json.loads(data[20 : 20 + size])
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    view = document["bufferViews"][document["accessors"][attributes["COLOR_0"]]["bufferView"]]
    painted = np.frombuffer(data, np.uint8, view["byteLength"], 20 + size + 8 + view["byteOffset"])
    np.testing.assert_array_equal(painted.reshape(-1, 4), colours)
    # The normals are named, so that the browser shades smoothly, but take no bytes.
    assert "bufferView" not in document["accessors"][attributes["NORMAL"]]


def test_every_overlay_paints_or_does_not() -> None:
    clip = RecordedClip(trajectory(2), "a")
    painted = {name for name, overlay in OVERLAYS.items() if overlay(clip).scale is not None}
    assert painted == {"strain", "penetration", "self-intersections", "skin through cloth", "K and update scale"}
    assert [name for name, overlay in OVERLAYS.items() if overlay.wireframe] == ["wireframe"]
