"""Files that are always the old one or the new one, never half of either; and what a killed process left, swept away.

What is not finished lies beside its place under a hidden name that ends in `MARK`: a file for the length of one write,
a folder for as long as its owner holds the lock in it. A kill that no process can answer leaves it; the next one that
writes in the same place finds the lock free and deletes it.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pb4u.errors import InputError

if TYPE_CHECKING:
    from filelock import AcquireReturnProxy

MARK = ".pb4u"
"""End of the name of what is not finished."""
LOCK = ".lock"
"""Name of the file by which a process holds a folder."""
_UNLOCKED_SECONDS = 60.0
"""Age from which what holds no lock is a leftover: a folder is locked, and a file written, in far less."""
_NAME_KEPT = 100
"""Characters kept of a file's name, so that the hidden one is not too long."""


@contextmanager
def working_folder(path: Path) -> Iterator[Path]:
    """A hidden folder beside a file, for its content while it is written; deleted at the end, or by the next writer
    after a kill.

    Args:
        path: path of the file.

    Raises:
        OSError: it cannot be made.
    """
    sweep(path.parent)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name[:_NAME_KEPT]}.", suffix=MARK, dir=path.parent))
    try:
        with locked(folder, f"Another process writes in {folder}."):
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def locked(folder: Path, busy: str) -> AcquireReturnProxy:
    """Keep other processes out of a folder until the end of a `with`.

    Args:
        folder: path of the folder.
        busy: message for a process that finds it locked.

    Raises:
        InputError: another process has locked it.
        OSError: the lock cannot be created.
    """
    from filelock import FileLock, Timeout

    try:
        return FileLock(folder / LOCK).acquire(timeout=0)
    except Timeout:
        raise InputError(busy) from None


def sweep(folder: Path) -> None:
    """Delete unfinished files of killed processes in a folder, except those that may be in use.

    Args:
        folder: path of the folder.
    """
    for leftover in folder.glob(f".*{MARK}"):
        with contextlib.suppress(OSError, InputError):
            if leftover.is_symlink():
                continue
            if leftover.is_dir():
                _sweep_folder(leftover)
            elif _is_old(leftover) and not _is_alive(leftover.name.removesuffix(MARK).rpartition(".")[2]):
                leftover.unlink()


def _sweep_folder(leftover: Path) -> None:
    if not (leftover / LOCK).exists() and not _is_old(leftover):
        return
    with locked(leftover, f"Another process writes in {leftover}."):
        shutil.rmtree(leftover, ignore_errors=True)
    shutil.rmtree(leftover, ignore_errors=True)


def _is_old(path: Path) -> bool:
    return time.time() - path.stat().st_mtime > _UNLOCKED_SECONDS


def _is_alive(process: str) -> bool:
    """Whether a process of this number runs; yes where that is unknown."""
    if not process.isdecimal():
        return True
    try:
        os.kill(int(process), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def check_writable(path: Path, flag: str | None = None) -> None:
    """Refuse a file that cannot be written; called before any work is done.

    Args:
        path: file to write.
        flag: the flag that names it, for the message.

    Raises:
        InputError: its folder is absent or read-only, it is read-only itself, or its name is taken by a folder.
    """
    purpose = f" for {flag}" if flag else ""
    if not path.parent.is_dir():
        raise InputError(f"The folder {path.parent}{purpose} does not exist; make it first.")
    if path.is_dir():
        raise InputError(f"{path}{purpose} is a folder; give the name of a file.")
    folder = Path(os.path.realpath(path)).parent if path.is_symlink() else path.parent
    if not _is_special(path) and not os.access(folder, os.W_OK):
        raise InputError(f"The folder {folder}{purpose} cannot be written to.")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{path}{purpose} is write-protected; give another name, or remove the protection.")


def _is_special(path: Path) -> bool:
    """Whether it is a device, a pipe or the like, which is written to and never replaced."""
    return path.exists() and not path.is_file() and not path.is_dir()


def move_into_place(written: Path, path: Path) -> None:
    """Give a complete file its name, once its bytes are on the disk.

    Args:
        written: path of the finished file, on the same disk.
        path: its new path; a file there is replaced, and its permissions are kept.

    Raises:
        OSError: the disk refuses it.
    """
    with open(written, "rb+") as stream:
        os.fsync(stream.fileno())
    if path.is_file():
        shutil.copymode(path, written)
    os.replace(written, path)


def replace_file(path: Path, content: bytes) -> None:
    """Write a file beside its path and move it there; a link stays, and its target is replaced.

    Args:
        path: path of the file, or of a device or a pipe.
        content: all of its bytes.

    Raises:
        OSError: the disk refuses it; no part of the file remains.
    """
    if _is_special(path):
        path.write_bytes(content)
        return
    if path.is_symlink():
        path = Path(os.path.realpath(path))
    beside = path.with_name(f".{path.name[:_NAME_KEPT]}.{os.getpid()}{MARK}")
    try:
        beside.write_bytes(content)
        move_into_place(beside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise


def json_text(value: Any, indent: int | None = None) -> str:
    """JSON text of a value, numbers that are not finite written as null, which every reader accepts.

    Args:
        value: JSON data.
        indent: spaces for each level; None for one line.
    """
    return json.dumps(_finite(value), indent=indent, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
