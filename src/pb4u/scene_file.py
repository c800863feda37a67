"""Scene files: a `Run` as TOML, with `[scene]`, one `[[garments]]` for each garment, `[run]` and `[environment]`.

The entries are the fields of `Run`, `WornGarment` and `Environment`; what is left out has its default, or what it meant
before there was such an entry (`OF_BEFORE`).
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from pb4u.errors import InputError, refuse_unknown
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.io.atomic_file import replace_file
from pb4u.io.toml_file import read_tables
from pb4u.options import NONE, described
from pb4u.run import SECTIONS, Run, WornGarment, entries, located, names_file

FORMAT_VERSION = 1
"""Version of the scene files that are read and written."""

OF_BEFORE: Mapping[str, Any] = {
    "rest_shape": "moulded",
    "friction_law": "paper",
    "time_integration": "implicit-euler",
    "air": "off",
}
"""What files mean that leave these entries out: what there was before there was a choice, whatever the default is."""

_HEADING = """\
# A scene of pb4u: run it with `pb4u simulate` and the name of this file.
# Garments stand inner first. A value with a dot or a slash is a file, relative to this one; any other is a name.

"""


def read_scene(path: Path) -> Run:
    """The run of a scene file.

    Args:
        path: the file; paths in it are relative to it.

    Raises:
        InputError: the file is missing or no TOML, an entry is unknown, or a value cannot be used.
    """
    if not path.is_file():
        raise InputError(f"There is no scene file {path}.")
    tables = read_tables(path, "a scene file")
    try:
        require_format(tables, ("garments", *SECTIONS), FORMAT_VERSION)
        garments = tables.get("garments", [{}])
        if not isinstance(garments, list):
            raise InputError("Each garment must be a section of its own, written [[garments]].")
        records = tuple(WornGarment(**_section("[[garments]]", table, "garments", path.parent)) for table in garments)
        values = dict(OF_BEFORE)
        for name in SECTIONS:
            values |= _section(f"[{name}]", tables.get(name, {}), name, path.parent)
        return Run(records).with_entries(values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def named_file(value: str | Path) -> Path:
    """The file that a value of a run names, without a following dictionary entry or person of a recording.

    Args:
        value: a path, FILE.pkl:NAME, FILE.pkl:NAME@CENTRE or FILE:PERSON; a built-in name is returned as a path.
    """
    entry = DictionaryEntry.parse(value)
    if entry is not None:
        return entry.path
    if ":" not in str(value):
        return Path(value)
    from pb4u.motion.library import recording_file

    return recording_file(value)[0]


def write_scene(run: Run, path: Path) -> None:
    """Write the scene file of a run, with every value that is set.

    Args:
        run: the run to describe.
        path: the file; paths that are relative to the current folder are written relative to it.

    Raises:
        InputError: something is a loaded object, which has no name to be written.
    """
    import tomli_w

    scene, *others = SECTIONS
    head = {"format_version": FORMAT_VERSION, scene: _written(run, scene, path.parent)}
    garment_tables = [_written(garment, "garments", path.parent) for garment in run.garments]
    # One by one: the library writes short tables of a list on a line each, where nobody finds room for an entry.
    sections = [
        tomli_w.dumps(head),
        *map(_garment_section, garment_tables),
        *(tomli_w.dumps({name: written}) for name in others if (written := _written(run, name, path.parent))),
    ]
    replace_file(path, (_HEADING + "\n".join(sections)).encode())


def _garment_section(written: Mapping[str, Any]) -> str:
    """A `[[garments]]` and its entries, those by part in a table of their own."""
    import tomli_w

    of_parts = {name: value for name, value in written.items() if isinstance(value, Mapping)}
    entries = {name: value for name, value in written.items() if name not in of_parts}
    tables = tomli_w.dumps({"garments": of_parts}) if of_parts else ""
    return "[[garments]]\n" + tomli_w.dumps(entries) + tables


def require_format(tables: Mapping[str, Any], sections: Collection[str], version: int) -> None:
    """Refuse a file with other sections, or of another version of its format.

    Args:
        tables: all of the file.
        sections: that it may have, besides `format_version`.
        version: that is read, and that a file has which says none.

    Raises:
        InputError: a section is unknown, or the version is another.
    """
    refuse_unknown("section", tables, ("format_version", *sections))
    stored = tables.get("format_version", version)
    if stored != version:
        raise InputError(f"The file is of format version {stored!r}; this version reads {version}.")


def require_entries(title: str, table: Any, names: Collection[str]) -> dict[str, Any]:
    """The entries of a section.

    Args:
        title: of the section, such as "[scene]".
        table: its value.
        names: entries that it may have.

    Raises:
        InputError: it is not a table, or an entry is unknown.
    """
    if not isinstance(table, dict):
        raise InputError(f"The section {title} must hold entries such as name = value, not {table!r}.")
    refuse_unknown("entry", table, names, title)
    return table


def _section(title: str, table: Any, section: str, folder: Path) -> dict[str, Any]:
    """The entries of a section, its files found from the `folder` of the scene file."""
    values = require_entries(title, table, entries(section))
    return {name: located(name, value, folder) for name, value in values.items()}


def _written(record: Run | WornGarment, section: str, folder: Path) -> dict[str, Any]:
    """What is set of a section, as TOML holds it; of a record within the run, what is not as usual."""
    kind: type = type(record)
    fields = {name: described(kind)[name] for name in entries(section)}
    values = {
        name: NONE if (value := entry.value_in(record)) is None and entry.takes_none else value
        for name, entry in fields.items()
        if not entry.holder or entry.value_in(record) != entry.default
    }
    return {
        name: _plain(name, value, folder)
        for name, value in values.items()
        if value is not None and value != {} and (name, value) != ("tacks", ())
    }


def _plain(name: str, value: Any, folder: Path) -> Any:
    if names_file(name, value):
        file = value if os.path.isabs(value) else os.path.relpath(value, folder)
        written = Path(file).as_posix()
        return written if names_file(name, written) else f"./{written}"
    if isinstance(value, Mapping):
        return {key: _plain(name, entry, folder) for key, entry in value.items()}
    if isinstance(value, tuple):
        return [_plain("", entry, folder) for entry in value]
    if isinstance(value, str | bool):
        return value
    if isinstance(value, Real):
        return int(value) if isinstance(value, Integral) else float(value)
    raise InputError(
        f"The {name} {getattr(value, 'name', value)} is a loaded object, which a scene file cannot hold; give it by "
        "name or file."
    )
