import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.garment.material import FABRICS, MATERIALS, DirectionalBending, Material, load_material, material_names


def test_the_default_is_the_evaluation_material() -> None:
    assert load_material("default") == Material.isotropic(0.20022, 23600.0, 44400.0, 3.962e-5, 4.7e-4)


def test_named_materials_lie_in_the_training_ranges() -> None:
    assert tuple(MATERIALS) == ("default", "cotton", "silk", "denim", "wool", "jersey", "leather")
    for material in MATERIALS.values():
        assert 0.0434 <= material.density <= 0.7
        assert 15909 <= material.lame_mu <= 63636
        assert 3535.41 <= material.lame_lambda <= 93333.74
        assert 6.3708e-8 <= material.bending <= 1.31397e-3
        assert material.thickness == 4.7e-4


def test_silk_is_lighter_and_softer_than_denim_and_leather() -> None:
    silk, cotton, denim, leather = (MATERIALS[name] for name in ("silk", "cotton", "denim", "leather"))
    assert silk.density < cotton.density < denim.density < leather.density
    assert silk.bending < cotton.bending < denim.bending < leather.bending


def test_a_knit_stretches_twice_as_far_as_what_is_woven_and_bends_easily() -> None:
    def modulus(name: str) -> float:
        mu, lam = MATERIALS[name].lame_mu, MATERIALS[name].lame_lambda
        return 4 * mu * (mu + lam) / (2 * mu + lam)

    assert modulus("cotton") > 2 * modulus("jersey")
    assert modulus("jersey") == min(map(modulus, MATERIALS))
    assert MATERIALS["jersey"].bending < 0.2 * MATERIALS["cotton"].bending


def test_a_material_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "felt.json"
    path.write_text(json.dumps({"density": 0.3, "lame_mu": 2e4, "lame_lambda": 3e4, "bending": 1e-4}))
    assert load_material(path) == Material.isotropic(0.3, 2e4, 3e4, 1e-4)


def test_fabrics_are_named_and_say_where_their_numbers_come_from() -> None:
    assert material_names() == (*MATERIALS, *FABRICS)
    assert len(FABRICS) >= 16
    for name, fabric in FABRICS.items():
        assert load_material(name) is fabric
        assert re.match("(Measured|Estimate|Weight|Sheep)", fabric.source), name
        assert fabric.has_grain
        # Bending lengths of clothing, from chiffon to foam: the cube root of stiffness over weight.
        assert 0.008 < (0.25 * fabric.bending / (9.81 * fabric.density)) ** (1 / 3) < 0.045, name


