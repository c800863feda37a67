"""Off-screen rendering of a trajectory: PNG and JPEG stills, GIF and MP4."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from pb4u.errors import InputError, Pb4uError
from pb4u.export.finite_frames import held_frames
from pb4u.export.sewing_lines import ABOVE, SewingLines, sewn_parts
from pb4u.export.shading import SKIN, ClothPart
from pb4u.export.video_writer import open_video
from pb4u.export.view import View
from pb4u.geometry.triangle_mesh import vertex_normals
from pb4u.progress import Progress, no_progress
from pb4u.scene.author_mesh import split_seams
from pb4u.scene.trajectory import Trajectory

if TYPE_CHECKING:
    import pyvista


_MARGIN = 1.06
"""Of the distance at which the figure touches the picture's edge."""

_REACH, _TOP = 3.0, 6.0
"""What lies farther aside, or higher [m], may be cut off: a garment that flew away would make the figure a dot."""

_FOOT_HEIGHT = 0.12
"""Of an adult's foot, ankle included [m]: what lies that low shades the ground."""

_FIELD_OF_VIEW = 24.0
"""Of the picture's height [deg]: a long lens, which draws near limbs little larger."""

_NEAREST = 0.5
"""Distance of the camera [m] from a figure of no size."""

_GIF_FPS = 15.0
"""Frames per second of a GIF at most; those beyond are left out, since more make files large."""

_SLOWEST = 0.002
"""Frames per second of a film at least: a GIF shows one for 655 s at most, and VP9 for 1000."""


