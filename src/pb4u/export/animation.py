"""Moving pictures of a trajectory: GIF, and MP4 through the "render" extra."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.errors import MissingExtraError, Pb4uError
from pb4u.export.picture import View, render
from pb4u.export.progress import Progress
from pb4u.scene.trajectory import Trajectory


def write_gif(
    trajectory: Trajectory,
    path: Path,
    view: View | None = None,
    progress: Progress | None = None,
    highest_fps: float = 15.0,
) -> None:
    """An endlessly looping GIF; frames are dropped so that it plays in real time at no more than `highest_fps`."""
    from PIL import Image

    stride = max(1, round(trajectory.fps / highest_fps))
    moments = range(0, trajectory.frame_count, stride)
    pictures = []
    for done, picture in enumerate(render(trajectory, moments, view), start=1):
        pictures.append(Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE))
        if progress:
            progress(done, len(moments))
    duration = round(1000 * stride / trajectory.fps)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=duration, loop=0)


def write_mp4(trajectory: Trajectory, path: Path, view: View | None = None, progress: Progress | None = None) -> None:
    """An MP4 (VP9) at the trajectory's own frame rate.

    Raises MissingExtraError without the "render" extra.
    """
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("render", "Writing MP4") from error

    writer = None
    for done, picture in enumerate(render(trajectory, range(trajectory.frame_count), view), start=1):
        if writer is None:
            height, width = picture.shape[:2]
            # VP9 because the encoder in the wheel is free of the GPL, unlike x264, and browsers play it.
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"vp09"), trajectory.fps, (width, height))
            if not writer.isOpened():
                raise Pb4uError(f"The video encoder could not open {path}; write a .gif instead.")
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
        if progress:
            progress(done, trajectory.frame_count)
    if writer is not None:
        writer.release()
