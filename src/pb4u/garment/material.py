"""Cloth materials, SI units."""

from __future__ import annotations

from dataclasses import dataclass

from pb4u.errors import InputError


@dataclass(frozen=True)
class Material:
    """An isotropic thin cloth.

    Args:
        density: mass per area [kg/m^2].
        lame_mu: second Lame parameter (shear modulus) [Pa].
        lame_lambda: first Lame parameter [Pa].
        bending: bending coefficient [J].
        thickness: [m].
    """

    density: float
    lame_mu: float
    lame_lambda: float
    bending: float
    thickness: float = 4.7e-4

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            lowest_allowed = 0.0 if name in ("lame_lambda", "bending") else None
            if not (value > 0 if lowest_allowed is None else value >= lowest_allowed) or value == float("inf"):
                limit = "positive" if lowest_allowed is None else "zero or positive"
                raise InputError(f"Material {name} must be {limit} and finite, not {value}.")