def test_the_page_of_fabrics_lists_each_with_its_numbers() -> None:
    page = (Path(__file__).parents[2] / "docs" / "science" / "fabrics.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.split("## How they drape")[0].splitlines() if "| `" in line]
    rows = [row for row in rows if row[0].strip("`") in FABRICS]
    assert [row[0].strip("`") for row in rows] == list(FABRICS)
    for name, weight, stretch, shear, bending, values in rows:
        fabric = FABRICS[name.strip("`")]
        assert float(weight) == pytest.approx(1e3 * fabric.density, rel=5e-3)
        assert [float(each) for each in stretch.split(", ")] == pytest.approx(fabric.membrane[1::-1], rel=5e-3)
        assert float(shear) == pytest.approx(fabric.shear_stiffness, rel=5e-3)
        of_plate = [1e6 * each for each in asdict(fabric)["bending_stiffness"].values()]
        assert [float(each) for each in bending.split(", ")] == pytest.approx(of_plate, rel=5e-3)
        assert (values == "measured") == fabric.source.startswith("Measured")


TWILL = {
    "density": 0.25,
    "warp_stiffness": 3000,
    "weft_stiffness": 1200.0,
    "coupling_stiffness": 90.0,
    "shear_stiffness": 40.0,
    "bending_stiffness": {"warp": 2.4e-5, "weft": 1.1e-5, "bias": 1.2e-5},
    "source": "a mill",
}


def test_an_orthotropic_material_file_is_read_and_written_again(tmp_path: Path) -> None:
    path = tmp_path / "twill.json"
    path.write_text(json.dumps(TWILL))
    twill = load_material(path)
    assert twill.membrane == (1200.0, 3000.0, 90.0, 40.0)
    assert twill.bending_stiffness == DirectionalBending(2.4e-5, 1.1e-5, 1.2e-5)
    path.write_text(json.dumps(asdict(twill)))
    assert load_material(path) == twill
    path.write_text(json.dumps({**TWILL, "bending_stiffness": 2e-5, "stiffening_strain": 0.02, "damping_time": 1e-3}))
    plain = load_material(path)
    assert (plain.bending_stiffness, plain.stiffening_strain, plain.damping_time) == (2e-5, 0.02, 1e-3)


def test_the_isotropic_cloth_that_is_nearest_to_an_isotropic_one_is_itself() -> None:
    numbers = {"density": 0.3, "lame_mu": 2e4, "lame_lambda": 3e4, "bending": 1e-4, "thickness": 1e-3}
    assert Material.isotropic(**numbers).five_numbers == pytest.approx(numbers, rel=1e-12)


def test_the_nearest_isotropic_cloth_stores_as_much_energy_in_the_mean_over_directions() -> None:
    twill = Material.of(TWILL)
    c11, c22, c12, c33 = twill.membrane
    mu, lam = twill.lame_mu * twill.thickness, twill.lame_lambda * twill.thickness
    turns = np.linspace(0.0, np.pi, 2000, endpoint=False)
    for stretch in ((1.0, 0.0, 0.0), (1.0, -0.4, 0.3)):
        g11, g22, g12 = strains_turned(*stretch, turns)
        mean = (0.5 * (c11 * g11**2 + c22 * g22**2) + c12 * g11 * g22 + 2.0 * c33 * g12**2).mean()
        g11, g22, g12 = stretch
        same = mu * (g11**2 + g22**2 + 2.0 * g12**2) + 0.5 * lam * (g11 + g22) ** 2
        assert mean == pytest.approx(same, rel=1e-12)


def strains_turned(g11: float, g22: float, g12: float, turns: np.ndarray) -> tuple[np.ndarray, ...]:
    c, s = np.cos(turns), np.sin(turns)
    along = g11 * c * c + g22 * s * s + 2.0 * g12 * c * s
    across = g11 * s * s + g22 * c * c - 2.0 * g12 * c * s
    return along, across, (g22 - g11) * c * s + g12 * (c * c - s * s)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"warp_stiffness": 0.0}, "warp_stiffness must be positive"),
        ({"weft_stiffness": 5e8}, "weft_stiffness must be at most 1e\\+07 N/m, not 5e\\+08"),
        ({"density": 2000.0}, "density must be at most 100 kg/m"),
        ({"coupling_stiffness": -1900.0}, "coupling_stiffness must be smaller than 1897 N/m"),
        ({"coupling_stiffness": float("nan")}, "coupling_stiffness must be finite"),
        ({"shear_stiffness": 3100.0}, "shear_stiffness must be at most 3000 N/m"),
        ({"bending_stiffness": -1e-6}, "bending_stiffness must be zero or positive"),
        ({"bending_stiffness": {"warp": 1.0}}, "bending_stiffness must be one number or hold warp, weft, bias"),
        ({"bending_stiffness": {"warp": 1e-5, "weft": -1e-5, "bias": 0.0}}, "bending_stiffness.weft must be zero"),
        ({"bending_stiffness": {"warp": 1e-5, "weft": "x", "bias": 0.0}}, '"bending_stiffness.weft" must be a number'),
        ({"stiffening_strain": -0.1}, "stiffening_strain must be zero"),
        ({"damping_time": float("inf")}, "damping_time must be zero or positive and finite"),
        ({"source": 3}, '"source" must be text'),
        ({"lame_mu": 2e4}, "unknown entries"),
    ],
)
def test_an_orthotropic_material_that_is_no_cloth_is_refused(tmp_path: Path, changed: dict, message: str) -> None:
    path = tmp_path / "odd.json"
    path.write_text(json.dumps({**TWILL, **changed}))
    with pytest.raises(InputError, match=message):
        load_material(path)


