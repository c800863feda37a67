"""A garment of two fabrics in every format that can hold them, and read back from those that are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import Glb

from pb4u.export.registry import export
from pb4u.export.selection import on_source
from pb4u.export.shading import cloth_parts, fabric_names
from pb4u.garment.garment_file import read_garment
from pb4u.garment.library import build_garment
from pb4u.garment.material import MATERIALS
from pb4u.run import Run, WornGarment
from pb4u.scene.trajectory import Trajectory


@pytest.fixture(scope="module")
def worn() -> Trajectory:
    """A tank top with a hem of denim."""
    shirt = WornGarment("tanktop", {"hem": "denim"}, triangles=900, band_width={"hem": 0.08})
    return Run(garments=(shirt,), frames=1, lead_in=0, model="skinning").simulate()


def hem(trajectory: Trajectory) -> np.ndarray:
    """Faces of denim."""
    return np.flatnonzero(fabric_names(trajectory.header) == "denim")


def test_a_trajectory_tells_old_readers_what_most_of_it_is_made_of(worn: Trajectory, tmp_path: Path) -> None:
    again = Trajectory.open(export(worn, tmp_path / "a.npz"))
    for each in (worn, again):
        assert 0.05 < len(hem(each)) / len(each.faces) < 0.4
        assert each.metadata["material"]["density"] == pytest.approx(0.276)
        assert each.metadata["garments"][0]["material"]["density"] == pytest.approx(0.276)
    np.testing.assert_array_equal(hem(again), hem(worn))


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_what_is_written_is_read_with_its_parts(worn: Trajectory, tmp_path: Path, suffix: str) -> None:
    file = export(worn, tmp_path / f"a.{suffix}")
    if suffix == "obj":
        (file,) = tmp_path.glob("a_*.obj")
    garment = read_garment(file, MATERIALS["default"])
    (name,) = [name for name in garment.parts if "denim" in name]
    middles = garment.vertices[garment.faces].mean(axis=1)[garment.parts[name]]
    expected = worn.positions[0][worn.faces].mean(axis=1)[hem(worn)]
    np.testing.assert_allclose(*(each[np.lexsort(each.round(4).T)] for each in (middles, expected)), atol=2e-6)


def test_glb_has_a_primitive_for_each_fabric(worn: Trajectory, tmp_path: Path) -> None:
    glb = Glb(export(worn, tmp_path / "a.glb"))
    garment = next(mesh for mesh in glb.json["meshes"] if len(mesh["primitives"]) == 2)
    names = [glb.json["materials"][each["material"]]["name"] for each in garment["primitives"]]
    counts = [glb.json["accessors"][each["indices"]]["count"] // 3 for each in garment["primitives"]]
    assert [name.endswith("denim") for name in names].count(True) == 1
    assert sorted(counts) == sorted([len(hem(worn)), len(worn.faces) - len(hem(worn))])


def test_usd_has_a_subset_for_each_fabric(worn: Trajectory, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom, UsdShade

    stage = usd.Stage.Open(str(export(worn, tmp_path / "a.usdc")))
    subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Mesh.Get(stage, "/Scene/Garment"))
    found = {
        UsdShade.MaterialBindingAPI(each.GetPrim()).ComputeBoundMaterial()[0].GetPrim().GetDisplayName(): each
        for each in subsets
    }
    (denim,) = (each for name, each in found.items() if name.endswith("denim"))
    assert list(denim.GetIndicesAttr().Get()) == hem(worn).tolist()
    assert sum(len(each.GetIndicesAttr().Get()) for each in subsets) == len(worn.faces)


def test_alembic_has_a_face_set_for_each_fabric(worn: Trajectory, tmp_path: Path) -> None:
    pytest.importorskip("alembic3d")
    from alembic3d import Abc, AbcGeom

    archive = Abc.IArchive(str(export(worn, tmp_path / "a.abc")))
    schema = AbcGeom.IPolyMesh(archive.getTop().getChild("Garment"), "GarmentShape").getSchema()
    names = [name for name in schema.getFaceSetNames() if name.endswith("denim")]
    assert len(schema.getFaceSetNames()) == 2
    faces = schema.getFaceSet(names[0]).getSchema().getValue().getFaces()
    assert list(faces) == hem(worn).tolist()


def test_files_on_the_mesh_of_an_author_have_them_too(tmp_path: Path) -> None:
    from pb4u.body.library import load_body
    from pb4u.geometry.mesh_file import PolygonMesh
    from pb4u.geometry.obj_file import write_obj

    garment = build_garment("skirt", load_body("woman"), 1400)
    write_obj(tmp_path / "mine.obj", PolygonMesh(garment.vertices, tuple(garment.faces)))
    worn = WornGarment(tmp_path / "mine.obj", {"body": "silk", "hem": "denim"}, triangles=900)
    simulated = Run(garments=(worn,), frames=1, lead_in=0, model="skinning").simulate()
    own = on_source(simulated)
    assert len(own.faces) == len(garment.faces)
    for each in (simulated, own):
        shares = [len(part.faces) / len(each.faces) for part in cloth_parts(each.header)]
        assert len(shares) == 2
        assert 0.0 < min(shares) < 0.15
