"""Cloth materials, SI units."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from pb4u.errors import InputError, unknown_name
from pb4u.io.reading_limits import read_json, refusing


@dataclass(frozen=True)
class Material:
    """An isotropic thin cloth.

    Args:
        density: mass per area [kg/m^2].
        lame_mu: second Lame parameter (shear modulus) [Pa].
        lame_lambda: first Lame parameter [Pa].
        bending: bending coefficient [J].
        thickness: [m].
        friction: coefficient of friction on skin and on the ground.

    Raises:
        InputError: a number is negative or not finite, or zero where only `lame_lambda`, `bending` and
            `friction` may be.
    """

    density: float
    lame_mu: float
    lame_lambda: float
    bending: float
    thickness: float = 4.7e-4
    friction: float = 0.5

    @property
    def membrane(self) -> tuple[float, float, float, float]:
        """Moduli c11, c22, c12 and c33 [N/m] of the cloth as a membrane, along its grain."""
        mu, lam = self.lame_mu * self.thickness, self.lame_lambda * self.thickness
        return 2.0 * mu + lam, 2.0 * mu + lam, lam, mu

    @property
    def five_numbers(self) -> dict[str, float]:
        """The numbers that trajectories of the first version have, by name."""
        return {name: value for name, value in vars(self).items() if name != "friction"}

    @classmethod
    def named(cls, name_or_path: str | Path) -> Material:
        """A built-in material by name, or one of a .json file, as `load_material` reads it.

        Args:
            name_or_path: built-in name, or path of a .json file.
        """
        return load_material(name_or_path)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            lowest_allowed = 0.0 if name in ("lame_lambda", "bending", "friction") else None
            if not (value > 0 if lowest_allowed is None else value >= lowest_allowed) or value == float("inf"):
                limit = "positive" if lowest_allowed is None else "zero or positive"
                raise InputError(f"Material {name} must be {limit} and finite, not {value}.")


#: Built-in materials; `default` is the one that the family of methods is evaluated with (reference 1.7), the others lie
#: within the range that it is trained on. `jersey` stands for knits: Young's modulus of the membrane,
#: 4 mu (mu + lambda) h / (2 mu + lambda), is 17 N/m, and 39 N/m of cotton.
MATERIALS: dict[str, Material] = {
    "default": Material(density=0.20022, lame_mu=23600.0, lame_lambda=44400.0, bending=3.962e-5),
    "cotton": Material(density=0.15, lame_mu=30000.0, lame_lambda=40000.0, bending=2.0e-5),
    "silk": Material(density=0.06, lame_mu=20000.0, lame_lambda=30000.0, bending=5.0e-7),
    "denim": Material(density=0.40, lame_mu=50000.0, lame_lambda=70000.0, bending=2.5e-4),
    "wool": Material(density=0.28, lame_mu=17000.0, lame_lambda=25000.0, bending=8.0e-5),
    "jersey": Material(density=0.17, lame_mu=16000.0, lame_lambda=4000.0, bending=2.0e-6),
    "leather": Material(density=0.65, lame_mu=60000.0, lame_lambda=90000.0, bending=1.0e-3),
}


def material_names() -> tuple[str, ...]:
    """Names of the built-in materials."""
    return tuple(MATERIALS)


def load_material(name_or_path: str | Path) -> Material:
    """A built-in material by name, or one of your own.

    Args:
        name_or_path: one of `material_names()`, or a JSON file with the fields of `Material`.

    Raises:
        InputError: no such name or file, or the file does not describe a material.
    """
    name = str(name_or_path)
    if name in MATERIALS:
        return MATERIALS[name]
    path = Path(name_or_path)
    if not path.suffix:
        raise unknown_name("material", name, MATERIALS)
    if path.suffix.lower() != ".json":
        raise InputError(f"A material of your own is a .json file; {path} ends otherwise.")
    return _read_material(path)


def _read_material(path: Path) -> Material:
    if not path.exists():
        raise InputError(f"There is no material file {path}.")
    with refusing(path, "is not JSON"):
        record = read_json(path)
    known = [entry.name for entry in fields(Material)]
    entries = set(record) if isinstance(record, dict) else set()
    if unknown := sorted(entries - set(known)):
        raise InputError(f"The material file {path} has unknown entries {unknown}: use {', '.join(known)}.")
    if missing := sorted(set(known) - {"thickness", "friction"} - entries):
        raise InputError(f"The material file {path} lacks {', '.join(missing)}; it must hold one object with them.")
    for key, value in record.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f'In the material file {path}, "{key}" must be a number, not {value!r}.')
    try:
        return Material(**{key: float(value) for key, value in record.items()})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
