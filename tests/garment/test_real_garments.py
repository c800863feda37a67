"""Garments made by others: Z up, around the body model's own origin, two of them partly inside the body."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from cloth_shapes import CLOTH

from pb4u.body.length_units import UNITS
from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.diagnosis import diagnose, require_worn
from pb4u.garment.fit import AXES, UPRIGHT, RestBody, find_fit
from pb4u.garment.garment_file import read_garment, read_source
from pb4u.garment.parts import Parts
from pb4u.garment.repair import repair
from pb4u.garment.support import find_support
from pb4u.geometry.obj_file import write_obj

pytestmark = pytest.mark.slow
NAMES = (
    "croptop_f_lod1", "longsleeve_m_lod0", "longsleeve_m_lod1", "pants_f_lod0", "pants_f_lod1", "shorts_f_lod0",
    "skirt_long_f_lod0", "skirt_long_f_lod1", "tights_f_lod0", "tshirt_f_lod0", "tshirt_f_lod1", "tshirt_m_lod0",
    "tshirt_m_lod1", "tshirt_m_lod2",
)  # fmt: skip
BOTTOMS = ("pants", "shorts", "skirt")
BANDS = {
    "croptop": "collar hem cuff",
    "longsleeve": "collar hem cuff",
    "tshirt": "collar hem cuff",
    "tights": "collar cuff",
}
LOOPS = {"croptop": 4, "longsleeve": 4, "pants": 3, "shorts": 3, "skirt": 2, "tights": 3, "tshirt": 4}


@pytest.fixture(scope="module")
def bodies():
    return {"f": load_body("woman"), "m": load_body("man")}


@pytest.mark.parametrize("name", NAMES)
def test_a_real_garment_is_diagnosed_mended_and_worn(name, test_data, bodies, tmp_path):
    path = test_data / "garments" / f"{name}.obj"
    if not path.is_file():
        pytest.skip(f"{path.name} is absent")
    body = bodies["m" if "_m_" in name else "f"]
    source = read_source(path)
    found = diagnose(source, body)
    assert {"axes", "height", "misplaced"} <= set(found.codes)
    assert ("unsupported" in found.codes) == name.startswith(BOTTOMS)
    assert found.fit.axes == "Z up, facing -Y"
    assert found.fit.shift[1] == pytest.approx(body.lift)
    assert found.measures["boundary_loops"] == LOOPS[name.split("_")[0]]
    assert found.measures["pieces"] == 1
    if name in ("tshirt_f_lod0", "pants_f_lod0"):
        assert 14.0 < found.measures["penetration_percent"] < 16.5
        assert 0.0065 < found.measures["penetration_depth_max"] < 0.0085
    with pytest.raises(InputError, match="not on the body"):
        require_worn(read_garment(path, CLOTH), body, path, None)

    if name.endswith(("lod1", "lod2")) and not name.startswith("croptop"):
        return  # the same clothes, finer: mending them again would show nothing new
    mended, said, left = repair(source, body)
    assert not any("inside" in sentence for sentence in left)
    assert said[0].startswith("Turned")
    assert len(mended.vertices) == len(source.vertices)
    np.testing.assert_array_equal(np.concatenate(mended.polygons), np.concatenate(source.polygons))
    write_obj(tmp_path / "mended.obj", mended)
    garment = read_garment(tmp_path / "mended.obj", CLOTH)
    again = diagnose(garment, body)
    # Only the tights clothe feet, where edges made for a leg go far round.
    assert ("coarse" in again.codes) == name.startswith("tights")
    assert set(again.codes) <= {"coarse", "graded", "unsupported"}
    assert again.measures["penetration_percent"] == 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        support = find_support(garment.vertices, garment.faces, RestBody.of(body))
        require_worn(garment, body, name, None if name.startswith(BOTTOMS) else support)


def test_shorts_pushed_out_of_another_s_body_do_not_cross_themselves(test_data, bodies):
    path = test_data / "garments" / "shorts_f_lod0.obj"
    if not path.is_file():
        pytest.skip(f"{path.name} is absent")
    mended, changes, left = repair(read_source(path), bodies["m"])
    assert diagnose(mended, bodies["m"]).measures["self_intersections"] == 0
    assert changes[-1] == "Untangled 3 pairs of triangles that the push had made cross."
    # What is only doubted is not said to be mended.
    assert left == ("Front and back fit equally well: Z up, facing -Y was chosen, Z up, facing +Y is as likely.",)


MOVED = ("croptop_f_lod1", "longsleeve_m_lod0", "pants_f_lod0", "shorts_f_lod0", "tights_f_lod0", "tshirt_f_lod0",
         "tshirt_m_lod0")  # fmt: skip


@pytest.mark.parametrize("name", MOVED)
def test_a_real_garment_moved_turned_and_scaled_is_put_back(name, test_data, bodies):
    path = test_data / "garments" / f"{name}.obj"
    if not path.is_file():
        pytest.skip(f"{path.name} is absent")
    body = bodies["m" if "_m_" in name else "f"]
    rest, made = RestBody.of(body), AXES["Z up, facing -Y"]
    worn = read_source(path).vertices @ made.T + np.array([0.0, body.lift, 0.0])
    draw = np.random.default_rng(20)
    cases = [(worn + shift * side, "metres", UPRIGHT) for side in np.eye(3) for shift in (-0.06, 0.12)]
    for axes in AXES:
        moved = worn + draw.uniform(-0.08, 0.08, 3)
        cases.append((moved @ AXES[axes], "metres", axes))
    for unit in ("centimetres", "millimetres", "inches"):
        cases.append(((worn + draw.uniform(-0.06, 0.06, 3)) @ made / UNITS[unit], unit, "Z up, facing -Y"))
    # Every other case of each garment, in turn: a fit takes a second.
    for vertices, unit, axes in cases[MOVED.index(name) % 2 :: 2]:
        fit = find_fit(vertices, rest)
        assert (fit.unit, fit.axes) == (unit, axes)
        assert np.linalg.norm(fit.apply(vertices) - worn, axis=1).max() < 0.02


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith("lod0") or "crop" in name])
def test_the_borders_of_a_real_garment_have_their_names(name, test_data):
    path = test_data / "garments" / f"{name}.obj"
    if not path.is_file():
        pytest.skip(f"{path.name} is absent")
    garment = read_garment(path, CLOTH)
    x, y, z = garment.vertices.T
    parts = Parts(replace(garment, vertices=np.stack([x, z, -y], axis=1)))
    # What is called tights goes from the neck to closed feet.
    expected = BANDS.get(name.split("_")[0], "waist hem").split()
    assert list(parts.names) == [*expected, "border"]
    assert all(parts.named(each).share.any() for each in expected)
