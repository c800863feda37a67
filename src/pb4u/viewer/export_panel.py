"""A clip in any export format, for download and, where the studio was given a folder, kept there too."""

from __future__ import annotations

import io
import tempfile
import threading
import zipfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

from pb4u.errors import InputError, refuse_unknown
from pb4u.export.registry import WRITERS, export
from pb4u.export.video_writer import writes_mp4
from pb4u.io.atomic_file import replace_file
from pb4u.io.companions import with_companions
from pb4u.run import Run
from pb4u.viewer.clip import Clip
from pb4u.viewer.film import SUFFIXES as FILM_SUFFIXES
from pb4u.viewer.panel import Panel, Tone, notice

# Pictures are drawn with OpenGL, whose contexts do not share threads well, and two windows may keep the same name.
_ONE_AT_A_TIME = threading.Lock()


class ExportPanel(Panel):
    """Controls of an export: format, and which clip where there are two."""

    def _add_controls(self) -> None:
        gui = self._gui
        self._format = gui.add_dropdown("Format", list(WRITERS), initial_value=".npz")
        self._which = gui.add_dropdown("Trajectory", ("left", "right"), visible=False)
        self._go = gui.add_button("Export")
        self._status = gui.add_html("")
        self._go.on_click(self._answer(self._export))
        with gui.add_folder("Current view"):
            self._still = gui.add_button("Still of this frame")
            self._film_format = gui.add_dropdown("Video", FILM_SUFFIXES[1:], initial_value=usual_video())
            self._film = gui.add_button("Video of all frames")
            self._stop = gui.add_button("Stop", visible=False)
            self._film_status = gui.add_html("")
        self._still.on_click(self._answer(lambda: self._window.film(".png")))
        self._film.on_click(self._answer(lambda: self._window.film(self._film_format.value)))
        self._stop.on_click(self._answer(self._window.stop_filming))

    def _export(self) -> None:
        self._go.disabled = True
        self._status.content = notice(f"Writing {self._format.value}.")
        sentence = ""
        try:
            sentence = self._window.export(self._format.value, ("left", "right").index(self._which.value))
        finally:
            self._status.content = notice(sentence, Tone.good)
            self._go.disabled = False

    def filming(self, number: int, total: int) -> None:
        """Show the progress of a recording: how many pictures of the view were taken.

        Args:
            number: pictures taken.
            total: pictures in all.
        """
        self._still.disabled = self._film.disabled = True
        self._stop.visible = total > 1
        self._film_status.content = notice(f"Picture {number + 1} of {total}; the view stays as it is meanwhile.")

    def filmed(self, sentence: str) -> None:
        """Show that recording has ended; `sentence` says with what result.

        Args:
            sentence: what became of the pictures.
        """
        self._still.disabled = self._film.disabled = self._stop.visible = False
        self._film_status.content = notice(sentence, Tone.good)

    def offer(self, clips: int) -> None:
        """Show the choice of a clip where there are two; `clips` is their number.

        Args:
            clips: number of clips.
        """
        self._which.visible = clips > 1


def usual_video() -> str:
    """The video format that is offered first: MP4 where it can be written."""
    return ".mp4" if writes_mp4() else ".gif"


def pack_scene(run: Run, folder: Path) -> tuple[str, bytes]:
    """A scene file, alone or packed with the files it names: name and content of one file for the browser.

    Args:
        run: the run to describe.
        folder: that holds the files it names, and for a moment the scene file.
    """
    with _ONE_AT_A_TIME:
        written = run.save(folder / "scene.toml").read_text(encoding="utf-8")
        (folder / "scene.toml").unlink()
    # Where they are unpacked, files lie beside the scene.
    text = written.replace(f"{folder.as_posix()}/", "")
    files = [path for path in run.files if isinstance(path, Path)]
    if not files:
        return "scene.toml", text.encode()
    # What belongs to a file lies beside it: under the same name, or by a name that it tells.
    alike = {other for path in files for other in path.parent.iterdir() if other.stem == path.stem}
    beside = alike | {other for path in files for other in with_companions(path)}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scene.toml", text)
        for path in sorted(beside):
            archive.write(path, path.relative_to(folder))
    return "scene.zip", packed.getvalue()


def _free_names(folder: Path, stem: str, names: list[str]) -> list[str]:
    """`names`, which begin with `stem`, numbered where one of them is taken: what is in the folder stays."""
    for number in count(1):
        candidates = names if number == 1 else [f"{stem}-{number}{name.removeprefix(stem)}" for name in names]
        if not any((folder / name).exists() for name in candidates):
            break
    return candidates


def deliver(
    clip: Clip, suffix: str, folder: Path | None = None, say: Callable[[str], None] | None = None
) -> tuple[str, bytes, Path | None]:
    """Write `clip` in the format of `suffix`.

    Args:
        clip: what to write.
        suffix: one of `pb4u.export.registry.WRITERS`.
        folder: in which to save the files as well; None for none.
        say: called with a sentence on details of the written file.

    Returns:
        Name and content of one file for the browser (a ZIP where the format is several files), and the path where it
        was saved.

    Raises:
        InputError: there is no such format or no frame yet, or the exporter refuses.
        MissingExtraError: the format needs an extra.
    """
    refuse_unknown("format", [suffix], WRITERS)
    if not clip.frame_count:
        raise InputError("There is no frame to export yet.")
    stem = clip.file_stem
    with _ONE_AT_A_TIME, tempfile.TemporaryDirectory(prefix="pb4u-") as scratch:
        target = Path(scratch) / f"{stem}{suffix}"
        export(clip.trajectory(), target, say=say)
        files = sorted(Path(scratch).iterdir())
        if not files:
            raise InputError(f"No {suffix} file was written; try another format, or pb4u convert, which may say why.")
        saved = None
        if folder is not None:
            names = _free_names(folder, stem, [file.name for file in files])
            for file, name in zip(files, names, strict=True):
                replace_file(folder / name, file.read_bytes())
            saved = folder / names[files.index(target) if target in files else 0]
        if len(files) == 1:
            return files[0].name, files[0].read_bytes(), saved
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in files:
                archive.write(file, file.name)
        return f"{stem}.zip", packed.getvalue(), saved
