"""Flags that are given once for each garment of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeAlias

import typer

from pb4u.errors import InputError, unknown_name
from pb4u.scene.specification import GarmentSpecification


class GarmentValue(NamedTuple):
    """A value of a flag for one garment.

    Args:
        garment: name of the garment; None for whichever its place in the command says.
        value: the value.
    """

    garment: str | None
    value: Any

    @classmethod
    def parse(cls, text: str) -> GarmentValue:
        """Value from `VALUE` or `NAME=VALUE`."""
        name, equals, value = text.partition("=")
        return cls(name.strip(), value.strip()) if equals and not Path(text).exists() else cls(None, text)

    @classmethod
    def parse_count(cls, text: str) -> GarmentValue:
        """Value from `N` or `NAME=N`.

        Raises:
            BadParameter: N is no whole number.
        """
        name, value = cls.parse(text)
        try:
            return cls(name, int(value))
        except ValueError:
            raise typer.BadParameter(f"it takes a whole number or NAME=N; {text!r} is neither.") from None


GarmentFlag: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME|FILE",
        help="Built-in garment, a mesh file in metres that fits the body at rest, or FILE.pkl:NAME of a garments "
        "dictionary of HOOD's family. Repeatable, inner first. "
        f"Default: {GarmentSpecification.garment}.",
    ),
]
TuckFlag: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="Garment of the scene that goes into what is worn from the waist, such as trousers, wherever it "
        "stands in the order. Repeatable.",
    ),
]
PinsFlag: TypeAlias = Annotated[
    list[GarmentValue] | None,
    typer.Option(
        parser=GarmentValue.parse,
        metavar="[NAME=]PINS",
        help="Vertices that follow the body: none, waist (highest border), collar (uppermost 4 cm of a border), hem "
        "(lowest border), loop:N (border with the N-th most vertices), or a file of indices. Once for all garments, "
        "once a garment in their order, or as NAME=PINS. Default: the garment's own.",
    ),
]
TrianglesFlag: TypeAlias = Annotated[
    list[GarmentValue] | None,
    typer.Option(
        parser=GarmentValue.parse_count,
        metavar="[NAME=]N",
        help="Triangles to simulate, given as --pins is. Default: the file's own, or 2,500 of a built-in garment.",
    ),
]
MaterialFlag: TypeAlias = Annotated[
    list[GarmentValue] | None,
    typer.Option(
        parser=GarmentValue.parse,
        metavar="[NAME=]MATERIAL",
        help="Built-in material or a JSON file in SI units, given as --pins is. Default: default.",
    ),
]


def dressed(
    described: Sequence[GarmentSpecification],
    named: list[str] | None,
    tuck: list[str] | None,
    **flags: list[GarmentValue] | None,
) -> tuple[GarmentSpecification, ...]:
    """The garments that the flags name, or those of the scene file, with what else the flags say of each.

    Args:
        described: garments of the scene file.
        named: values of `--garment`; they take the place of those.
        tuck: names of garments that go into what is worn from the waist.
        flags: values of the other flags, by the field of the garment that they set.

    Raises:
        InputError: a flag names a garment that is not there, or is given for none in particular.
    """
    garments = [GarmentSpecification(name) for name in named] if named else list(described)
    for field, given in flags.items():
        values = _one_each(field, given or [], [garment.name for garment in garments])
        garments = [
            garment if value is None else replace(garment, **{field: value})
            for garment, value in zip(garments, values, strict=True)
        ]
    known = [garment.name for garment in garments]
    for name in tuck or []:
        if name not in known:
            raise unknown_name("garment in this scene", name, known)
    return tuple(replace(garment, tucked=garment.tucked or garment.name in (tuck or [])) for garment in garments)


def _times(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _one_each(flag: str, given: list[GarmentValue], names: list[str]) -> list[Any]:
    """The value of a flag for each of the garments called `names`; None where it says nothing."""
    unnamed = [each.value for each in given if each.garment is None]
    if len(unnamed) not in (0, 1, len(names)):
        raise InputError(
            f"--{flag} is given {len(unnamed)} times, and the garments are {len(names)}; give it once for all, once a "
            f"garment in their order, or as NAME={flag.upper()}."
        )
    values = unnamed if len(unnamed) == len(names) else [unnamed[0] if unnamed else None] * len(names)
    told = [each.garment for each in given if each.garment is not None]
    for name in told:
        if name not in names:
            raise unknown_name("garment in this scene", name, names)
        if names.count(name) > 1 or told.count(name) > 1:
            raise InputError(
                f"--{flag} {name}=.. is not clear: the scene has {_times(names.count(name), 'garment')} of that name, "
                f"and --{flag} names it {_times(told.count(name), 'time')}."
            )
    by_name = {each.garment: each.value for each in given if each.garment is not None}
    return [by_name.get(name, value) for name, value in zip(names, values, strict=True)]
