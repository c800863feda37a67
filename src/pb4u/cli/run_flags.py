"""The flags of a run, one for each field of `Run` and `WornGarment`; their help and panels are the fields' own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import typer

from pb4u.cli.console import BodyShape, FrameRange
from pb4u.cli.record_flags import flag_of, is_on_or_off, option
from pb4u.errors import InputError, refuse_unknown
from pb4u.options import NONE, Entry, described, require_value
from pb4u.run import BODY, GARMENT, MODEL, RESEARCH, REST, SCENE, SECTIONS, Run, WornGarment, entries

AS_RELEASED: Mapping[str, str] = {"pb4u": "release", "hood": "hood", "mgn": "mgn", "contourcraft": "contourcraft"}
"""First frame of the released code of each method."""


class GarmentValue(NamedTuple):
    """A value of a flag for one garment.

    Args:
        garment: name of the garment; None if the order in the command decides.
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
            BadParameter: N is not a whole number.
        """
        name, value = cls.parse(text)
        try:
            return cls(name, int(value))
        except ValueError:
            raise typer.BadParameter(f"it takes a whole number or NAME=N; {text!r} is neither.") from None

    @classmethod
    def parse_number(cls, text: str) -> GarmentValue:
        """Value from `X` or `NAME=X`.

        Raises:
            BadParameter: X is not a number.
        """
        name, value = cls.parse(text)
        try:
            return cls(name, float(value))
        except ValueError:
            raise typer.BadParameter(f"it takes a number or NAME=X; {text!r} is neither.") from None

    @classmethod
    def parse_pair(cls, text: str) -> GarmentValue:
        """Value from `A:B` or `NAME=A:B`.

        Raises:
            BadParameter: A and B are not whole numbers.
        """
        name, value = cls.parse(text)
        pair = value.split(":")
        if len(pair) != 2 or not all(part.strip().isdecimal() for part in pair):
            raise typer.BadParameter(f"it takes two vertices A:B or NAME=A:B; {text!r} is neither.")
        return cls(name, (int(pair[0]), int(pair[1])))

    @classmethod
    def parse_direction(cls, text: str) -> GarmentValue:
        """Value from `X,Y,Z` or `NAME=X,Y,Z`.

        Raises:
            BadParameter: these are not three numbers.
        """
        name, value = cls.parse(text)
        try:
            x, y, z = map(float, value.split(","))
        except ValueError:
            raise typer.BadParameter(f"it takes a direction X,Y,Z or NAME=X,Y,Z; {text!r} is neither.") from None
        return cls(name, (x, y, z))

    @classmethod
    def parse_part(cls, text: str) -> GarmentValue:
        """Value from `NAME.PART=N`.

        Raises:
            BadParameter: no part is named, or N is not a number.
        """
        name, value = cls.parse(text)
        try:
            number = float(value)
        except ValueError:
            number = None
        if number is None or "." not in (name or ""):
            raise typer.BadParameter(f"it takes a number for a part, NAME.PART=N; {text!r} is none.")
        return cls(name, int(number) if number.is_integer() else number)


TuckFlag: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME",
        help="Garment to tuck into the trousers or the skirt; its place in the order of --garment does not matter. "
        "Repeatable.",
        rich_help_panel=GARMENT,
    ),
]
AsReleasedFlag: TypeAlias = Annotated[
    Literal["pb4u", "mgn", "hood", "contourcraft"] | None,
    typer.Option(
        help="Play a recording as the authors of this released code did: --as-recorded, --rest-shape moulded, "
        "--arms-away 20, --lead-in 31, its own first frame and friction, one pass in float32, and neither contact, "
        "self-contact nor refinement. Other flags win.",
        rich_help_panel=RESEARCH,
    ),
]


def released_entries(method: str) -> dict[str, Any]:
    """Entries of a run that plays a recording like the released code of `method`, a key of `AS_RELEASED`."""
    return {
        "as_recorded": True,
        "rest_shape": "moulded",
        "arms_away": 20.0,
        "lead_in": 31,
        "first_frame": AS_RELEASED[method],
        "refine": 0,
        "passes": 1,
        "contact": False,
        "self_contact": False,
        "precision": "float32",
        "friction_law": "paper",
        "time_integration": "implicit-euler",
        "air": "off",
    }


def run_of(described_run: Run, flags: Mapping[str, Any]) -> Run:
    """The run that the flags change.

    Args:
        described_run: run of the scene file, or the default.
        flags: values by name of the field, None where a flag is not given; `tuck` and `as_released` beside them.

    Raises:
        InputError: a flag names an unknown garment, or does not say which garment it is for.
    """
    values = {name: value for name, value in flags.items() if value is not None}
    tuck, tack, method = values.pop("tuck", []), values.pop("tack", []), values.pop("as_released", None)
    garments = values.get("garment")
    names = [garment.name for garment in (map(WornGarment, garments) if garments else described_run.garments)]
    of_parts = _of_parts(values, names)
    for name in entries("garments"):
        if name in values and name not in ("garment", "tucked", "tacks"):
            values[name] = _one_each(name, values[name], names)
    for name, number, part, value in of_parts:
        row = values.setdefault(name, [None] * len(names))
        before = None if garments else getattr(described_run.garments[number], name)
        part_values = row[number] if row[number] is not None else before
        rest = {} if part_values is None else {REST: part_values}
        row[number] = {**(part_values if isinstance(part_values, Mapping) else rest), part: value}
    refuse_unknown("garment", tuck, names, "The scene")
    if tuck:
        values["tucked"] = [True if name in tuck else None for name in names]
    if tack:
        values["tacks"] = [[value.value for value in tack if value.garment in (None, name)] or None for name in names]
        for value in tack:
            if value.garment is None and len(names) > 1:
                raise InputError(f"--tack must name the garment of its vertices, as in --tack {names[0]}=10:210.")
        refuse_unknown("garment", [value.garment for value in tack if value.garment], names, "The scene")
    for entry in described(Run).values():
        if entry.name in values and is_on_or_off(entry):
            values[entry.name] = values[entry.name] == "on"
        is_none = entry.takes_none and values.get(entry.name) == NONE
        if entry.name in values and entry.kind in ("whole", "number", "vector") and not is_none:
            require_value(entry, values[entry.name], f"--{entry.name.replace('_', '-')}")
    if "body_shape" in values:
        shape = {} if "body" in values else described_run.body_shape
        values["body_shape"] = {**shape, **BodyShape.of(values["body_shape"])}
    return described_run.with_entries({**({} if method is None else released_entries(method)), **values})


def run_flags() -> dict[str, Any]:
    """Type of the flag of each field of a run, as typer reads it."""
    ordered = [described(Run)[name] for section in SECTIONS for name in entries(section)]
    ordered.sort(key=lambda entry: (SCENE, BODY, MODEL, RESEARCH).index(entry.flag.panel))
    return {
        **dict(map(_garment_flag, described(WornGarment).values())),
        **{entry.name: flag_of(entry) for entry in ordered},
        "crop": Annotated[FrameRange | None, option(described(Run)["crop"], parser=FrameRange.parse)],
        "body_shape": Annotated[list[BodyShape] | None, option(described(Run)["body_shape"], parser=BodyShape.parse)],
        "as_released": AsReleasedFlag,
    }


def _garment_flag(entry: Entry) -> tuple[str, Any]:
    """Name of the flag of a field of `WornGarment`, and its type."""
    if entry.name == "tucked":
        return "tuck", TuckFlag
    if entry.name == "tacks":
        return "tack", Annotated[list[GarmentValue] | None, option(entry, " Repeatable.", GarmentValue.parse_pair)]
    if entry.name == "garment":
        return entry.name, Annotated[list[str] | None, option(entry, " Repeatable, inner first.")]
    if entry.flag.by_part and entry.kind in ("whole", "number"):
        return entry.name, Annotated[list[GarmentValue] | None, option(entry, " Repeatable.", GarmentValue.parse_part)]
    parsers = {
        "whole": GarmentValue.parse_count,
        "number": GarmentValue.parse_number,
        "vector": GarmentValue.parse_direction,
    }
    parser = parsers.get(entry.kind, GarmentValue.parse)
    more = " Once for all garments, once a garment in their order, or as NAME=VALUE."
    return entry.name, Annotated[list[GarmentValue] | None, option(entry, more, parser)]


def _of_parts(values: dict[str, Any], names: Sequence[str]) -> list[tuple[str, int, str, Any]]:
    """Takes out of `values` what is for one part of a garment: the flag, number of the garment, part and value."""
    parts = []
    for name in [
        field.name for field in described(WornGarment).values() if field.flag.by_part and field.name in values
    ]:
        for value in list(values[name]):
            garment, dot, part = (value.garment or "").rpartition(".")
            if dot and value.garment not in names:
                refuse_unknown("garment", [garment], names, "The scene")
                parts.append((name, names.index(garment), part, value.value))
                values[name].remove(value)
        if not values[name]:
            del values[name]
    return parts


def _one_each(flag: str, flag_values: Sequence[GarmentValue], names: Sequence[str]) -> list[Any]:
    """The value of a flag for each of the garments called `names`; None where it says nothing."""
    unnamed = [value.value for value in flag_values if value.garment is None]
    if len(unnamed) not in (0, 1, len(names)):
        raise InputError(
            f"--{flag} is given {len(unnamed)} times for {len(names)} garments; give it once for all, once for each "
            f"garment in their order, or as NAME={flag.upper()}."
        )
    values = unnamed if len(unnamed) == len(names) else [unnamed[0] if unnamed else None] * len(names)
    by_name = [value.garment for value in flag_values if value.garment is not None]
    for name in by_name:
        refuse_unknown("garment", [name], names, "The scene")
        if names.count(name) > 1 or by_name.count(name) > 1:
            why = (
                f"the scene has {names.count(name)} garments of that name"
                if names.count(name) > 1
                else f"it is given {by_name.count(name)} times"
            )
            raise InputError(f"--{flag} {name}=.. does not say which: {why}.")
    by_garment = {value.garment: value.value for value in flag_values if value.garment is not None}
    return [by_garment.get(name, value) for name, value in zip(names, values, strict=True)]
