import re
import warnings

import numpy as np
import pytest
from cloth_shapes import saved, triangle_tube

from pb4u.body.library import load_body
from pb4u.errors import InputError, InputWarning
from pb4u.garment.coarseness import Coarseness
from pb4u.garment.diagnosis import diagnose, require_fine
from pb4u.garment.findings import Severity
from pb4u.garment.fit import RestBody
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.scene.assembly import make_scene


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


def limb() -> RestBody:
    mesh = triangle_tube(low=0.0, high=1.0, radius=0.05, around=72)
    return RestBody("limb", mesh.vertices, np.stack(mesh.polygons), np.ones(len(mesh.vertices), dtype=bool))


@pytest.mark.parametrize("around", [4, 6, 8, 12, 36])
def test_edges_round_a_limb_span_their_share_of_the_way_round_it(around):
    sleeve = triangle_tube(low=0.2, high=0.8, radius=0.055, around=around)
    coarse = Coarseness.of(sleeve.vertices, np.stack(sleeve.polygons), limb())
    assert coarse.degrees == pytest.approx(360 / around, abs=5.0)
    assert (coarse.is_lost, coarse.is_few) == (around < 5, around < 10)


def test_cloth_that_hangs_off_the_skin_is_not_looked_at():
    skirt = triangle_tube(low=0.2, high=0.8, radius=0.15, around=5)
    assert Coarseness.of(skirt.vertices, np.stack(skirt.polygons), limb()).degrees == 0.0


@pytest.mark.parametrize(
    "name", ["trousers", *(pytest.param(name, marks=pytest.mark.slow) for name in ("dress", "longsleeve"))]
)
def test_a_garment_that_would_be_lost_is_refused_with_a_number_that_is_enough(name, woman):
    with pytest.raises(InputError, match=f"{name}: Its .*too few .*`--triangles") as refused:
        make_scene(name, woman, triangles=200, frames=1)
    enough = int(re.findall(r"--triangles (\d+)", str(refused.value))[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        require_fine(build_garment(name, woman, enough), woman)


def test_a_garment_through_which_skin_may_show_is_warned_of(woman):
    with pytest.warns(InputWarning, match=r"cardigan: .* 9\d\d triangles"):
        make_scene("cardigan", woman, triangles=1000, frames=1)


def test_a_coarse_garment_of_somebodys_own_is_refused_by_check_and_by_simulate_alike(tmp_path, woman):
    garment = build_garment("longsleeve", woman, 300)
    own = PolygonMesh(garment.vertices, tuple(garment.faces))
    (found,) = (each for each in diagnose(own, woman).findings if each.code == "too-coarse")
    assert found.severity is Severity.REFUSED
    file = saved(tmp_path, own)
    with pytest.raises(InputError, match=re.escape(found.fix)):
        make_scene(file, woman, frames=1)


def test_a_coarse_garment_is_simulated_where_its_own_number_of_triangles_is_asked_for(tmp_path, woman):
    garment = build_garment("longsleeve", woman, 300)
    file = saved(tmp_path, PolygonMesh(garment.vertices, tuple(garment.faces)))
    with pytest.raises(InputError, match=f"`--triangles {garment.triangle_count}`"):
        make_scene(file, woman, frames=1)
    with pytest.warns(InputWarning, match="too few to stay around the body"):
        scene = make_scene(file, woman, frames=1, triangles=garment.triangle_count)
    np.testing.assert_allclose(scene.garments[0].garment.vertices, garment.vertices, atol=1e-6)
