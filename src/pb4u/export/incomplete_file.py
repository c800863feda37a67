"""Error for a file that a library did not finish writing."""

from __future__ import annotations

import shutil
from pathlib import Path

from pb4u.errors import InputError


def incomplete(path: Path) -> InputError:
    """Error for a file that a library left incomplete without a usable reason, mostly on a full disk.

    Args:
        path: the file, where it was being written.
    """
    free = shutil.disk_usage(path.parent).free
    return InputError(
        f"Cannot write {path.name}: the file is incomplete, as on a disk that is full or limited; {free / 1e6:,.1f} MB "
        "are free there."
    )
