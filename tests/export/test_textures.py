"""Images and colours of a garment's file: kept in GLB, USD, pictures, trajectories and mended meshes."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from tests.export.readers import Glb

from pb4u.errors import InputError, InputWarning
from pb4u.export.registry import export
from pb4u.export.selection import on_source
from pb4u.export.view import View
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_garment
from pb4u.garment.material import Material
from pb4u.garment.texture import textured
from pb4u.geometry.appearance import Appearance, Appearances, read_image
from pb4u.geometry.mesh_file import read_mesh
from pb4u.geometry.obj_file import read_obj, write_obj
from pb4u.scene.trajectory import Trajectory

CLOTH = Material.named("cotton")
RED = (220, 40, 40)


def png(colour: tuple[int, int, int] = RED, corner: tuple[int, int, int] = (20, 60, 200)) -> bytes:
    """An image of 16 x 16 pixels whose lower left quarter differs from the rest."""
    pixels = np.full((16, 16, 3), colour, dtype=np.uint8)
    pixels[8:, :8] = corner
    written = io.BytesIO()
    Image.fromarray(pixels).save(written, "PNG")
    return written.getvalue()


@pytest.fixture
def printed(trajectory: Trajectory) -> Trajectory:
    """The tube, its lower faces with an image and its upper ones green."""
    upper = trajectory.positions[0][trajectory.faces[:, 0], 1] > 0.9
    listed = (Appearance("print", image=png()), Appearance("plain", (26 / 255, 102 / 255, 51 / 255)))
    header = replace(trajectory.header, appearances=Appearances(listed, upper.astype(np.int64)), source=None)
    return replace(trajectory, header=header)


def shirt(folder: Path) -> Path:
    """Two quads of two materials that meet at a UV seam."""
    (folder / "check pattern.png").write_bytes(png())
    (folder / "shirt.mtl").write_text(
        "newmtl body\nKd 0.1 0.1 0.1\nmap_Kd -s 1 1 1 C:\\work\\check pattern.png\nnewmtl sleeve\nKd 0 1 0.5\n"
    )
    (folder / "shirt.obj").write_text(
        "mtllib shirt.mtl\nv 0 1 0\nv 0.3 1 0\nv 0.3 1.3 0\nv 0 1.3 0\nv 0.6 1 0\nv 0.6 1.3 0\n"
        "vt 0 0\nvt 0.5 0\nvt 0.5 1\nvt 0 1\nvt 0.6 0\nvt 1 0\nvt 1 1\nvt 0.6 1\n"
        "usemtl body\nf 1/1 2/2 3/3 4/4\nusemtl sleeve\nf 2/5 5/6 6/7 3/8\n"
    )
    return folder / "shirt.obj"


def test_an_obj_brings_the_images_and_colours_of_its_mtl(tmp_path: Path) -> None:
    with pytest.warns(InputWarning, match="quads"):
        garment = read_garment(shirt(tmp_path), CLOTH)
    looks = garment.appearances
    assert looks is not None
    assert [each.name for each in looks.listed] == ["body", "sleeve"]
    assert looks.listed[0] == Appearance("body", image=png())
    assert looks.listed[1] == Appearance("sleeve", (0.0, 1.0, 0.5))
    assert looks.of_face.tolist() == [0, 0, 1, 1]
    assert garment.source is not None
    assert garment.source.source.appearances is not None
    assert garment.source.source.appearances.of_face.tolist() == [0, 1]


def test_a_missing_image_is_said_and_leaves_its_colour(tmp_path: Path) -> None:
    file = shirt(tmp_path)
    (tmp_path / "check pattern.png").unlink()
    with pytest.warns(InputWarning, match=r"shirt\.mtl.*pattern\.png"):
        looks = read_obj(file).appearances
    assert looks is not None
    assert looks.listed[0] == Appearance("body", (0.1, 0.1, 0.1))


def test_a_texture_that_is_missing_or_no_image_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="There is no image"):
        read_image(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(InputError, match=r"text\.png is not an image"):
        read_image(tmp_path / "text.png")
    Image.new("RGB", (4, 4), RED).save(tmp_path / "old.bmp")
    assert read_image(tmp_path / "old.bmp").startswith(b"\x89PNG")


def test_a_mended_mesh_keeps_images_and_colours(tmp_path: Path) -> None:
    mesh = read_obj(shirt(tmp_path))
    (tmp_path / "out").mkdir()
    write_obj(tmp_path / "out" / "mended.obj", mesh)
    again = read_obj(tmp_path / "out" / "mended.obj").appearances
    assert again is not None
    assert mesh.appearances is not None
    assert again.listed == mesh.appearances.listed
    np.testing.assert_array_equal(again.of_face, mesh.appearances.of_face)


def test_a_trajectory_file_keeps_them(printed: Trajectory, tmp_path: Path) -> None:
    looks = Trajectory.open(printed.save(tmp_path / "run.npz")).header.appearances
    assert looks is not None
    assert printed.header.appearances is not None
    assert looks.listed == printed.header.appearances.listed
    np.testing.assert_array_equal(looks.of_face, printed.header.appearances.of_face)
    broken = replace(printed.header, appearances=Appearances(looks.listed, looks.of_face + 1))
    with pytest.raises(InputError, match="its appearances cannot be read"):
        Trajectory.open(replace(printed, header=broken).save(tmp_path / "broken.npz"))


def test_glb_has_the_image_and_a_material_for_each_part(printed: Trajectory, tmp_path: Path) -> None:
    file = export(printed, tmp_path / "tube.glb")
    materials = Glb(file).json["materials"]
    assert [each["name"] for each in materials] == ["print", "plain", "body"]
    assert "baseColorTexture" not in materials[1]["pbrMetallicRoughness"]
    lower = next(part for part in trimesh.load(file).geometry.values() if part.visual.material.name == "print")
    np.testing.assert_array_equal(np.asarray(lower.visual.material.baseColorTexture), _pixels())
    np.testing.assert_array_equal(lower.visual.to_color().vertex_colors[:, :3].max(axis=0), [220, 60, 200])


def test_a_glb_is_read_as_one_mesh_with_its_seam_closed(printed: Trajectory, tmp_path: Path) -> None:
    from pb4u.export.gltf import write_glb

    write_glb(printed, tmp_path / "tube.glb", body=False)
    mesh = read_mesh(tmp_path / "tube.glb", lambda count: None)
    positions = printed.positions[0]
    order = np.abs(mesh.vertices[:, None] - positions).max(axis=2).argmin(axis=1)
    assert len(np.unique(order)) == len(mesh.vertices) == len(positions)
    assert mesh.appearances is not None
    assert mesh.uvs is not None
    assert mesh.polygon_uvs is not None
    assert [each.name for each in mesh.appearances.listed] == ["print", "plain"]
    given = {
        tuple(face): (uvs, look)
        for face, uvs, look in zip(
            printed.faces.tolist(),
            printed.header.uvs[printed.header.uv_faces],
            printed.header.appearances.of_face,
            strict=True,
        )
    }
    for face, uv_face, look in zip(mesh.polygons, mesh.polygon_uvs, mesh.appearances.of_face, strict=True):
        uvs, expected = given[tuple(order[face].tolist())]
        np.testing.assert_allclose(mesh.uvs[uv_face], uvs, atol=1e-6)
        assert look == expected


def test_usd_binds_a_material_to_each_part_and_brings_the_image(printed: Trajectory, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdShade

    for suffix in ("usdc", "usda"):
        folder = tmp_path / suffix
        folder.mkdir()
        stage = usd.Stage.Open(str(export(printed, folder / f"tube.{suffix}")))
        lower, upper = (stage.GetPrimAtPath(f"/Scene/Garment/part_{k}") for k in range(2))
        looks = printed.header.appearances.of_face
        assert list(lower.GetAttribute("indices").Get()) == np.flatnonzero(looks == 0).tolist()
        assert list(upper.GetAttribute("indices").Get()) == np.flatnonzero(looks == 1).tolist()
        material = UsdShade.MaterialBindingAPI(lower).ComputeBoundMaterial()[0]
        image = UsdShade.Shader(stage.GetPrimAtPath(material.GetPath().AppendChild("image")))
        assert Path(image.GetInput("file").Get().resolvedPath).read_bytes() == png()
        assert (folder / "tube.texture0.png").read_bytes() == png()
    with zipfile.ZipFile(export(printed, tmp_path / "tube.usdz")) as package:
        assert any(package.read(name) == png() for name in package.namelist())


def test_usd_keeps_images_of_others_that_have_its_names(printed: Trajectory, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "tube.texture0.png").write_text("own")
    with pytest.raises(InputError, match=r"tube\.texture0\.png exists"):
        export(printed, tmp_path / "tube.usda")
    assert (tmp_path / "tube.texture0.png").read_text() == "own"
    export(printed, tmp_path / "tube.usdz")
    for suffix in ("usdc", "usda", "usdc"):
        export(printed, tmp_path / f"other.{suffix}")


def test_pictures_show_the_image_right_way_up_unless_a_colour_is_asked_for(printed: Trajectory, tmp_path: Path) -> None:
    view = View(width=96, height=96, azimuth=0.0, show_body=False)
    seen = np.asarray(Image.open(export(printed, tmp_path / "tube.png", view=view)).convert("HSV"))
    hue = seen[seen[..., 1] > 100][:, 0]
    shares = [float(np.mean(np.abs(hue.astype(int) - at) < 12)) for at in (0, 160, 102)]
    assert shares[0] > 0.03  # upside down, it would be red below
    assert shares[1] > 0.3
    assert shares[2] > 0.3
    view = replace(view, cloths=((1.0, 1.0, 0.0),))
    seen = np.asarray(Image.open(export(printed, tmp_path / "tube.png", view=view)).convert("HSV"))
    assert np.abs(seen[seen[..., 1] > 100][:, 0].astype(int) - 42).max() < 12


def test_a_remeshed_garment_is_shown_on_its_own_mesh(
    printed: Trajectory, trajectory: Trajectory, tmp_path: Path
) -> None:
    assert trajectory.header.source is not None
    looks = Appearances((Appearance("print", image=png()),), np.zeros(2, dtype=np.int64))
    source = replace(trajectory.header.source, appearances=looks)
    remeshed = replace(trajectory, header=replace(trajectory.header, source=source))
    glb = Glb(export(remeshed, tmp_path / "tube.glb"))
    assert glb.json["materials"][0]["name"] == "print"
    shown = on_source(remeshed)
    assert glb.json["accessors"][glb.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"] >= 5
    assert shown.header.appearances is looks


def test_a_texture_is_laid_on_by_the_uvs_or_from_the_front() -> None:
    vertices = np.array([[0.0, 1, 0], [0.5, 1, 0], [0, 2, 0]])
    plain = Garment("plain", vertices, np.array([[0, 1, 2]]), CLOTH)
    worn = textured(plain, png())
    assert worn.appearances is not None
    np.testing.assert_allclose(worn.uvs, [[0.25, 0], [0.75, 0], [0.25, 1]])
    mapped = textured(replace(plain, uvs=vertices[:, :2], uv_faces=plain.faces), png())
    np.testing.assert_array_equal(mapped.uvs, vertices[:, :2])


def test_beside_a_garment_without_uvs_the_other_keeps_its_own(tmp_path: Path) -> None:
    from pb4u.scene.author_mesh import joined_uvs

    uvs, uv_faces = joined_uvs([(None, None, 2), (np.eye(2), np.array([[0, 1, 0]]), 1)])
    assert uvs is not None
    assert uv_faces is not None
    np.testing.assert_array_equal(uvs[uv_faces[2]], np.eye(2)[[0, 1, 0]])
    np.testing.assert_array_equal(uvs[uv_faces[:2]], 0.0)


def _pixels() -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png())))


def test_an_image_of_several_parts_is_written_once(printed: Trajectory, tmp_path: Path) -> None:
    looks = printed.header.appearances
    assert looks is not None
    both = replace(looks, listed=tuple(replace(each, image=png()) for each in looks.listed))
    shared = replace(printed, header=replace(printed.header, appearances=both))
    glb = Glb(export(shared, tmp_path / "tube.glb"))
    assert len(glb.json["images"]) == len(glb.json["textures"]) == 1
    for material in glb.json["materials"][:2]:
        assert material["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}
    pytest.importorskip("pxr")
    export(shared, tmp_path / "tube.usdc")
    assert [file.name for file in tmp_path.glob("tube.texture*")] == ["tube.texture0.png"]
