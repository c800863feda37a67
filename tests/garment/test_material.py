import json
from pathlib import Path

import pytest

from pb4u.errors import InputError
from pb4u.garment.material import MATERIALS, Material, load_material, material_names


def test_the_default_is_the_evaluation_material() -> None:
    assert load_material("default") == Material(0.20022, 23600.0, 44400.0, 3.962e-5, 4.7e-4)


def test_named_materials_lie_in_the_training_ranges() -> None:
    assert material_names() == ("default", "cotton", "silk", "denim", "wool", "jersey", "leather")
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
    assert load_material(path) == Material(0.3, 2e4, 3e4, 1e-4)


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
