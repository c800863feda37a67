"""What a page says when something fails: one plain sentence, whatever it was."""

from __future__ import annotations

import sys
import traceback

from pb4u.errors import Pb4uError


def plain_sentence(error: BaseException) -> str:
    """The sentence; of an error that nobody foresaw also the traceback, on the terminal that runs the studio."""
    if isinstance(error, Pb4uError):
        return " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return "There is not enough memory for this; ask for fewer triangles or frames."
    if isinstance(error, OSError):
        where = f" ({error.filename})" if error.filename else ""
        return f"{error.strerror or error}{where}."
    traceback.print_exception(error, file=sys.stderr)
    return f"Something unforeseen went wrong ({type(error).__name__}); the terminal shows where. The page goes on."
