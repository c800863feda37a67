"""Videos: VP9 by OpenCV's wheel, H.264 by an ffmpeg of the user's own."""

from __future__ import annotations

import shutil
import subprocess
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path

import numpy as np

from pb4u.errors import MissingExtraError, Pb4uError

_H264_ENCODERS = ("libx264", "h264_videotoolbox", "h264_mf", "libopenh264")
"""By ffmpeg's names: x264, macOS, Windows, Cisco's."""


class VideoWriter(ABC):
    """Writes pictures (height, width, 3) uint8 sRGB into a video; closes it as a context manager."""

    def __enter__(self) -> VideoWriter:
        return self

    @abstractmethod
    def write(self, picture: np.ndarray) -> None:
        """Add a picture."""

    @abstractmethod
    def __exit__(self, *error: object) -> None:
        """End the video."""


class Vp9Writer(VideoWriter):
    """VP9, by the encoder in OpenCV's wheel, which is free of the GPL, unlike x264; browsers play it.

    Args:
        path: file to write.
        fps: frames a second [1/s].
        size: width and height [pixels].
    """

    def __init__(self, path: Path, fps: float, size: tuple[int, int]) -> None:
        try:
            import cv2
        except ImportError as error:
            raise MissingExtraError("render", "Writing MP4") from error
        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"vp09"), fps, size)
        if not self._writer.isOpened():
            raise Pb4uError(f"The video encoder could not open {path.name}; write a .gif instead.")

    def write(self, picture: np.ndarray) -> None:
        self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def __exit__(self, *error: object) -> None:
        self._writer.release()


class H264Writer(VideoWriter):
    """H.264, by an ffmpeg that the user installed; phones and video editors play it.

    Args:
        command: ffmpeg's, which reads raw pictures from its standard input.
    """

    def __init__(self, command: list[str]) -> None:
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        self._process = subprocess.Popen(command, stdin=pipe, stdout=nothing, stderr=pipe)

    @staticmethod
    def opened(path: Path, fps: float, size: tuple[int, int]) -> H264Writer | None:
        """A writer, or None where there is no ffmpeg with an encoder for it.

        Args:
            path: file to write.
            fps: frames a second [1/s].
            size: width and height [pixels]; H.264 halves the resolution of colours, so both sides have to be even.
        """
        ffmpeg = shutil.which("ffmpeg")
        if ffmpeg is None or size[0] % 2 or size[1] % 2:
            return None
        listed = subprocess.run([ffmpeg, "-hide_banner", "-encoders"], capture_output=True, text=True, check=False)
        encoder = next((name for name in _H264_ENCODERS if f" {name} " in listed.stdout), None)
        if encoder is None:
            return None
        return H264Writer(
            [ffmpeg, "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24",
             "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-",
             "-c:v", encoder, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
        )  # fmt: skip

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
        told = self._process.stderr.read().decode(errors="replace").strip().splitlines() if self._process.stderr else []
        return Pb4uError(f"ffmpeg could not write the video: {told[-1] if told else 'it ended early'}.")
