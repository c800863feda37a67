"""Videos: H.264 where an encoder of this machine makes it, else VP9 by OpenCV's wheel."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np

from pb4u.errors import MissingExtraError, Pb4uError, extra
from pb4u.export.incomplete_file import incomplete

_H264_ENCODERS = ("libx264", "h264_videotoolbox", "h264_mf", "libopenh264")
"""By ffmpeg's names: x264, macOS, Windows, Cisco's."""

_H264, _VP9 = "avc1", "vp09"
"""Codes that name a codec in an MP4."""


class VideoWriter(ABC):
    """Writes pictures (height, width, 3) uint8 sRGB into a video; closes it as a context manager.

    Attributes:
        codec: name of the video's codec, for the user.
    """

    codec: str

    def __enter__(self) -> VideoWriter:
        return self

    @abstractmethod
    def write(self, picture: np.ndarray) -> None:
        """Add a picture.

        Args:
            picture: (height, width, 3) uint8 sRGB, as large as the first.
        """

    @abstractmethod
    def __exit__(self, *error: object) -> None:
        """End the video."""


def writes_mp4() -> bool:
    """Whether an encoder is here that MP4 may be written with."""
    return find_spec("cv2") is not None or _ffmpeg() is not None


def check_mp4(path: Path) -> None:
    """Refuse a video where there is nothing to write it with.

    Args:
        path: file to write, for the message.

    Raises:
        MissingExtraError: neither an ffmpeg nor the "render" extra is there.
    """
    if not writes_mp4():
        raise MissingExtraError("render", f"Writing {path.suffix}")


def open_video(path: Path, fps: float, size: tuple[int, int]) -> VideoWriter:
    """A video that is open for its pictures, by the first encoder that proves to work.

    Args:
        path: file to write.
        fps: frames a second [1/s].
        size: width and height [pixels], both even.

    Raises:
        MissingExtraError: neither an ffmpeg with an encoder for H.264 nor the "render" extra is there.
        Pb4uError: no encoder can write the file.
    """
    ffmpeg = _ffmpeg()
    if ffmpeg is not None and (encoder := _working_encoder(ffmpeg, fps, size)) is not None:
        return FfmpegWriter(ffmpeg, encoder, path, fps, size)
    # On macOS and Windows OpenCV hands H.264 to the system's own encoder.
    if _opencv_encodes(_H264, fps, size):
        return OpenCvWriter(path, fps, size, _H264, "H.264, by OpenCV")
    has = 'pip install "pb4u[ffmpeg]" brings H.264'
    reason = f"{ffmpeg} has no encoder for it that works" if ffmpeg is not None else has
    return OpenCvWriter(path, fps, size, _VP9, f"VP9, which some players do not know; not H.264: {reason}")


def _ffmpeg() -> str | None:
    """The ffmpeg of this machine, else that of the "ffmpeg" extra; None where there is neither."""
    installed = shutil.which("ffmpeg")
    if installed is not None:
        return installed
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return None


class OpenCvWriter(VideoWriter):
    """An encoder behind OpenCV. Its wheel brings VP9, which is free of the GPL, unlike x264; browsers play it.

    Args:
        path: file to write.
        fps: frames a second [1/s].
        size: width and height [pixels].
        code: the codec by its code in an MP4.
        codec: the same in words.

    Raises:
        MissingExtraError: OpenCV is not there.
        Pb4uError: it cannot open the file.
    """

    def __init__(self, path: Path, fps: float, size: tuple[int, int], code: str, codec: str) -> None:
        cv2 = _opencv()
        self.codec = codec
        self._path = path
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), fps, size)
        if not self._writer.isOpened():
            raise Pb4uError(f"The video encoder could not open {path.name}; write a .gif instead.")

    def write(self, picture: np.ndarray) -> None:
        self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def __exit__(self, *error: object) -> None:
        self._writer.release()
        # OpenCV tells of no failure; a video's table of contents is written last.
        if error[0] is None and not _is_whole(self._path):
            raise incomplete(self._path)


class FfmpegWriter(VideoWriter):
    """H.264, by an ffmpeg that the user installed; phones and video editors play it.

    Args:
        ffmpeg: the program.
        encoder: one of its encoders.
        path: file to write.
        fps: frames a second [1/s].
        size: width and height [pixels]; H.264 halves the resolution of colours, so both are even.
    """

    def __init__(self, ffmpeg: str, encoder: str, path: Path, fps: float, size: tuple[int, int]) -> None:
        self.codec = f"H.264, by ffmpeg's {encoder}"
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        command = [*_encoding(ffmpeg, encoder, fps, size), "-movflags", "+faststart", str(path)]
        self._process = subprocess.Popen(command, stdin=pipe, stdout=nothing, stderr=pipe)

    def write(self, picture: np.ndarray) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(picture).tobytes())
        except BrokenPipeError as error:
            raise self._failure() from error

    def __exit__(self, *error: object) -> None:
        if self._process.stdin is not None and not self._process.stdin.closed:
            with suppress(BrokenPipeError):
                self._process.stdin.close()
        if error[0] is not None:
            self._process.kill()
        if self._process.wait() and error[0] is None:
            raise self._failure()

    def _failure(self) -> Pb4uError:
        log = self._process.stderr.read().decode(errors="replace").strip().splitlines() if self._process.stderr else []
        return Pb4uError(f"ffmpeg could not write the video: {log[-1] if log else 'it ended early'}.")


def _is_whole(path: Path) -> bool:
    """Whether an MP4 was written to its end: its boxes fill the file, and its table of contents is among them."""
    size, at, kinds = path.stat().st_size, 0, set()
    with path.open("rb") as file:
        while at < size:
            file.seek(at)
            length, kind = int.from_bytes(file.read(4), "big"), file.read(4)
            # A length of 1 is followed by a longer one.
            length = int.from_bytes(file.read(8), "big") if length == 1 else length
            if length < 8:
                return False
            kinds.add(kind)
            at += length
    return at == size and b"moov" in kinds


def _encoding(ffmpeg: str, encoder: str, fps: float, size: tuple[int, int]) -> list[str]:
    """The command of ffmpeg that encodes raw pictures from its standard input, but for where to."""
    return [
        ffmpeg, "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-", "-c:v", encoder, "-pix_fmt", "yuv420p",
    ]  # fmt: skip


def _working_encoder(ffmpeg: str, fps: float, size: tuple[int, int]) -> str | None:
    """The first encoder for H.264 that encodes a picture of this size: some are listed and lack their driver."""
    encoders = subprocess.run([ffmpeg, "-hide_banner", "-encoders"], capture_output=True, text=True, check=False)
    black = bytes(3 * size[0] * size[1])
    for encoder in _H264_ENCODERS:
        if f" {encoder} " not in encoders.stdout:
            continue
        trial = [*_encoding(ffmpeg, encoder, fps, size), "-f", "null", os.devnull]
        if subprocess.run(trial, input=black, capture_output=True, check=False).returncode == 0:
            return encoder
    return None


def _opencv_encodes(code: str, fps: float, size: tuple[int, int]) -> bool:
    """Whether OpenCV writes a video that holds this codec; false where OpenCV is not there."""
    try:
        cv2 = _opencv()
    except MissingExtraError:
        return False
    with tempfile.TemporaryDirectory(prefix="pb4u-") as folder, _muted(cv2):
        path = Path(folder) / "trial.mp4"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), fps, size)
        if not writer.isOpened():
            return False
        writer.write(np.zeros((size[1], size[0], 3), dtype=np.uint8))
        writer.release()
        return path.is_file() and code.encode() in path.read_bytes()


def _opencv() -> ModuleType:
    # Read once, when the first video is opened: ffmpeg's libraries tell of a trial that fails on standard error.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with extra("render", "Writing MP4"):
        import cv2
    return cv2


@contextmanager
def _muted(cv2: ModuleType) -> Iterator[None]:
    """OpenCV without its log, which tells on standard error of a codec that is not there."""
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(level)
