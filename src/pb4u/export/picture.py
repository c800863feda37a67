"""Off-screen rendering of a trajectory: PNG and JPEG stills, GIF and MP4."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from pb4u.errors import InputError, Pb4uError
from pb4u.export.finite_frames import held_frames
from pb4u.export.shading import CLOTH, SKIN, face_colours
from pb4u.export.video_writer import H264Writer, VideoWriter, Vp9Writer
from pb4u.geometry.triangle_mesh import vertex_normals
from pb4u.progress import Progress, unheard
from pb4u.scene.trajectory import Trajectory

if TYPE_CHECKING:
    import pyvista


@dataclass(frozen=True)
class View:
    """Camera, size and colours of pictures.

    Args:
        width: of a picture [pixels].
        height: of a picture [pixels].
        azimuth: angle around the vertical [deg]; 0 is in front of the body, positive towards its left.
        elevation: angle above the horizontal [deg].
        turntable: turn of the camera about the vertical over the whole clip [deg].
        show_body: whether the body is drawn.
        cloth: colour of the first garment, RGB in [0, 1].
        background: colour behind and below it all, RGB in [0, 1].
    """

    width: int = 560
    height: int = 800
    azimuth: float = 25.0
    elevation: float = 8.0
    turntable: float = 0.0
    show_body: bool = True
    cloth: tuple[float, float, float] = CLOTH
    background: tuple[float, float, float] = (0.93, 0.935, 0.94)


SIDES = {"front": 0.0, "left": 90.0, "back": 180.0, "right": -90.0}
"""Azimuths [deg] by name; left and right are the body's own."""

_MARGIN = 1.2
"""Share of the figure that the picture is higher: a foot half a metre nearer to the camera looks a tenth larger."""

_FIELD_OF_VIEW = 24.0

_SLOWEST = 0.002
"""Frames per second of a film at least: a GIF shows one for 655 s at most, and VP9 for 1000."""