ARCSIM = {
    "density": 0.2,
    "stretching": [
        [20.0, -3.0, 40.0, 10.0],
        [35.0, 0, 45, 10.0],
        *3 * [[30.0, 5.0, 50.0, 10.0]],
        [30.0, 5.0, 70.0, 9.0],
    ],
    "bending": [[20e-6, 20e-6, 20e-6, 20e-6, 40e-6], 5 * [12e-6], [16e-6, 16e-6, 16e-6, 16e-6, 16e-6]],
}


def test_a_material_of_arcsim_is_read_as_it_computes(tmp_path: Path) -> None:
    path = tmp_path / "knit.json"
    path.write_text(json.dumps(ARCSIM))
    knit = load_material(path)
    assert knit.membrane == (40.0, 80.0, 0.0, 10.0)
    bending = asdict(knit)["bending_stiffness"]
    assert bending == pytest.approx({"warp": 6e-6, "weft": 4e-6, "bias": 3e-6})
    # Its force at a stretch of 1/6: the mean of both threads grows by 2 (15 + 30) / 2 N/m, times the stretch.
    assert knit.stiffening_strain == 0.0
    assert 0.5 * knit.stiffening_stiffness * (1 / 6) ** 2 == pytest.approx(45.0 / 6)
    assert "knit.json" in knit.source


def test_what_wang_and_others_measured_is_read_alike(tmp_path: Path) -> None:
    path = tmp_path / "denim.json"
    rows = [[205.352, 10.234, 1013.886, 53.387], [232.028, 0, 0, 0], *3 * [4 * [0]], [0, 0, 1051.557, 0]]
    path.write_text(json.dumps({"density": 0.324, "stretching": rows, "bending": 3 * [5 * [60e-6]]}))
    read, named = load_material(path), FABRICS["denim-11oz"]
    assert read.membrane == pytest.approx(named.membrane, rel=5e-3)
    assert read.stiffening_stiffness == pytest.approx(named.stiffening_stiffness, rel=5e-3)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"bending": 2e-5}, '"bending" must be 3 rows of 5 numbers'),
        ({"stretching": ARCSIM["stretching"][:5]}, '"stretching" must be 6 rows of 4 numbers'),
        ({"stretching": [["x"]]}, '"stretching" must be 6 rows'),
        ({"density": None}, '"density" must be a number'),
        ({"damping": 0.1}, "unknown entries"),
    ],
)
def test_a_faulty_material_of_arcsim_is_refused(tmp_path: Path, changed: dict, message: str) -> None:
    path = tmp_path / "odd.json"
    path.write_text(json.dumps({**ARCSIM, **changed}))
    with pytest.raises(InputError, match=message):
        load_material(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[1]", "one object"),
        ('{"density": 1}', "lacks"),
        ('{"density": 1, "lame_mu": 1, "lame_lambda": 1, "bending": 1, "colour": 1}', "unknown entries"),
        ('{"density": "x", "lame_mu": 1, "lame_lambda": 1, "bending": 1}', "must be a number"),
        ('{"density": -1, "lame_mu": 1, "lame_lambda": 1, "bending": 1}', "must be positive"),
        ('{"density": 1, "lame_mu": 1, "lame_lambda": 1, "bending": 1, "thickness": 0}', "thickness must be positive"),
        ('{"density": NaN, "lame_mu": 1, "lame_lambda": 1, "bending": 1}', "must be positive"),
    ],
)
def test_a_faulty_material_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "odd.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_material(path)


def test_unknown_names_list_near_ones() -> None:
    with pytest.raises(InputError, match="did you mean denim"):
        load_material("dennim")
    with pytest.raises(InputError, match=r"no material file .*none\.json"):
        load_material("none.json")
