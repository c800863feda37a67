"""A clip in any export format, ready to be handed to a browser."""

from __future__ import annotations

import io
import os
import re
import tempfile
import threading
import zipfile
from pathlib import Path

from pb4u.errors import InputError
from pb4u.export.registry import WRITERS, export
from pb4u.viewer.clip import Clip

# One off-screen renderer at a time: pictures are drawn with OpenGL, whose contexts do not share threads well.
_ONE_AT_A_TIME = threading.Lock()


def deliver(clip: Clip, suffix: str, folder: Path | None = None) -> tuple[str, bytes, Path | None]:
    """Write `clip` in the format of `suffix`.

    Args:
        clip: what to write.
        suffix: one of `pb4u.export.registry.WRITERS`.
        folder: where to keep the files as well; None keeps none.

    Returns the name and content of one file for the browser (a ZIP where the format is several files), and where it
    was kept. Raises InputError or MissingExtraError with the sentence of the exporter.
    """
    if suffix not in WRITERS:
        raise InputError(f"There is no format {suffix!r}; there are {', '.join(WRITERS)}.")
    if not clip.frame_count:
        raise InputError("There is no frame to export yet.")
    stem = re.sub(r"[^A-Za-z0-9]+", "_", clip.label).strip("_") or "garment"
    with tempfile.TemporaryDirectory(prefix="pb4u-") as scratch:
        target = Path(scratch) / f"{stem}{suffix}"
        with _ONE_AT_A_TIME:
            export(clip.trajectory(), target)
        files = sorted(Path(scratch).iterdir())
        if not files:
            raise InputError(f"The exporter wrote no file for {suffix}.")
        kept = None if folder is None else _keep(files, folder, target.name)
        if len(files) == 1:
            return files[0].name, files[0].read_bytes(), kept
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in files:
                archive.write(file, file.name)
        return f"{stem}.zip", packed.getvalue(), kept


def _keep(files: list[Path], folder: Path, name: str) -> Path:
    from pb4u.atomic_file import replace_file

    for file in files:
        replace_file(folder / file.name, file.read_bytes())
    written = folder / name
    return written if written.exists() else folder / os.fspath(files[0].name)
