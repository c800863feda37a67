"""Cloth materials, SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.environment import STANDARD_GRAVITY
from pb4u.errors import InputError, unknown_name
from pb4u.garment.arcsim_material import arcsim_fields, is_arcsim
from pb4u.io.reading_limits import read_json, refusing

Moduli = tuple[float, float, float, float]
"""c11, c22, c12 and c33 [N/m] of a membrane along the two axes of a rest shape."""


@dataclass(frozen=True)
class DirectionalBending:
    """Bending stiffness of a cloth that bends more easily one way than another.

    Args:
        warp: of a strip that is cut along the warp [N m].
        weft: of a strip that is cut along the weft [N m].
        bias: of a strip that is cut at 45 degrees [N m].
    """

    warp: float
    weft: float
    bias: float

    @property
    def mean(self) -> float:
        """Mean over all directions [N m], that of the isotropic cloth that is nearest."""
        return 0.25 * (self.warp + self.weft + 2.0 * self.bias)

    def hinge_coefficients(self, along_weft: np.ndarray) -> np.ndarray:
        """Coefficients (...,) [J] of hinges, four times the bending stiffness of the plate that they make up.

        A strip bends with mean + (warp - weft) / 2 cos 2a + (mean - bias) cos 4a, a its angle from the warp. A hinge
        is bent by strips of other directions too, so that hinges of all directions together smooth the second term by
        2/3 and the third by 1/3: these are enlarged by as much, and a hinge is never softer than a quarter of the
        softest strip.

        Args:
            along_weft: (...,) square of the share of the edge's direction that is along the weft [1].
        """
        # The normal of the edge is along the warp where the edge is along the weft.
        double = 2.0 * along_weft - 1.0
        second, fourth = 1.5 * 0.5 * (self.warp - self.weft), 3.0 * (self.mean - self.bias)
        stiffness = self.mean + second * double + fourth * (2.0 * double**2 - 1.0)
        return 4.0 * np.maximum(stiffness, 0.25 * min(self.warp, self.weft, self.bias))


@dataclass(frozen=True)
class Material:
    """A thin cloth with its own stiffness along the warp and along the weft.

    Cut flat, a panel has the weft along the first axis of its rest shape and the warp, which runs up it, along the
    second. The energy of the membrane by area is c11 g11^2 / 2 + c22 g22^2 / 2 + c12 g11 g22 + 2 c33 g12^2 of its Green
    strain g, with the stiffness along the weft as c11, along the warp as c22, the coupling as c12 and the shear as c33.

    Args:
        density: mass by area [kg/m^2].
        warp_stiffness: modulus along the warp, without narrowing [N/m].
        weft_stiffness: modulus along the weft, without narrowing [N/m].
        coupling_stiffness: force along one thread caused by stretch along the other [N/m].
        shear_stiffness: modulus of shear between warp and weft [N/m].
        bending_stiffness: force by curvature of a plate [N m], by direction (`DirectionalBending`, or a mapping of
            its fields) or one for all.
        stiffening_strain: stretch of a thread beyond which it grows stiffer [1].
        stiffening_stiffness: by how much its modulus grows for each unit of stretch beyond that [N/m].
        damping_time: stress of a change of shape over that of the shape, by the rate of the change [s]: a mode of
            angular frequency w loses the share 1 - exp(-pi damping_time w) of its amplitude in a period.
        friction: coefficient of friction on skin and on the ground.
        thickness: used only for contact and drawing [m].
        source: source of its numbers.

    Raises:
        InputError: a number is out of range, the membrane would have no resistance to some stretch, or its shear
            stiffness exceeds that of every thread.
    """

    density: float
    warp_stiffness: float
    weft_stiffness: float
    coupling_stiffness: float
    shear_stiffness: float
    bending_stiffness: float | DirectionalBending
    stiffening_strain: float = 0.0
    stiffening_stiffness: float = 0.0
    damping_time: float = 0.0
    friction: float = 0.5
    thickness: float = 4.7e-4
    source: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.bending_stiffness, Mapping):
            if set(self.bending_stiffness) != set(_BENDING):
                raise InputError(
                    f"Material bending_stiffness must be one number or hold {', '.join(_BENDING)}, not "
                    f"{', '.join(map(str, self.bending_stiffness)) or 'nothing'}."
                )
            object.__setattr__(self, "bending_stiffness", DirectionalBending(**self.bending_stiffness))
        for name, value in self.numbers.items():
            _check_range(name, value)
        weft, warp, coupling, shear = self.membrane
        if not coupling**2 < warp * weft:
            raise InputError(
                f"Material coupling_stiffness must be smaller than {(warp * weft) ** 0.5:.4g} N/m, the geometric mean "
                f"of warp and weft, not {coupling:g}: otherwise the cloth would stretch by itself."
            )
        if shear > max(warp, weft):
            raise InputError(
                f"Material shear_stiffness must be at most {max(warp, weft):g} N/m, the stiffness of its stiffer "
                f"threads, not {shear:g}."
            )

    @classmethod
    def isotropic(
        cls,
        density: float,
        lame_mu: float,
        lame_lambda: float,
        bending: float,
        thickness: float = 4.7e-4,
        friction: float = 0.5,
    ) -> Material:
        """A cloth that is alike in all directions, by the five numbers of the family of methods.

        Args:
            density: mass by area [kg/m^2].
            lame_mu: second Lame parameter (shear modulus) [Pa].
            lame_lambda: first Lame parameter [Pa].
            bending: coefficient of a hinge [J], four times the bending stiffness of a plate.
            thickness: of the solid that the Lame parameters belong to [m].
            friction: coefficient of friction on skin and on the ground.

        Raises:
            InputError: a number is out of its range.
        """
        numbers = {"lame_mu": lame_mu, "lame_lambda": lame_lambda, "bending": bending, "thickness": thickness}
        for name, value in numbers.items():
            _check_range(name, value)
        mu, lam = lame_mu * thickness, lame_lambda * thickness
        along = 2.0 * mu + lam
        return cls(density, along, along, lam, mu, 0.25 * bending, friction=friction, thickness=thickness)

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Material:
        """The material of a record that this project wrote, with the fields of now or the five numbers of before.

        Args:
            record: entries by name; unknown ones are ignored.

        Raises:
            InputError: a number is out of its range.
            TypeError: a field is missing.
        """
        names = set(cls.__dataclass_fields__) if "warp_stiffness" in record else ISOTROPIC
        make = cls if "warp_stiffness" in record else cls.isotropic
        return make(**{name: value for name, value in record.items() if name in names})

    @classmethod
    def named(cls, name_or_path: str | Path) -> Material:
        """A built-in material by name, or one of a .json file, as `load_material` reads it.

        Args:
            name_or_path: built-in name, or path of a .json file.
        """
        return load_material(name_or_path)

    @property
    def numbers(self) -> dict[str, float]:
        """Its numbers by name, in their units; a bending stiffness by direction is three."""
        numbers = {name: value for name, value in vars(self).items() if name not in ("source", "bending_stiffness")}
        bending = self.bending_stiffness
        if not isinstance(bending, DirectionalBending):
            return numbers | {"bending_stiffness": bending}
        return numbers | {f"bending_stiffness.{name}": value for name, value in asdict(bending).items()}

    @property
    def membrane(self) -> Moduli:
        """Moduli c11 (weft), c22 (warp), c12 and c33 [N/m] along the axes of a rest shape."""
        return self.weft_stiffness, self.warp_stiffness, self.coupling_stiffness, self.shear_stiffness

    @property
    def lame_mu(self) -> float:
        """Second Lame parameter [Pa] of the isotropic cloth that is nearest."""
        return nearest_isotropic(*self.membrane)[0] / self.thickness

    @property
    def lame_lambda(self) -> float:
        """First Lame parameter [Pa] of the isotropic cloth that is nearest."""
        return max(nearest_isotropic(*self.membrane)[1], 0.0) / self.thickness

    @property
    def bending(self) -> float:
        """Coefficient of a hinge [J] of the isotropic cloth that is nearest: four times its bending stiffness."""
        stiffness = self.bending_stiffness
        return 4.0 * (stiffness.mean if isinstance(stiffness, DirectionalBending) else stiffness)

    @property
    def bending_length(self) -> float:
        """Half of the overhang [m] at which the end of a strip hangs at 41.5 degrees: the size of its folds.

        (B / w)^(1/3), of bending stiffness [N m] and weight by area [N/m^2] (Peirce 1930; ASTM D1388).
        """
        return float((0.25 * self.bending / (STANDARD_GRAVITY * self.density)) ** (1.0 / 3.0))

    @property
    def has_grain(self) -> bool:
        """Whether its properties depend on direction."""
        c11, c22, c12, c33 = self.membrane
        mu = nearest_isotropic(c11, c22, c12, c33)[0]
        isotropic = np.allclose([c11, c22, c33], [c12 + 2.0 * mu, c12 + 2.0 * mu, mu], rtol=1e-9, atol=0.0)
        return not isotropic or isinstance(self.bending_stiffness, DirectionalBending)

    @property
    def without_grain(self) -> Material:
        """The isotropic cloth that is nearest, for a garment without grain; itself where it has none."""
        if not self.has_grain:
            return self
        mu, lam = nearest_isotropic(*self.membrane)
        return replace(
            self, warp_stiffness=2.0 * mu + lam, weft_stiffness=2.0 * mu + lam, coupling_stiffness=lam,
            shear_stiffness=mu, bending_stiffness=0.25 * self.bending,
        )  # fmt: skip

    @property
    def stiffening(self) -> tuple[float, float]:
        """Stretch of a thread beyond which it stiffens [1], and by how much for each unit of stretch [N/m]."""
        return self.stiffening_strain, self.stiffening_stiffness

    def hinge_coefficients(self, along_weft: np.ndarray) -> np.ndarray:
        """Bending coefficients (...,) [J] of hinges between two faces of this cloth.

        Args:
            along_weft: (...,) square of the share of the edge's direction that is along the weft [1].
        """
        stiffness = self.bending_stiffness
        if isinstance(stiffness, DirectionalBending):
            return stiffness.hinge_coefficients(along_weft)
        return np.full(np.shape(along_weft), 4.0 * stiffness)

    @property
    def five_numbers(self) -> dict[str, float]:
        """The numbers that trajectories of the first version have, by name, of the isotropic cloth that is nearest."""
        return {name: getattr(self, name) for name in ISOTROPIC if name != "friction"}


ISOTROPIC = ("density", "lame_mu", "lame_lambda", "bending", "thickness", "friction")
"""Numbers of an isotropic cloth by name, as files of before hold them."""

_BENDING = tuple(DirectionalBending.__dataclass_fields__)
_POSITIVE = {
    "density": (100.0, "kg/m^2"),
    "warp_stiffness": (1e7, "N/m"),
    "weft_stiffness": (1e7, "N/m"),
    "shear_stiffness": (1e7, "N/m"),
    "thickness": (0.1, "m"),
    "lame_mu": (1e12, "Pa"),
}
"""Numbers that must be positive, the most that is taken, and the unit: beyond these it is not cloth."""
_POSITIVE_OR_ZERO = {
    "lame_lambda": (1e12, "Pa"),
    "bending": (40.0, "J"),
    **dict.fromkeys(("bending_stiffness", *(f"bending_stiffness.{name}" for name in _BENDING)), (10.0, "N m")),
    "stiffening_strain": (10.0, ""),
    "stiffening_stiffness": (1e9, "N/m"),
    "damping_time": (10.0, "s"),
    "friction": (100.0, ""),
}


def _check_range(name: str, value: float) -> None:
    zero = name in _POSITIVE_OR_ZERO
    most, unit = {**_POSITIVE, **_POSITIVE_OR_ZERO}.get(name, (1e7, "N/m"))
    if name == "coupling_stiffness":
        low, limit = -most <= value, "finite"
    else:
        low, limit = (value >= 0.0, "zero or positive") if zero else (value > 0.0, "positive")
    if not low or value == float("inf"):
        raise InputError(f"Material {name} must be {limit} and finite, not {value}.")
    if value > most:
        raise InputError(f"Material {name} must be at most {most:g} {unit}".rstrip() + f", not {value:g}.")


def nearest_isotropic(c11: Any, c22: Any, c12: Any, c33: Any) -> tuple[Any, Any]:
    """Both Lame parameters mu and lambda times the thickness [N/m]: the mean of the membrane over its directions.

    Args:
        c11: along the first axis, number or array [N/m].
        c22: along the second axis [N/m].
        c12: coupling of both [N/m].
        c33: shear [N/m].
    """
    mu = 0.125 * (c11 + c22 - 2.0 * c12 + 4.0 * c33)
    return mu, 0.25 * (c11 + c22 + 2.0 * c12) - mu


#: Isotropic materials; `default` is the one that the family of methods is evaluated with (reference 1.7), the others
#: lie within the range that it is trained on. `jersey` stands for knits: Young's modulus of the membrane,
#: 4 mu (mu + lambda) h / (2 mu + lambda), is 17 N/m, and 39 N/m of cotton.
MATERIALS: dict[str, Material] = {
    "default": Material.isotropic(density=0.20022, lame_mu=23600.0, lame_lambda=44400.0, bending=3.962e-5),
    "cotton": Material.isotropic(density=0.15, lame_mu=30000.0, lame_lambda=40000.0, bending=2.0e-5),
    "silk": Material.isotropic(density=0.06, lame_mu=20000.0, lame_lambda=30000.0, bending=5.0e-7),
    "denim": Material.isotropic(density=0.40, lame_mu=50000.0, lame_lambda=70000.0, bending=2.5e-4),
    "wool": Material.isotropic(density=0.28, lame_mu=17000.0, lame_lambda=25000.0, bending=8.0e-5),
    "jersey": Material.isotropic(density=0.17, lame_mu=16000.0, lame_lambda=4000.0, bending=2.0e-6),
    "leather": Material.isotropic(density=0.65, lame_mu=60000.0, lame_lambda=90000.0, bending=1.0e-3),
}


DATA = Path(__file__).parent / "data"

#: Cloth with a grain, in SI units: measured where its source says so, else an estimate of its class.
FABRICS: dict[str, Material] = {name: Material.of(record) for name, record in read_json(DATA / "fabrics.json").items()}

#: All that is built in.
BUILT_IN: dict[str, Material] = {**MATERIALS, **FABRICS}


def material_names() -> tuple[str, ...]:
    """Names of the built-in materials and fabrics."""
    return tuple(BUILT_IN)


def load_material(name_or_path: str | Path) -> Material:
    """A built-in material by name, or one of your own.

    Args:
        name_or_path: one of `material_names()`, or a JSON file with the fields of `Material`, or with the five numbers
            of an isotropic cloth, or one of ARCSim.

    Raises:
        InputError: no such name or file, or the file does not describe a material.
    """
    name = str(name_or_path)
    if name in BUILT_IN:
        return BUILT_IN[name]
    path = Path(name_or_path)
    if not path.suffix:
        raise unknown_name("material", name, BUILT_IN)
    if path.suffix.lower() != ".json":
        raise InputError(f"A material of your own is a .json file; {path} has another suffix.")
    return _read_material(path)


def _read_material(path: Path) -> Material:
    if not path.exists():
        raise InputError(f"There is no material file {path}.")
    with refusing(path, "is not JSON"):
        record = read_json(path)
    if isinstance(record, dict) and is_arcsim(record):
        record = arcsim_fields(record, path)
    entries = set(record) if isinstance(record, dict) else set()
    isotropic = bool(entries & {"lame_mu", "lame_lambda", "bending"})
    names = ISOTROPIC if isotropic else [entry.name for entry in fields(Material)]
    needed = names[:4] if isotropic else names[:6]
    if unknown := sorted(entries - set(names)):
        raise InputError(f"The material file {path} has unknown entries {unknown}: use {', '.join(names)}.")
    if missing := [name for name in needed if name not in entries]:
        raise InputError(f"The material file {path} lacks {', '.join(missing)}; it must hold one object with them.")
    numbers = dict(record)
    if not isinstance(source := numbers.pop("source", ""), str):
        raise InputError(f'In the material file {path}, "source" must be text, not {source!r}.')
    if isinstance(bending := record.get("bending_stiffness"), dict):
        del numbers["bending_stiffness"]
        numbers |= {f"bending_stiffness.{key}": value for key, value in bending.items()}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f'In the material file {path}, "{key}" must be a number, not {value!r}.')
    try:
        return Material.of(record)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
