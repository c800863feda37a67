"""Panels and seams of sewn garments in what is written."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from tests.pattern.patterns import gathered, skirt

from pb4u.export.panels import SewnPanels, seam_edges
from pb4u.export.registry import export
from pb4u.garment.material import MATERIALS
from pb4u.geometry.obj_file import read_obj
from pb4u.geometry.topology import joined_indices, uv_islands
from pb4u.pattern.mesh import PatternMesh, mesh_pattern
from pb4u.pattern.sewing import sewn_garment
from pb4u.scene.trajectory import Trajectory, TrajectoryHeader


@pytest.fixture(scope="module")
def mesh() -> PatternMesh:
    return mesh_pattern(skirt(), 200)


@pytest.fixture(scope="module")
def sewn(mesh) -> Trajectory:
    """A skirt at one instant, without a body."""
    places = mesh.sewn(mesh.placed)
    garment = sewn_garment(mesh, places, MATERIALS["default"])
    header = TrajectoryHeader(
        faces=garment.faces,
        rest_positions=places.astype(np.float32),
        pinned=garment.pinned,
        vertex_garment=np.zeros(len(places), dtype=np.int32),
        body_faces=np.array([[0, 1, 2]]),
        body_contact=np.ones(3, dtype=bool),
        fps=30.0,
        metadata={"garments": [{"name": "skirt", "material": None, "panels": list(garment.panels)}]},
        uvs=garment.uvs,
        uv_faces=garment.uv_faces,
        rest_uv=garment.rest_uv,
    )
    body = np.eye(3, dtype=np.float32)[None]
    return Trajectory(header, places[None].astype(np.float32), np.zeros((1, *places.shape), np.float32), body)


@pytest.fixture(scope="module")
def seams(mesh) -> set[tuple[int, int]]:
    """Edges of the seams, by the pattern's own record."""
    ends = [np.column_stack([side[:-1], side[1:]]) for side, _ in mesh.sides]
    return {tuple(row) for row in np.sort(mesh.vertex[np.concatenate(ends)], axis=1).tolist()}


def test_panels_and_seams_are_found_by_the_texture(mesh, sewn, seams):
    panels = SewnPanels.of(sewn.header)
    assert panels.names == tuple(panel.name for panel in skirt().panels)
    assert (panels.of_face == mesh.face_panel).all()
    assert {tuple(row) for row in panels.seams.tolist()} == seams


def test_a_dart_is_a_seam_within_its_panel():
    mesh = mesh_pattern(gathered(), 300)
    assert (uv_islands(mesh.faces) == mesh.face_panel).all()
    # A dart ends within its panel: both sides have a point in common there.
    assert len(seam_edges(mesh.sewn_faces, mesh.faces)) == sum(len(one) - 1 for one, _ in mesh.sides)


def test_garments_without_a_pattern_have_no_panels(sewn):
    plain = sewn.header.with_metadata(garments=[{"name": "skirt"}])
    assert SewnPanels.of(plain) is None
    # Two garments: faces of the one that was not sewn belong to no panel.
    header, count = sewn.header, len(sewn.header.rest_positions)
    both = TrajectoryHeader(
        **vars(header)
        | {
            "faces": joined_indices([header.faces] * 2, [0, count]),
            "uv_faces": joined_indices([header.uv_faces] * 2, [0, len(header.uvs)]),
            "vertex_garment": np.repeat([0, 1], count),
            "metadata": {"garments": [{"name": "plain"}, header.garments[0]]},
        }
    )
    panels = SewnPanels.of(both)
    assert (panels.of_face[: len(header.faces)] == -1).all()
    assert panels.seams.min() >= count


def test_obj_has_a_group_a_panel_and_its_seams_as_lines(mesh, sewn, seams, tmp_path: Path):
    export(sewn, tmp_path / "skirt.obj")
    lines = (tmp_path / "skirt_0000.obj").read_text().splitlines()
    groups = [line[2:] for line in lines if line.startswith("g ")]
    assert set(groups) == {"front_left", "back_left", "front_right", "back_right", "seams"}
    drawn = {tuple(sorted(int(word) - 1 for word in line.split()[1:])) for line in lines if line.startswith("l ")}
    assert drawn == seams
    assert len(read_obj(tmp_path / "skirt_0000.obj").polygons) == len(mesh.faces)


def test_glb_has_the_panel_of_a_vertex_and_the_seams(mesh, sewn, seams, tmp_path: Path):
    export(sewn, tmp_path / "skirt.glb")
    data = (tmp_path / "skirt.glb").read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]

    def array(accessor: int, dtype: str) -> np.ndarray:
        entry = document["accessors"][accessor]
        return np.frombuffer(binary, dtype, entry["count"], document["bufferViews"][entry["bufferView"]]["byteOffset"])

    garment = document["meshes"][0]
    assert garment["extras"]["panels"] == [panel.name for panel in skirt().panels]
    assert {tuple(sorted(row)) for row in np.reshape(garment["extras"]["seams"], (-1, 2)).tolist()} == seams
    primitive = garment["primitives"][0]
    panel, corners = array(primitive["attributes"]["_PANEL"], "<f4"), array(primitive["indices"], "<u4")
    assert (panel[corners].reshape(-1, 3) == mesh.face_panel[:, None]).all()


def test_usd_has_subsets_of_faces_and_of_edges(mesh, sewn, seams, tmp_path: Path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    export(sewn, tmp_path / "skirt.usda")
    stage = Usd.Stage.Open(str(tmp_path / "skirt.usda"))
    garment = UsdGeom.Mesh.Get(stage, "/Scene/Garment")
    panels = UsdGeom.Subset.GetGeomSubsets(garment, UsdGeom.Tokens.face, "panels")
    assert [subset.GetPrim().GetDisplayName() for subset in panels] == [panel.name for panel in skirt().panels]
    for number, subset in enumerate(panels):
        assert list(subset.GetIndicesAttr().Get()) == np.flatnonzero(mesh.face_panel == number).tolist()
    edges = UsdGeom.Subset.GetGeomSubsets(garment, UsdGeom.Tokens.edge)[0].GetIndicesAttr().Get()
    assert {tuple(sorted(row)) for row in np.reshape(edges, (-1, 2)).tolist()} == seams
