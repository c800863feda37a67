"""Parts by name: bands along borders, and what is laid on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.garment.cloth_shapes import CLOTH, tube_arrays
from tests.physics.shapes import sheet, tube

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.garment.material import MATERIALS, DirectionalBending
from pb4u.garment.parts import Parts
from pb4u.geometry.appearance import Appearance, Appearances
from pb4u.run import WornGarment
from pb4u.scene.loaded_garments import load_garment

DENIM = MATERIALS["denim"]


@pytest.fixture(scope="module")
def woman() -> ShapedBody:
    return load_body("woman")


def loaded(garment: Garment | str, body: ShapedBody | None = None, **asked: object) -> Garment:
    return load_garment(WornGarment(garment, **asked), body)


def prism(across: int, along: int) -> Garment:
    """A square tube of 1 m around and 0.6 m high, however many triangles it has."""
    corner = np.linspace(0.0, 0.25, across, endpoint=False)
    far, none = np.full(across, 0.25), np.zeros(across)
    x = np.concatenate([corner, far, 0.25 - corner, none])
    z = np.concatenate([far, 0.25 - corner, none, corner])
    shape = tube(4 * across, along, 1.0, 0.6, CLOTH)
    height = np.linspace(0.0, 0.6, along + 1)
    vertices = np.stack(np.broadcast_arrays(x[:, None], height, z[:, None]), axis=2).reshape(-1, 3)
    return replace(shape, vertices=vertices)


@pytest.mark.parametrize(
    ("name", "bands"),
    [
        pytest.param("tshirt", ["collar", "hem", "cuff", "border"], marks=pytest.mark.slow),
        ("tanktop", ["collar", "hem", "cuff", "border"]),
        pytest.param("longsleeve", ["collar", "hem", "cuff", "border"], marks=pytest.mark.slow),
        pytest.param("cardigan", ["collar", "hem", "cuff", "border"], marks=pytest.mark.slow),
        pytest.param("trousers", ["waist", "hem", "border"], marks=pytest.mark.slow),
        ("skirt", ["waist", "hem", "border"]),
    ],
)
def test_built_in_garments_have_bands_where_their_names_say(name: str, bands: list[str], woman: ShapedBody) -> None:
    garment = build_garment(name, woman, 1500)
    parts = Parts(garment)
    assert list(parts.names) == bands
    middles = garment.vertices[garment.faces].mean(axis=1)
    upper, lower = middles[:, 1] > middles[:, 1].max() - 0.15, middles[:, 1] < middles[:, 1].min() + 0.08
    for band in bands:
        inside = parts.named(band).share > 0.0
        assert inside.any()
        if band in ("collar", "waist"):
            assert upper[inside].all()
        if band == "hem":
            assert lower[inside].all()
        if band == "cuff":
            assert (np.abs(middles[inside, 0]) > 0.08).all()
            assert set(np.sign(middles[inside, 0])) == {-1.0, 1.0}


@pytest.mark.parametrize(("across", "along"), [(12, 26), (25, 55), (38, 82), (47, 101)])
def test_the_mass_of_a_banded_garment_is_that_of_its_cloth_at_every_count(across: int, along: int) -> None:
    garment = loaded(
        prism(across, along), None, pins="none", material={"waist": DENIM}, layers={"hem": 3, "waist": 2},
        elastic={"waist": 0.8}, band_width={"waist": 0.035, "hem": 0.0123},
    )  # fmt: skip
    assert 2_400 < len(garment.faces) < 38_500
    expected = 0.2 * (0.6 - 0.035 + 2 * 0.0123) + 2 * 0.4 * 0.035
    assert garment.vertex_masses.sum() == pytest.approx(expected, rel=1e-6)


def test_layers_are_as_stiff_as_all_of_them_and_interfacing_adds_its_own() -> None:
    plain = prism(6, 12)
    garment = loaded(plain, None, pins="none", layers={"hem": 2}, interfacing={"waist": 1e-4})
    hem, waist = (Parts(plain).named(name).share for name in ("hem", "waist"))
    for name in ("density", "thickness"):
        np.testing.assert_allclose(garment.of_faces(name), getattr(CLOTH, name) * (1.0 + hem))
    np.testing.assert_allclose(garment.of_faces("membrane"), np.outer(1.0 + hem, CLOTH.membrane))
    np.testing.assert_allclose(garment.of_faces("bending"), CLOTH.bending * (1.0 + hem) + 4e-4 * waist)
    assert garment.hinge_bending.max() > 2.0 * CLOTH.bending


def test_a_fabric_of_a_band_is_mixed_by_area_along_the_grain() -> None:
    twill = replace(DENIM, bending_stiffness=DirectionalBending(6e-5, 3e-5, 4e-5))
    garment = loaded(sheet(8, 8, 0.4, 0.4, CLOTH), None, pins="none", grain=(0, 1, 0), material={"border": twill})
    share = Parts(garment).named("border").share
    assert 0.0 < share.max() < 1.0
    np.testing.assert_allclose(garment.of_faces("density"), 0.2 + 0.2 * share)
    inner = (share == 0.0)[garment.topology.hinge_faces].all(axis=1)
    np.testing.assert_allclose(garment.hinge_bending[inner], CLOTH.bending)
    assert (garment.hinge_bending[~inner] > CLOTH.bending).all()
    assert garment.material == CLOTH


def test_layers_and_interfacing_are_found_again_on_other_triangles() -> None:
    garment = loaded(prism(12, 26), None, pins="none", layers={"hem": 2}, interfacing={"hem": 1e-4})
    other = loaded(garment, None, pins="none", triangles=900)
    assert other.trims is not None
    assert len(other.faces) != len(garment.faces)
    # Other triangles round the corners off.
    densities = (each.vertex_masses.sum() / each.face_areas.sum() for each in (garment, other))
    assert next(densities) == pytest.approx(next(densities), rel=0.01)
    hem = other.vertices[other.faces].mean(axis=1)[:, 1] < 0.01
    assert other.trims.interfacing[hem].mean() == pytest.approx(1e-4, rel=0.3)


def test_what_is_near_a_border_and_not_joined_to_it_is_no_band() -> None:
    inner, outer = (tube_arrays(low=0.5, high=high, radius=radius) for high, radius in ((0.98, 0.10), (1.0, 0.11)))
    vertices, quads = np.concatenate([inner[0], outer[0]]), np.concatenate([inner[1], outer[1] + len(inner[0])])
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    garment = Garment("two", vertices, faces, CLOTH)
    inside = Parts(garment).named("waist", 0.04).share > 0.0
    assert inside.any()
    assert (faces[inside] >= len(inner[0])).all()


def test_bands_lie_over_pieces_and_pieces_of_one_name_are_one() -> None:
    shape = prism(6, 12)
    middles = shape.vertices[shape.faces].mean(axis=1)
    front = np.where(middles[:, 2] > 0.2, 0, np.where(middles[:, 2] < 0.05, 1, -1))
    looks = Appearances((Appearance("panel"), Appearance("panel")), front)
    garment = loaded(replace(shape, appearances=looks), None, pins="none", layers={"panel": 2, "hem": 3})
    share = Parts(garment).named("hem").share
    beneath = np.where(front >= 0, 2.0, 1.0)
    np.testing.assert_allclose(garment.layers[:, 0], beneath + share * (3.0 - beneath))


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"elastic": {"belt": 0.8}}, "The garment tube has no part 'belt'"),
        ({"layers": {"hem": 2}, "band_width": {"hem": 0.7}}, r"its hem of 0.7 m is wider than its panel, .* 0.600 m"),
        ({"layers": {"hem": 2, "border": 3}}, "hem and border share 48 of its faces"),
        ({"band_width": {"hem": 0.02}}, "its hem has a band_width, but no material"),
        ({"elastic": {"piece": 0.8}}, "elastic runs along a border of the garment, and piece reaches none"),
        ({"layers": {"piece": 2}, "band_width": {"piece": 0.1}}, "piece is a part of its file"),
    ],
)  # fmt: skip
def test_what_no_tailor_can_make_is_refused(asked: dict, said: str) -> None:
    shape = prism(6, 12)
    within = np.abs(shape.vertices[shape.faces].mean(axis=1)[:, 1] - 0.3) < 0.1
    looks = Appearances((Appearance("piece"),), np.where(within, 0, -1))
    with pytest.raises(InputError, match=said):
        loaded(replace(shape, appearances=looks), None, pins="none", **asked)


def test_a_band_wider_than_a_panel_of_a_built_in_garment_is_refused(woman: ShapedBody) -> None:
    with pytest.raises(InputError, match=r"tshirt: its cuff of 0.3 m is wider than its panel"):
        loaded("tshirt", woman, triangles=1500, layers={"cuff": 2}, band_width={"cuff": 0.3})
    with pytest.raises(InputError, match="cuff and collar share"):
        loaded("tanktop", woman, triangles=1500, layers={"cuff": 2, "collar": 2}, band_width={"cuff": 0.04})


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"elastic": {"waist": 0.2}}, "elastic of waist must be a number from 0.5 to 1.5, not 0.2"),
        ({"elastic": {"waist": 3}}, "elastic of waist must be a number from 0.5 to 1.5, not 3"),
        ({"elastic": 0.8}, "elastic must be a number from 0.5 to 1.5, for each part by its name, not 0.8"),
        ({"layers": {"hem": 1.5}}, "layers of hem must be a whole number from 1 to 10, not 1.5"),
        ({"interfacing": {"hem": -1.0}}, "interfacing of hem must be a number from 0 to 0.1"),
        ({"band_width": {"hem": "2 cm"}}, "band_width of hem must be a number from 0.001 to 1"),
    ],
)
def test_values_that_no_band_has_are_refused(asked: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        WornGarment("skirt", **asked)