class StillRenderer:
    """Renderer of single frames: a lit scene with garment and body, whose positions are replaced frame by frame.

    Args:
        trajectory: what is drawn.
        view: camera, size and colours.
        frames: numbers of the frames that will be drawn; the camera stands so that the figure is whole in each.
    """

    def __init__(self, trajectory: Trajectory, view: View, frames: Sequence[int]) -> None:
        import pyvista

        self._trajectory = trajectory
        self._view = view
        self._plotter = pyvista.Plotter(off_screen=True, window_size=[view.width, view.height], lighting="none")
        parts, lines = sewn_parts(trajectory.header, view.cloths)
        self._cloth = self._add_cloth(trajectory, parts)
        self._held = frozenset(held_frames(trajectory))
        self._body = None
        faces = trajectory.header.body_faces
        if view.show_body and len(faces):
            self._body = self._add(trajectory.body_positions[0], faces, np.tile(SKIN, (len(faces), 1)), specular=0.12)
        self._light()
        self._add_ground()
        self._middle = self._middle_height(frames)
        self._distance = max((self._needed_distance(t) for t in frames), default=0.0) * _MARGIN
        self._lines = [self._add_lines(lines.at(lines.width == width), parts) for width in np.unique(lines.width)]

    def _add_cloth(self, trajectory: Trajectory, parts: list[ClothPart]) -> list[tuple[pyvista.PolyData, np.ndarray]]:
        """Surfaces of the garments, each with the vertex behind each of its points: one of plain colours, one an image.

        Vertices at UV seams are copied for an image.
        """
        header, first = trajectory.header, trajectory.positions[0]
        plain = [part for part in parts if part.image is None or header.uvs is None]
        added = []
        if plain:
            rows = np.sort(np.concatenate([part.faces for part in plain]))
            colours = np.empty((len(header.faces), 3))
            for part in plain:
                colours[part.faces] = part.colour
            whole = np.arange(len(first))
            added.append((self._add(first, header.faces[rows], colours[rows], specular=0.06), whole))
        of_vertex, corners, uvs = split_seams(len(first), header.faces, header.uvs, header.uv_faces)
        for part in parts:
            if part.image is not None and uvs is not None:
                colours = np.tile(part.colour, (len(part.faces), 1))
                drawn = self._add(first[of_vertex], corners[part.faces], colours, 0.06, (part.image, uvs))
                added.append((drawn, of_vertex))
        return added

    def _add(
        self,
        points: np.ndarray,
        faces: np.ndarray,
        colours: np.ndarray,
        specular: float,
        texture: tuple[bytes, np.ndarray] | None = None,
    ) -> pyvista.PolyData:
        """A surface in the picture; `colours` (faces, 3) sRGB [0 to 1], or those times an image by UVs (points, 2)."""
        import pyvista

        cells = np.column_stack([np.full(len(faces), 3), faces]).ravel()
        mesh = pyvista.PolyData(np.array(points, dtype=np.float32), cells)
        mesh.cell_data["colours"] = (255 * colours).round().astype(np.uint8)
        mesh.point_data["Normals"] = np.zeros_like(mesh.points)
        mesh.point_data.active_normals_name = "Normals"
        shown: dict[str, Any] = {"scalars": "colours", "rgb": True}
        if texture is not None:
            mesh.active_texture_coordinates = texture[1]
            shown = {"texture": _texture(texture[0], colours[0])}
        self._plotter.add_mesh(
            mesh, **shown, ambient=0.16, diffuse=0.9, specular=specular, specular_power=12, interpolation="Phong"
        )
        return mesh

    def _add_lines(self, lines: SewingLines, parts: list[ClothPart]) -> tuple[pyvista.PolyData, SewingLines]:
        """Lines of one width on the cloth."""
        import pyvista

        count = len(lines.face)
        cells = np.column_stack([np.full(count, 2), np.arange(2 * count).reshape(-1, 2)]).ravel()
        mesh = pyvista.PolyData(np.zeros((2 * count, 3), dtype=np.float32), lines=cells)
        mesh.cell_data["colours"] = lines.colours(parts)
        pixels = self._view.height / (2.0 * self._distance * np.tan(np.deg2rad(_FIELD_OF_VIEW / 2)))
        width = max(lines.width[0] * pixels, 1.0)
        mesh.point_data["Normals"] = np.zeros_like(mesh.points)
        mesh.point_data.active_normals_name = "Normals"
        self._plotter.add_mesh(
            mesh, scalars="colours", rgb=True, line_width=width, ambient=0.16, diffuse=0.9, specular=0.06,
            interpolation="Phong",
        )  # fmt: skip
        return mesh, lines

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
        self._plotter.renderer.set_background(self._view.background)

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

    def _visible(self, t: int) -> np.ndarray:
        """Points (vertices, 3) [m] that the picture of frame t should hold, as seen from its `_foot`."""
        points = np.concatenate([self._trajectory.positions[t], self._trajectory.body_positions[t]])
        points = points[np.isfinite(points).all(axis=1)] - self._foot(t)
        near = (np.linalg.norm(points[:, [0, 2]], axis=1) < _REACH) & (points[:, 1] < _TOP)
        return np.asarray(points[near])

    def _wearer(self, t: int) -> np.ndarray:
        """Points (vertices, 3) [m] of the body, or of the cloth where there is none."""
        body = self._trajectory.body_positions[t]
        points = body if len(body) else self._trajectory.positions[t]
        points = points[np.isfinite(points).all(axis=1)]
        return np.asarray(points) if len(points) else np.zeros((1, 3))

    def _foot(self, t: int) -> np.ndarray:
        """(3,) point of the ground [m] below the middle of the figure."""
        x, _, z = np.median(self._wearer(t), axis=0)
        return np.array([x, 0.0, z])

    def _middle_height(self, frames: Sequence[int]) -> float:
        """Height [m] at which the camera looks: halfway from the ground to the highest point of all frames."""
        return 0.5 * max((float(self._visible(t)[:, 1].max(initial=0.0)) for t in frames), default=0.0)

    def _needed_distance(self, t: int) -> float:
        """Distance of the camera [m] from which all of frame t lies within the picture."""
        points = self._visible(t) - np.array([0.0, self._middle, 0.0])
        aside, upward, towards = (points @ axis for axis in self._axes(t))
        spread = np.maximum(np.abs(upward), np.abs(aside) * self._view.height / self._view.width)
        return float((towards + spread / np.tan(np.deg2rad(_FIELD_OF_VIEW / 2))).max(initial=_NEAREST))

    def _axes(self, t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit vectors (3,) of the picture of frame t: to its right, to its top, and towards the camera."""
        turn = self._view.turntable * t / max(self._trajectory.frame_count - 1, 1)
        azimuth = self._heading() + np.deg2rad(self._view.azimuth + turn)
        elevation = np.deg2rad(self._view.elevation)
        level = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
        up = np.array([0.0, 1.0, 0.0])
        return (
            np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)]),
            np.cos(elevation) * up - np.sin(elevation) * level,
            np.cos(elevation) * level + np.sin(elevation) * up,
        )

    def _heading(self) -> float:
        """Angle about the vertical [rad] of the direction the body faces at the start; 0 is +Z."""
        return float(self._trajectory.metadata.get("heading", 0.0))

    def draw(self, t: int) -> np.ndarray:
        """Picture of frame t, (height, width, 3) uint8 sRGB [0 to 255].

        Args:
            t: number of the frame.

        Raises:
            Pb4uError: the renderer returns no picture.
        """
        trajectory = self._trajectory
        normals = _normals(trajectory.positions[t], trajectory.faces)
        for mesh, of_vertex in self._cloth:
            _move(mesh, trajectory.positions[t][of_vertex], normals[of_vertex])
        for mesh, lines in self._lines:
            on_lines = lines.of(normals)
            _move(mesh, lines.of(_finite(trajectory.positions[t])) + ABOVE * on_lines, on_lines)
        if self._body is not None:
            points = trajectory.body_positions[t]
            _move(self._body, points, _normals(points, trajectory.header.body_faces))
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
        points = self._wearer(t)
        low = points[points[:, 1] < points[:, 1].min() + _FOOT_HEIGHT]
        size = np.maximum(np.ptp(low[:, [0, 2]], axis=0), 0.25) * 0.9
        centre = (low.max(axis=0) + low.min(axis=0)) / 2
        scaled = self._shadow_shape * np.array([size[0], 0.0, size[1]])
        self._shadow.points = scaled + np.array([centre[0], 0.0, centre[2]])

    def _aim(self, t: int) -> None:
        target = self._foot(t) + np.array([0.0, self._middle, 0.0])
        _, upward, towards = self._axes(t)
        camera = self._plotter.camera
        camera.focal_point = target
        camera.position = target + self._distance * towards
        camera.up = upward
        camera.view_angle = _FIELD_OF_VIEW
        self._plotter.renderer.ResetCameraClippingRange()

    def close(self) -> None:
        """Free the window."""
        self._plotter.close()


def _move(mesh: pyvista.PolyData, points: np.ndarray, normals: np.ndarray) -> None:
    mesh.points = _finite(points)
    mesh.point_data["Normals"] = normals


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return vertex_normals(torch.from_numpy(_finite(points)), torch.from_numpy(np.array(faces))).numpy()


def _finite(points: np.ndarray) -> np.ndarray:
    return np.nan_to_num(np.array(points, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def _texture(image: bytes, colour: np.ndarray) -> pyvista.Texture:
    """An image times an sRGB colour [0 to 1]."""
    import pyvista
    from PIL import Image

    with Image.open(io.BytesIO(image)) as opened:
        pixels = (np.asarray(opened.convert("RGB")) * colour).round().astype(np.uint8)
    texture: pyvista.Texture = pyvista.Texture(pixels)  # type: ignore[no-untyped-call]
    texture.repeat, texture.interpolate, texture.mipmap = True, True, True
    return texture


def render(trajectory: Trajectory, frames: Sequence[int], view: View | None = None) -> Iterator[np.ndarray]:
    """Pictures of the given frames, one after the other, each (height, width, 3) uint8 sRGB [0 to 255].

    Args:
        trajectory: what is drawn.
        frames: numbers of the frames.
        view: camera, size and colours.

    Raises:
        Pb4uError: this machine has no off-screen OpenGL.
    """
    renderer = _open_renderer(trajectory, view or View(), frames)
    try:
        for t in frames:
            yield renderer.draw(t)
    finally:
        renderer.close()


def _open_renderer(trajectory: Trajectory, view: View, frames: Sequence[int]) -> StillRenderer:
    try:
        from vtkmodules.vtkCommonCore import vtkLogger

        # Without a display VTK tries X first and logs its failure before it falls back to off-screen drawing.
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
        return StillRenderer(trajectory, view, frames)
    except (ImportError, RuntimeError, OSError) as error:
        raise Pb4uError(
            f"Pictures need off-screen OpenGL, which this machine lacks ({error}); on Debian or Ubuntu install libegl1 "
            "and libgl1-mesa-dri. The trajectory itself does not need it."
        ) from error


def write_still(
    trajectory: Trajectory, path: Path, progress: Progress = no_progress, view: View | None = None, frames: int = 5
) -> None:
    """Write a PNG or JPEG strip.

    Args:
        trajectory: what is drawn.
        path: file to write; its suffix decides the format.
        progress: called with the moments drawn.
        view: camera, size and colours.
        frames: moments side by side, spread evenly over the clip.
    """
    from PIL import Image

    moments = np.unique(np.linspace(0, trajectory.frame_count - 1, frames).round().astype(int)).tolist()
    strip = np.concatenate(list(_counted(render(trajectory, moments, view), len(moments), progress)), axis=1)
    # Through memory: Pillow writes a JPEG past a full disk without a word.
    encoded = io.BytesIO()
    Image.fromarray(strip).save(encoded, Image.registered_extensions()[path.suffix.lower()])
    path.write_bytes(encoded.getvalue())


def write_gif(
    trajectory: Trajectory,
    path: Path,
    progress: Progress = no_progress,
    view: View | None = None,
) -> None:
    """Write an endlessly looping GIF.

    Args:
        trajectory: what is drawn.
        path: file to write.
        progress: called with the frames drawn.
        view: camera, size and colours.
    """
    _require_playable(trajectory.fps)
    stride = max(1, round(trajectory.fps / _GIF_FPS))
    moments = range(0, trajectory.frame_count, stride)
    pictures = _counted(render(trajectory, moments, view), len(moments), progress)
    save_gif(pictures, path, trajectory.fps / stride)


def _require_playable(fps: float) -> None:
    """Refuse a film of a rate that encoders do not hold, before it is drawn."""
    if fps < _SLOWEST:
        raise InputError(f"A film has {_SLOWEST:g} frames per second or more, not {fps:g}; write an .npz.")


def save_gif(pictures: Iterable[np.ndarray], path: Path, fps: float) -> None:
    """Write pictures as an endlessly looping GIF.

    Args:
        pictures: (height, width, 3) uint8 sRGB each, one or more.
        path: file to write.
        fps: of the pictures [1/s].
    """
    from PIL import Image

    stride = max(1, round(fps / _GIF_FPS))
    kept = [
        Image.fromarray(picture).quantize(128, dither=Image.Dither.NONE)
        for picture in islice(pictures, 0, None, stride)
    ]
    duration = round(1000 * stride / fps)
    kept[0].save(path, save_all=True, append_images=kept[1:], duration=duration, loop=0)


def write_mp4(trajectory: Trajectory, path: Path, progress: Progress = no_progress, view: View | None = None) -> str:
    """Write an MP4 at the trajectory's own frame rate: H.264 where an encoder of this machine makes it, or VP9.

    Args:
        trajectory: what is drawn.
        path: file to write.
        progress: called with the frames drawn.
        view: camera, size and colours.

    Returns:
        The codec, as a predicate without its subject.

    Raises:
        MissingExtraError: there is neither such an encoder nor the "render" extra.
        Pb4uError: the encoder cannot write the file.
    """
    _require_playable(trajectory.fps)
    view = view or View()
    frames = trajectory.frame_count
    pictures = _counted(render(trajectory, range(frames), view), frames, progress)
    return save_mp4(pictures, path, trajectory.fps, (view.width, view.height))


def save_mp4(pictures: Iterable[np.ndarray], path: Path, fps: float, size: tuple[int, int]) -> str:
    """Write pictures as an MP4: H.264 where an encoder of this machine makes it, or VP9.

    Args:
        pictures: (height, width, 3) uint8 sRGB each.
        path: file to write.
        fps: of the pictures [1/s].
        size: width and height of the pictures [pixels], both even.

    Returns:
        The codec, as a predicate without its subject.

    Raises:
        MissingExtraError: there is neither such an encoder nor the "render" extra.
        Pb4uError: the encoder cannot write the file.
    """
    with open_video(path, fps, size) as writer:
        for picture in pictures:
            writer.write(picture)
    return f"is in {writer.codec}."


def _counted(pictures: Iterator[np.ndarray], total: int, progress: Progress) -> Iterator[np.ndarray]:
    for done, picture in enumerate(pictures, start=1):
        yield picture
        progress(done, total)