class StillRenderer:
    """Renderer of single frames: a lit scene with garment and body, whose positions are replaced frame by frame.

    Args:
        trajectory: what is drawn.
        view: camera, size and colours.
    """

    def __init__(self, trajectory: Trajectory, view: View) -> None:
        import pyvista

        self._trajectory = trajectory
        self._view = view
        self._plotter = pyvista.Plotter(off_screen=True, window_size=[view.width, view.height], lighting="none")
        cloth = face_colours(trajectory.faces, trajectory.header.vertex_garment, view.cloth)
        self._cloth = self._add(trajectory.positions[0], trajectory.faces, cloth, specular=0.06)
        self._held = frozenset(held_frames(trajectory))
        self._body = None
        if view.show_body:
            faces = trajectory.header.body_faces
            self._body = self._add(trajectory.body_positions[0], faces, np.tile(SKIN, (len(faces), 1)), specular=0.12)
        self._light()
        self._add_ground()
        self._frame_size = self._extent()

    def _add(self, points: np.ndarray, faces: np.ndarray, colours: np.ndarray, specular: float) -> pyvista.PolyData:
        """A surface in the picture; `colours` are (faces, 3) sRGB [0 to 1]."""
        import pyvista

        cells = np.column_stack([np.full(len(faces), 3), faces]).ravel()
        mesh = pyvista.PolyData(np.array(points, dtype=np.float32), cells)
        mesh.cell_data["colours"] = (255 * colours).round().astype(np.uint8)
        mesh.point_data["Normals"] = np.zeros_like(mesh.points)
        mesh.point_data.active_normals_name = "Normals"
        self._plotter.add_mesh(
            mesh, scalars="colours", rgb=True, ambient=0.16, diffuse=0.9,
            specular=specular, specular_power=12, interpolation="Phong",
        )  # fmt: skip
        return mesh

    def _light(self) -> None:
        import pyvista

        # A low key light from the side makes wrinkles cast shading; fill and rim keep the rest readable.
        turn = self._heading() + np.deg2rad(self._view.azimuth - View.azimuth)
        for (x, y, z), intensity in (((4.0, 4.5, 5.0), 0.72), ((-5.0, 3.0, 3.0), 0.34), ((0.0, 5.0, -6.0), 0.35)):
            position = x * np.cos(turn) + z * np.sin(turn), y, z * np.cos(turn) - x * np.sin(turn)
            light = pyvista.Light(
                position=position, focal_point=(0, 1, 0), intensity=intensity, light_type="scene light"
            )
            self._plotter.add_light(light)
        self._plotter.renderer.set_background(self._view.background, top=_lighter(self._view.background))

    def _add_ground(self) -> None:
        import pyvista

        ground = pyvista.Plane(center=(0, -2e-3, 0), direction=(0, 1, 0), i_size=400, j_size=400)
        self._plotter.add_mesh(ground, color=self._view.background, lighting=False)
        self._shadow = pyvista.Disc(center=(0, 0, 0), inner=0.0, outer=1.0, normal=(0, 1, 0), r_res=24, c_res=48)
        radius = np.linalg.norm(self._shadow.points, axis=1)
        self._shadow_shape = self._shadow.points.copy()
        shade = 1.0 - 0.30 * np.clip(1.0 - radius, 0.0, 1.0) ** 1.5
        colours = (255 * shade[:, None] * np.array(self._view.background)).astype(np.uint8)
        self._plotter.add_mesh(self._shadow, scalars=colours, rgb=True, lighting=False)

    def _extent(self) -> float:
        """Height of the picture [m] that holds body and garment in every frame, seen from any side."""
        sample = np.linspace(0, self._trajectory.frame_count - 1, min(32, self._trajectory.frame_count)).astype(int)
        size = 0.0
        for t in sample:
            points = self._visible(int(t))
            points = points[np.isfinite(points).all(axis=1)]
            if len(points):
                aside = np.linalg.norm(points[:, [0, 2]] - self._centre(int(t)), axis=1).max()
                size = max(size, float(points[:, 1].max()), 2.0 * aside * self._view.height / self._view.width)
        return min(size, 6.0) * _MARGIN

    def _centre(self, t: int) -> np.ndarray:
        """Where the camera looks on the ground, (2,) x and z [m]."""
        return np.asarray(np.median(self._trajectory.body_positions[t][:, [0, 2]], axis=0))

    def _visible(self, t: int) -> np.ndarray:
        return np.concatenate([self._trajectory.positions[t], self._trajectory.body_positions[t]])

    def _heading(self) -> float:
        """Angle about the vertical [rad] of the direction the body faces at the start; 0 is +Z."""
        return float(self._trajectory.metadata.get("heading", 0.0))

    def draw(self, t: int) -> np.ndarray:
        """Picture of frame t, (height, width, 3) uint8 sRGB [0 to 255].

        Raises:
            Pb4uError: the renderer returns no picture.
        """
        trajectory = self._trajectory
        _move(self._cloth, trajectory.positions[t], trajectory.faces)
        if self._body is not None:
            _move(self._body, trajectory.body_positions[t], trajectory.header.body_faces)
        self._cast_shadow(t)
        self._mark_held(t)
        self._aim(t)
        self._plotter.render()
        image = self._plotter.screenshot(return_img=True)
        if image is None:
            raise Pb4uError("The off-screen renderer returned no picture.")
        return np.asarray(image)

    def _mark_held(self, t: int) -> None:
        """Say so in the picture where a frame only stands in for one that is not finite."""
        if self._held:
            text = f"frame {t} is not finite" if t in self._held else ""
            self._plotter.add_text(text, name="held", font_size=10, color="red")

    def _cast_shadow(self, t: int) -> None:
        """A soft patch under the body, without which feet seem to float."""
        body = self._trajectory.body_positions[t]
        low = body[body[:, 1] < body[:, 1].min() + 0.12]
        size = np.maximum(np.ptp(low[:, [0, 2]], axis=0), 0.25) * 0.9
        centre = (low.max(axis=0) + low.min(axis=0)) / 2
        scaled = self._shadow_shape * np.array([size[0], 0.0, size[1]])
        self._shadow.points = scaled + np.array([centre[0], 0.0, centre[2]])

    def _aim(self, t: int) -> None:
        x, z = self._centre(t)
        target = np.array([x, self._frame_size / (2 * _MARGIN), z])
        turn = self._view.turntable * t / max(self._trajectory.frame_count - 1, 1)
        azimuth = self._heading() + np.deg2rad(self._view.azimuth + turn)
        elevation = np.deg2rad(self._view.elevation)
        direction = np.array(
            [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
        )
        distance = self._frame_size / (2 * np.tan(np.deg2rad(_FIELD_OF_VIEW / 2)))
        camera = self._plotter.camera
        camera.focal_point = target
        camera.position = target + distance * direction
        camera.up = (0, 1, 0)
        camera.view_angle = _FIELD_OF_VIEW
        self._plotter.renderer.ResetCameraClippingRange()

    def close(self) -> None:
        """Free the window."""
        self._plotter.close()


def _lighter(colour: tuple[float, float, float]) -> tuple[float, float, float]:
    """The colour that the background turns to at the top."""
    r, g, b = (0.15 * part + 0.85 * min(1.0, part + 0.08) for part in colour)
    return r, g, b


def _move(mesh: pyvista.PolyData, points: np.ndarray, faces: np.ndarray) -> None:
    finite = np.nan_to_num(np.array(points, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    mesh.points = finite
    mesh.point_data["Normals"] = vertex_normals(torch.from_numpy(finite), torch.from_numpy(np.array(faces))).numpy()


def render(trajectory: Trajectory, frames: Sequence[int], view: View | None = None) -> Iterator[np.ndarray]:
    """Pictures of the given frames, one after the other, each (height, width, 3) uint8 sRGB [0 to 255].

    Args:
        trajectory: what is drawn.
        frames: numbers of the frames.
        view: camera, size and colours.

    Raises:
        Pb4uError: this machine has no off-screen OpenGL.
    """
    renderer = _open_renderer(trajectory, view or View())
    try:
        for t in frames:
            yield renderer.draw(t)
    finally:
        renderer.close()


def _open_renderer(trajectory: Trajectory, view: View) -> StillRenderer:
    try:
        from vtkmodules.vtkCommonCore import vtkLogger

        # Without a display VTK tries X first and logs its failure before it falls back to off-screen drawing.
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
        return StillRenderer(trajectory, view)
    except (ImportError, RuntimeError, OSError) as error:
        raise Pb4uError(
            f"Pictures need off-screen OpenGL, which this machine lacks ({error}); on Debian or Ubuntu install libegl1 "
            "and libgl1-mesa-dri. The trajectory itself does not need it."
        ) from error


def write_still(
    trajectory: Trajectory, path: Path, progress: Progress = unheard, view: View | None = None, frames: int = 5
) -> None:
    """Write a PNG or JPEG strip.

    Args:
        trajectory: what is drawn.
        path: file to write; its suffix decides the format.
        progress: told of the moments drawn.
        view: camera, size and colours.
        frames: moments side by side, spread evenly over the clip.
    """
    from PIL import Image

    moments = np.unique(np.linspace(0, trajectory.frame_count - 1, frames).round().astype(int)).tolist()
    strip = np.concatenate(list(_counted(render(trajectory, moments, view), len(moments), progress)), axis=1)
    Image.fromarray(strip).save(path)


def write_gif(
    trajectory: Trajectory,
    path: Path,
    progress: Progress = unheard,
    view: View | None = None,
    highest_fps: float = 15.0,
) -> None:
    """Write an endlessly looping GIF.

    Args:
        trajectory: what is drawn.
        path: file to write.
        progress: told of the frames drawn.
        view: camera, size and colours.
        highest_fps: frames are dropped so that it plays in real time at no more than this; more make files large.
    """
    _require_playable(trajectory.fps)
    stride = max(1, round(trajectory.fps / highest_fps))
    moments = range(0, trajectory.frame_count, stride)
    pictures = _counted(render(trajectory, moments, view), len(moments), progress)
    save_gif(pictures, path, trajectory.fps / stride, highest_fps)


def _require_playable(fps: float) -> None:
    """Refuse a film of a rate that encoders do not hold, before it is drawn."""
    if fps < _SLOWEST:
        raise InputError(f"A film has {_SLOWEST:g} frames per second or more, not {fps:g}; write an .npz.")


def save_gif(pictures: Iterable[np.ndarray], path: Path, fps: float, highest_fps: float = 15.0) -> None:
    """Write pictures as an endlessly looping GIF.

    Args:
        pictures: (height, width, 3) uint8 sRGB each, one or more.
        path: file to write.
        fps: of the pictures [1/s].
        highest_fps: pictures are dropped so that it plays in real time at no more than this; more make files large.
    """
    from PIL import Image

    stride = max(1, round(fps / highest_fps))
    kept = [
        Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE)
        for picture in islice(pictures, 0, None, stride)
    ]
    duration = round(1000 * stride / fps)
    kept[0].save(path, save_all=True, append_images=kept[1:], duration=duration, loop=0)


def write_mp4(trajectory: Trajectory, path: Path, progress: Progress = unheard, view: View | None = None) -> None:
    """Write an MP4 at the trajectory's own frame rate: H.264 where an ffmpeg with an encoder for it is found, or VP9.

    Args:
        trajectory: what is drawn.
        path: file to write.
        progress: told of the frames drawn.
        view: camera, size and colours.

    Raises:
        MissingExtraError: there is neither such an encoder nor the "render" extra.
        Pb4uError: the encoder cannot write the file.
    """
    _require_playable(trajectory.fps)
    view = view or View()
    frames = trajectory.frame_count
    save_mp4(_counted(render(trajectory, range(frames), view), frames, progress), path, trajectory.fps, view)


def save_mp4(pictures: Iterable[np.ndarray], path: Path, fps: float, view: View) -> None:
    """Write pictures as an MP4: H.264 by an ffmpeg that the user has, else VP9.

    Args:
        pictures: (height, width, 3) uint8 sRGB each.
        path: file to write.
        fps: of the pictures [1/s].
        view: their size.

    Raises:
        MissingExtraError: there is neither such an encoder nor the "render" extra.
        Pb4uError: the encoder cannot write the file.
    """
    size = view.width, view.height
    writer: VideoWriter = H264Writer.opened(path, fps, size) or Vp9Writer(path, fps, size)
    with writer:
        for picture in pictures:
            writer.write(picture)


def _counted(pictures: Iterator[np.ndarray], total: int, progress: Progress) -> Iterator[np.ndarray]:
    for done, picture in enumerate(pictures, start=1):
        yield picture
        progress(done, total)
