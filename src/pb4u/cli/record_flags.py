"""Flags of a record: one for each field that `options.described` describes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from pb4u.cli.console import Switch
from pb4u.errors import InputError
from pb4u.options import NONE, Entry, described

_TYPES: Mapping[str, Any] = {"whole": int, "number": float, "file": Path, "files": list[Path], "other": list[str]}


def record_flags(record: type) -> dict[str, Any]:
    """Type of the flag of each field of a record, as typer reads it.

    Args:
        record: a dataclass that `described` describes.
    """
    return {entry.name: flag_of(entry) for entry in described(record).values()}


def flag_of(entry: Entry) -> Any:
    """Type of the flag of a field, as typer reads it.

    Args:
        entry: the field.
    """
    if entry.kind == "vector":
        return Annotated[str | None, option(entry, parser=_vector)]
    if entry.kind == "number" and entry.takes_none:
        return Annotated[str | None, option(entry, parser=_number_or_none)]
    kind: Any = _TYPES.get(entry.kind, str)
    if entry.kind == "choice":
        kind = Literal[entry.choices]
    if entry.kind == "switch":
        kind = Switch if is_on_or_off(entry) else bool
    return Annotated[kind | None, option(entry)]


def _vector(text: str) -> tuple[float, ...]:
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise typer.BadParameter(f"it takes three numbers X,Y,Z such as 0,-1.62,0; not {text!r}.") from None
    return x, y, z


def _number_or_none(text: str) -> float | str:
    try:
        return NONE if text == NONE else float(text)
    except ValueError:
        raise typer.BadParameter(f"it takes a number or {NONE}; {text!r} is neither.") from None


def is_on_or_off(entry: Entry) -> bool:
    """Whether a flag takes `on` or `off`; other switches have separate flags for yes and no.

    Args:
        entry: the field.
    """
    return entry.kind == "switch" and not entry.flag.names


def option(entry: Entry, more: str = "", parser: Callable[[str], Any] | None = None) -> Any:
    """How typer offers a field: its help, with its default, its spelling and its panel.

    Args:
        entry: the field.
        more: text added to the help.
        parser: makes the value of the text.
    """
    text = entry.help + more
    if "Default:" not in text and entry.default not in (None, ()):
        shown = (
            {True: "on", False: "off"}.get(entry.default, entry.default) if entry.kind == "switch" else entry.default
        )
        if entry.kind == "vector":
            shown = ",".join(f"{part:g}" for part in shown)
        text += f" Default: {shown:g}." if isinstance(shown, float) else f" Default: {shown}."
    return typer.Option(
        *entry.flag.names,
        metavar=entry.flag.metavar,
        help=text,
        parser=parser,
        rich_help_panel=entry.flag.panel,
    )


def given_values(record: type, flags: Mapping[str, Any]) -> dict[str, Any]:
    """The values of the flags that were given, as the fields of a record take them.

    Args:
        record: a dataclass that `described` describes.
        flags: values by name of the field, None where a flag is not given.

    Raises:
        InputError: a list of numbers has an entry that is not a number.
    """
    return {name: _value(described(record)[name], value) for name, value in flags.items() if value is not None}


def _value(entry: Entry, value: Any) -> Any:
    if is_on_or_off(entry):
        return value == "on"
    if entry.kind not in ("names", "counts"):
        return value
    names = tuple(name.strip() for name in value.split(",") if name.strip())
    for name in names if entry.kind == "counts" else ():
        if not name.isdecimal():
            raise InputError(f"--{entry.name.replace('_', '-')} takes whole numbers such as 5,15,30, not {name!r}.")
    return tuple(map(int, names)) if entry.kind == "counts" else names
