"""Reads a TOML file, or says in a sentence why it is none."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from pb4u.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_tables(path: Path, kind: str) -> dict[str, Any]:
    """The tables of a TOML file.

    Args:
        path: the file.
        kind: its kind, such as "a scene file".

    Raises:
        InputError: it is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        reason = "it is not text" if isinstance(error, UnicodeDecodeError) else error
        raise InputError(f"{path} cannot be read as TOML, which {kind} is: {reason}.") from None
