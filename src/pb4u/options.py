"""Fields of records that users fill in: each is told, offered and checked by what stands beside it in the record.

The text of a field in the docstring of its record is its help; its `Flag` says how it is offered and in what range.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pb4u.errors import InputError, unknown_name

NONE = "none"
"""What is written for None where leaving a field out means something else, as of the ground."""


@dataclass(frozen=True)
class Flag:
    """Flag, scene-file entry and range of a field.

    Args:
        panel: its heading in the help.
        metavar: placeholder of its value in the help; by default its type.
        names: spelling of the flag, if it differs from the name of the field.
        least: smallest value.
        most: largest value.
        is_file: whether a text may name a file, which scene files hold relative to themselves.
        section: its section in a scene file.
        applies_to: part of a model that it changes; models without that part ignore it. None: every model does.
        label: its name in the index of a dataset, by default that of the field; "" if it is not listed.
        by_part: whether a mapping may give a value for each part of a garment.
        form: label of its control in the studio, which shows the fields that have one.
    """

    panel: str | None = None
    metavar: str | None = None
    names: tuple[str, ...] = ()
    least: float | None = None
    most: float | None = None
    is_file: bool = False
    section: str = "scene"
    applies_to: str | None = None
    label: str | None = None
    by_part: bool = False
    form: str | None = None


@dataclass(frozen=True)
class Entry:
    """One field of a record, as flags, scene files and the index use it.

    Args:
        name: of the field.
        type: the first of the possible types of its value.
        kind: "switch", "whole", "number", "vector", "choice", "name", "file", "names", "counts" or "files"; "other"
            where its record checks it.
        optional: whether its value may be None.
        choices: values of a choice.
        default: its default value.
        flag: how it is offered.
        help: its text.
        holder: field of the record that holds the record of this field; "" for the record's own fields.
    """

    name: str
    type: Any
    kind: str
    optional: bool
    choices: tuple[str, ...]
    default: Any
    flag: Flag
    help: str
    holder: str = ""

    def value_in(self, record: Any) -> Any:
        """Its value in a record.

        Args:
            record: the described record.
        """
        return getattr(getattr(record, self.holder) if self.holder else record, self.name)

    @property
    def takes_none(self) -> bool:
        """Whether `NONE` may be written for its value."""
        return self.optional and self.default is not None

    @property
    def label(self) -> str:
        """Its name in the index of a dataset; "" if it is not listed."""
        return self.name if self.flag.label is None else self.flag.label


@lru_cache
def described(record: type) -> Mapping[str, Entry]:
    """The fields of a record that have a flag, by name; a field that is itself a record is replaced by its fields.

    These inner fields have the outer field's panel, and a section of its name.

    Args:
        record: a dataclass whose docstring describes each field.
    """
    texts, hints = argument_texts(record), get_type_hints(record, include_extras=True)
    entries = {}
    for field in fields(record):
        hint = hints[field.name]
        if get_origin(hint) is not Annotated:
            continue
        kinds, flag = get_args(hint)[0], get_args(hint)[1]
        if is_dataclass(kinds) and isinstance(kinds, type):
            for name, inner in described(kinds).items():
                of = replace(inner.flag, panel=flag.panel, section=field.name, applies_to=flag.applies_to)
                entries[name] = replace(inner, flag=of, holder=field.name)
            continue
        parts = get_args(kinds) if isinstance(kinds, UnionType) or get_origin(kinds) is Union else (kinds,)
        choices = next((get_args(part) for part in parts if get_origin(part) is Literal), ())
        values = get_args(kinds)[1:] if flag.by_part and get_origin(kinds) is Mapping else parts
        kind = "choice" if choices else next((name for of, name in _KINDS.items() if of in values), "other")
        default = field.default if field.default is not MISSING else None
        entries[field.name] = Entry(
            field.name, parts[0], kind, type(None) in parts, choices, default, flag, texts[field.name]
        )
    return entries


_KINDS: dict[Any, str] = {
    bool: "switch", int: "whole", float: "number", str: "name", Path: "file", tuple[float, float, float]: "vector",
    tuple[str, ...]: "names", tuple[int, ...]: "counts", tuple[Path, ...]: "files",
}  # fmt: skip


def argument_texts(documented: object) -> dict[str, str]:
    """The text of each argument in a docstring, by name.

    Args:
        documented: a record or a function.
    """
    part = re.search(r"^Args:\n(.*?)(?:^\w|\Z)", inspect.getdoc(documented) or "", re.MULTILINE | re.DOTALL)
    arguments = re.findall(r"^    (\w+): (.*?)(?=^    \w|\Z)", part[1] if part else "", re.MULTILINE | re.DOTALL)
    return {name: " ".join(text.split()) for name, text in arguments}


def require_fitting(record: Any) -> None:
    """Refuse values of a wrong kind or out of range.

    Args:
        record: an instance of a dataclass that `described` describes.

    Raises:
        InputError: a value does not fit its field.
    """
    kind: type = type(record)
    for entry in described(kind).values():
        if not entry.holder:
            require_value(entry, getattr(record, entry.name), entry.name)


def require_value(entry: Entry, value: object, name: str) -> None:
    """Refuse a value of a wrong kind or out of range.

    Args:
        entry: the field.
        value: for it.
        name: name of the field for the user.

    Raises:
        InputError: the value does not fit.
    """
    if entry.flag.by_part and isinstance(value, Mapping) and all(isinstance(part, str) for part in value):
        for part, number in value.items():
            if isinstance(number, Mapping) or not _fits(entry, number):
                raise InputError(f"{name} of {part} must be {_wanted(entry)}, not {number!r}.")
    elif not (value is None and entry.optional) and (_is_by_part_alone(entry) or not _fits(entry, value)):
        each_part = ", for each part by its name" if _is_by_part_alone(entry) else ""
        raise InputError(f"{name} must be {_wanted(entry)}{each_part}, not {value!r}.")


def _is_by_part_alone(entry: Entry) -> bool:
    """Whether a value holds for one part of a garment, and never for all of it."""
    return entry.flag.by_part and get_origin(entry.type) is Mapping


def _fits(entry: Entry, value: Any) -> bool:
    if entry.kind == "choice":
        if value not in entry.choices:
            raise unknown_name(entry.name.replace("_", " "), str(value), entry.choices)
        return True
    if entry.kind == "switch":
        return isinstance(value, bool)
    if entry.kind == "name":
        return value != "" and not isinstance(value, Real | Mapping | list | set) and value is not None
    if entry.kind in ("other", "file", "names", "counts", "files"):
        return True
    if entry.kind == "vector":
        return hasattr(value, "__len__") and len(value) == 3 and all(map(_is_finite, value))
    if not (is_whole(value) if entry.kind == "whole" else _is_finite(value)):
        return False
    least, most = entry.flag.least, entry.flag.most
    return (least is None or value >= least) and (most is None or value <= most)


def _wanted(entry: Entry) -> str:
    """What the value of an entry has to be, in words."""
    if entry.kind == "switch":
        return "true or false"
    if entry.kind == "name":
        return "a name, a path or a loaded object"
    if entry.kind == "vector":
        return "three finite numbers, along X, Y and Z"
    number, least, most = "a whole number" if entry.kind == "whole" else "a number", entry.flag.least, entry.flag.most
    if least is None:
        return number if entry.kind == "whole" else "a finite number"
    return f"{number} from {least:,g} to {most:,g}" if most is not None else f"{number}, {least:,g} or more"


def is_whole(value: object) -> bool:
    """Whether a value is a whole number of Python or numpy; booleans are not.

    Args:
        value: anything.
    """
    return isinstance(value, Integral) and not isinstance(value, bool)


def _is_finite(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def are_pairs(value: object) -> bool:
    """Whether a value is a list of pairs of whole numbers.

    Args:
        value: anything.
    """
    return isinstance(value, list | tuple) and all(
        isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_whole, pair)) for pair in value
    )
