"""What a file may unpack to (docs/design/files.md), JSON text, and short sentences on what a file holds."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pb4u.errors import InputError

HEADROOM = 256 * 2**20
"""Bytes that the content of a file may take over its size."""
_MOST_DIGITS = 18
"""Digits of a whole number in JSON; those of a 64-bit number."""
_MOST_TOLD = 200
"""Characters of what a library says of a file that are passed on."""


def require_room(path: Path, size: int) -> None:
    """Refuse a file whose content would take far more memory than the file has.

    Args:
        path: the file.
        size: bytes of its content once unpacked.

    Raises:
        InputError: they are too many.
    """
    most = path.stat().st_size + HEADROOM
    if size > most:
        raise InputError(
            f"{path}: its content would take {megabytes(size)} of memory; a file of {megabytes(most - HEADROOM)} may "
            f"take {megabytes(most)} (its size plus {megabytes(HEADROOM)}): save it uncompressed, or in smaller parts."
        )


def megabytes(size: int) -> str:
    """Bytes in megabytes, for a message.

    Args:
        size: number of bytes.
    """
    return f"{size / 2**20:,.0f} MB" if size >= 2**20 else f"{size:,} bytes"


def parse_json(text: str | bytes) -> Any:
    """The data of a JSON text.

    Args:
        text: the JSON, bytes in UTF-8.

    Raises:
        ValueError: it is not JSON, nests too deep, or holds a whole number of too many digits.
    """
    try:
        return json.loads(text, parse_int=_whole)
    except RecursionError:
        raise ValueError("its lists and objects are nested too deeply") from None


def _whole(digits: str) -> int:
    if len(digits.lstrip("-")) > _MOST_DIGITS:
        raise ValueError(f"a whole number of {len(digits):,} digits; at most {_MOST_DIGITS} are read")
    return int(digits)


def read_json(path: Path) -> Any:
    """The data of a JSON file.

    Args:
        path: the file.

    Raises:
        OSError: it cannot be read.
        ValueError: as `parse_json`.
    """
    return parse_json(path.read_bytes())


def names_text(names: Iterable[object], like: Sequence[str] = ()) -> str:
    """The first of many names, for a message.

    Args:
        names: any number of names.
        like: parts of names to list first, since they are likely matches.
    """
    texts = (str(name)[:40] for name in names)
    ordered = sorted(texts, key=lambda text: (not any(part in text for part in like), text))
    return ", ".join(ordered[:10]) + (f" and {len(ordered) - 10} more" if len(ordered) > 10 else "") or "(none)"


def error_text(error: BaseException) -> str:
    """Message of a library's error, cut to the length of a sentence: some repeat the whole file.

    Args:
        error: the error that the library raised.
    """
    text = "it holds bytes that are no text" if isinstance(error, UnicodeDecodeError) else str(error)
    text = text or type(error).__name__
    return text if len(text) <= _MOST_TOLD else f"{text[:_MOST_TOLD]} .."


@contextmanager
def refusing(path: Path, sentence: str) -> Iterator[None]:
    """Turn any error while reading a file into one InputError: a damaged file can raise nearly anything.

    Args:
        path: the file.
        sentence: what is wrong with it, as a predicate after its name; the original error follows in brackets.

    Raises:
        InputError: instead of the original error.
    """
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except Exception as error:
        kind = "" if type(error) in (ValueError, UnicodeDecodeError) else f"{type(error).__name__}: "
        raise InputError(f"{path} {sentence} ({kind}{error_text(error)}); save or fetch it again.") from error
