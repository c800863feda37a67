"""Files that a page handed over: kept in a folder of their own for as long as its window is open."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pb4u.body.library import file_suffixes as body_suffixes
from pb4u.errors import InputError, on_disk
from pb4u.geometry.mesh_file import READERS as MESH_READERS
from pb4u.motion.library import SUFFIXES as MOTION_SUFFIXES

if TYPE_CHECKING:
    from viser import GuiApi

MOST_BYTES = 256 * 2**20
"""Of one file: an SMPL model, or a body of 20,000 vertices over a minute; it is held in memory while it arrives."""

MOST_BYTES_TOGETHER = 4 * MOST_BYTES
"""Of all files of one window."""


@dataclass(frozen=True)
class FileKind:
    """A kind of file that a page may hand over.

    Args:
        suffixes: of the files that can be chosen.
        companions: suffixes of files that are only read beside another.
    """

    suffixes: tuple[str, ...]
    companions: tuple[str, ...] = ()


KINDS = {
    "garment": FileKind(tuple(MESH_READERS)),
    "body": FileKind(body_suffixes()),
    "motion": FileKind(MOTION_SUFFIXES, (".asf",)),
}


class Uploads:
    """Files of one window, deleted when it is closed."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="pb4u-", ignore_cleanup_errors=True)
        self._files: dict[tuple[str, str], Path] = {}

    @property
    def folder(self) -> Path:
        """Folder with the files, with a subfolder for each kind."""
        return Path(self._folder.name)

    def keep(self, kind: str, name: str, content: bytes) -> str:
        """Save a file; returns its name here. A file of this name and kind is replaced.

        Args:
            kind: one of `KINDS`.
            name: as the page gives it, which is not trusted.
            content: all of its bytes.

        Raises:
            InputError: it is of another kind, too large, or the disk is full.
        """
        plain = re.sub(r"[^\w.+-]+", "_", re.split(r"[/\\]", name)[-1]).lstrip("._")
        suffix, accepted = Path(plain).suffix.lower(), KINDS[kind].suffixes + KINDS[kind].companions
        if suffix not in accepted or plain == suffix:
            raise InputError(f"{name} cannot be read as a {kind} file; the accepted formats are {', '.join(accepted)}.")
        there = sum(path.stat().st_size for path in self._files.values() if path.is_file())
        refuse_large(name, len(content), there)
        path = self.folder / kind / plain
        with on_disk(f"{name} cannot be kept"):
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
        self._files[kind, plain] = path
        return plain

    def names(self, kind: str) -> tuple[str, ...]:
        """Names of the files of a kind that can be chosen.

        Args:
            kind: "garment", "body" or "motion".
        """
        chosen = (name for file_kind, name in self._files if file_kind == kind)
        return tuple(name for name in chosen if Path(name).suffix.lower() in KINDS[kind].suffixes)

    def find(self, kind: str, name: str) -> Path | None:
        """The file of that kind and name; None where there is none, as of a built-in name.

        Args:
            kind: "garment", "body" or "motion".
            name: its name.
        """
        return self._files.get((kind, name))

    @property
    def files(self) -> frozenset[Path]:
        """Every file, companions included."""
        return frozenset(self._files.values())

    def close(self) -> None:
        """Delete them all."""
        self._folder.cleanup()


def refuse_large(name: str, size: int, there: int = 0) -> None:
    """Refuse a file that is too large, or one too many.

    Args:
        name: of the file.
        size: bytes of the file.
        there: bytes of the files that are there.

    Raises:
        InputError: it is.
    """
    if size > MOST_BYTES:
        raise InputError(f"{name} has {size / 2**20:,.0f} MB; at most {MOST_BYTES / 2**20:,.0f} MB are allowed.")
    if size + there > MOST_BYTES_TOGETHER:
        raise InputError(
            f"With {name} the files of this page would exceed {MOST_BYTES_TOGETHER / 2**20:,.0f} MB; reload the page "
            "to remove the files it already has."
        )


def bound_uploads(gui: GuiApi, say: Callable[[str], None]) -> None:
    """Let a page hand over nothing that is too large: such a file is dropped at its announcement, or as it arrives.

    The library gathers what arrives in memory without a bound.

    Args:
        gui: controls of one page.
        say: called with the sentence.
    """
    from viser import _messages

    under_way = gui._current_file_upload_states

    def look(_: int, message: Any) -> None:
        state = under_way.get(message.transfer_uuid)
        if state is None:
            return
        try:
            refuse_large(state["filename"], max(state["total_bytes"], state["transferred_bytes"]))
        except InputError as error:
            del under_way[message.transfer_uuid]
            say(str(error))

    for kind in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
        gui._websock_interface.register_handler(kind, look)
