import numpy as np
import pytest
import torch
from cloth_shapes import tube_arrays

from pb4u.body.length_units import UNITS
from pb4u.body.library import load_body
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.fit import AXES, UPRIGHT, RestBody, find_fit
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.triangle_mesh import vertex_normals


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


@pytest.fixture(scope="module")
def body(woman):
    return RestBody.of(woman)


@pytest.fixture(scope="module")
def man():
    return RestBody.of(load_body("man"))


@pytest.fixture(scope="module")
def shirt(body):
    """Skin of torso and upper arms, 1 cm out: it has a front, a back and a height of its own."""
    vertices = body.vertices
    torso = (vertices[:, 1] > 1.0) & (vertices[:, 1] < 1.42) & (np.abs(vertices[:, 0]) < 0.3) & body.contact
    normals = vertex_normals(torch.from_numpy(vertices), torch.from_numpy(body.faces)).numpy()
    return vertices[torso] + 0.01 * normals[torso]


def test_a_garment_that_fits_is_not_moved(body, shirt):
    fit = find_fit(shirt, body)
    assert fit.is_identity
    np.testing.assert_array_equal(fit.apply(shirt), shirt)


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit != "metres"])
@pytest.mark.parametrize("axes", ["Z up, facing -Y", "Y up, facing -Z"])
def test_unit_axes_and_the_models_own_origin_are_found(body, shirt, unit, axes):
    file = ((shirt - np.array([0.0, body.lift, 0.0])) @ AXES[axes]) / UNITS[unit]
    fit = find_fit(file, body)
    assert (fit.unit, fit.axes, fit.searched) == (unit, axes, False)
    np.testing.assert_allclose(fit.apply(file), shirt, atol=1e-9)


@pytest.mark.parametrize("unit", UNITS)
def test_a_loose_garment_where_it_is_worn_is_not_shrunk_around_a_limb(woman, body, unit):
    dress = build_garment("dress", woman, 600).vertices
    # At a third of its size it would fit closer.
    fit = find_fit(dress / UNITS[unit], body)
    assert (fit.unit, fit.axes, fit.searched) == (unit, UPRIGHT, False)
    np.testing.assert_allclose(fit.apply(dress / UNITS[unit]), dress, atol=1e-9)


def test_any_other_height_is_searched_for(body, shirt):
    fit = find_fit(shirt - np.array([0.0, 0.3, 0.0]), body)
    assert fit.searched
    assert fit.shift[1] == pytest.approx(0.3, abs=0.015)


@pytest.mark.parametrize(("triangles", "lowered"), [(600, 0.25), (2500, 0.15)])
def test_a_skirt_above_the_ground_is_not_lifted_over_the_head(woman, man, triangles, lowered):
    skirt = build_garment("skirt", woman, triangles).vertices - [0.0, lowered, 0.0]
    # Around the head it would be as near to the body as at the man's waist, which is some 0.1 m above the woman's.
    assert man.misfit(skirt + [0.0, man.lift, 0.0]) < 1.25 * man.misfit(skirt + [0.0, lowered + 0.1, 0.0]) + 0.003
    fit = find_fit(skirt, man)
    assert fit.searched
    assert fit.shift[1] == pytest.approx(lowered + 0.1, abs=0.04)


@pytest.mark.parametrize("worn_by", ["woman", "man"])
def test_a_skirt_made_around_the_models_own_origin_is_lifted(woman, body, man, worn_by):
    rest = {"woman": body, "man": man}[worn_by]
    skirt = build_garment("skirt", woman, 600).vertices - [0.0, woman.lift, 0.0]
    assert skirt[:, 1].min() < -0.3
    fit = find_fit(skirt, rest)
    if worn_by == "woman":
        assert not fit.searched
        np.testing.assert_array_equal(fit.shift, [0.0, rest.lift, 0.0])
    else:
        # The man's waist is some 0.1 m above the woman's.
        assert fit.shift[1] == pytest.approx(rest.lift + 0.1, abs=0.04)


def test_a_wide_skirt_stays_where_it_is(body):
    vertices, _ = tube_arrays(low=0.2, high=1.05, radius=0.2)
    vertices[:, [0, 2]] *= 1.0 + 0.8 * (1.05 - vertices[:, 1:2])
    assert find_fit(vertices, body).is_identity


def test_the_axes_are_rotations():
    for rotation in AXES.values():
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3))
        assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("moved", [(0.065, 0, 0), (0, 0, -0.065), (0.1, 0, 0), (0, -0.07, 0), (-0.08, 0.06, 0.12)])
@pytest.mark.parametrize("axes", [UPRIGHT, "Y up, facing +X", "Z up, facing +Y"])
def test_a_garment_moved_to_any_side_and_turned_is_put_back(body, shirt, moved, axes):
    fit = find_fit((shirt + np.array(moved)) @ AXES[axes], body)
    assert (fit.unit, fit.axes, fit.alike) == ("metres", axes, ())
    np.testing.assert_allclose(fit.apply((shirt + np.array(moved)) @ AXES[axes]), shirt, atol=0.012)


@pytest.mark.slow
def test_a_garment_that_fits_nowhere_is_not_moved(woman, body):
    vertices, faces = tube_arrays(low=0.2, high=0.5, radius=0.9)
    fit = find_fit(vertices + np.array([2.0, 0.3, 0.0]), body)
    assert fit.is_identity
    codes = diagnose(PolygonMesh(vertices + np.array([2.0, 0.3, 0.0]), tuple(faces)), woman).codes
    assert "far" in codes
