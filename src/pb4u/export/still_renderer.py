"""Off-screen rendering of single frames of a trajectory."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pb4u.errors import Pb4uError
from pb4u.export.buttons import Buttons, buttons_on
from pb4u.export.camera import FIELD_OF_VIEW, Camera
from pb4u.export.drawn_cloth import DrawnCloth
from pb4u.export.finite_frames import held_frames
from pb4u.export.offscreen import choose_opengl
from pb4u.export.sewing_lines import ABOVE, SewingLines, sewn_parts
from pb4u.export.shading import LIGHTS, SKIN, ClothPart, Colour
from pb4u.export.threads import SIDE, THREADS, thread_image, uvs_in_metres
from pb4u.export.view import View
from pb4u.geometry.triangle_mesh import area_weighted_normals
from pb4u.scene.author_mesh import split_seams
from pb4u.scene.trajectory import Trajectory

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLFXAAPass

_FOOT_HEIGHT = 0.12
"""Of an adult's foot, ankle included [m]: what lies that low shades the ground."""

_MATT: dict[str, Any] = {"ambient": 0.20, "diffuse": 0.92, "interpolation": "Phong"}
_BUTTON_GLOSS = 0.3
_SHARPNESS = 10.0
"""Exponent of what shines."""

_HOLLOW, _LEAST_HOLLOW, _RAYS = 0.12, 0.004, 24
"""How far off cloth or skin keeps light of all around from a point, and from which height on [m]; how often asked."""
_UNDER = 1.5e-3
"""Depth [m] by which skin is drawn under itself: smoothed cloth dips into what the simulated cloth lies on."""


class StillRenderer:
    """Renderer of single frames: a lit scene with garment and body, whose positions are replaced frame by frame.

    Args:
        trajectory: to draw.
        view: camera, size and colours.
        frames: numbers of the frames that will be drawn; the camera is placed so that each shows the whole figure.
    """

    def __init__(self, trajectory: Trajectory, view: View, frames: Sequence[int]) -> None:
        import pyvista

        self._trajectory = trajectory
        self._view, self._camera = view, Camera(trajectory, view, frames)
        self._plotter = pyvista.Plotter(off_screen=True, window_size=[view.width, view.height], lighting="none")
        self._plotter.disable_anti_aliasing()
        parts, lines = sewn_parts(trajectory.header, view.cloths)
        self._drawn = DrawnCloth(trajectory.header)
        self._cloth = self._add_cloth(parts)
        self._held = frozenset(held_frames(trajectory))
        self._body = None
        faces = trajectory.header.body_faces
        if view.show_body and len(faces):
            self._body = self._add(trajectory.body_positions[0], faces, SKIN, 0.10)
        self._light()
        self._add_ground()
        lines = self._drawn.lines(lines)
        self._buttons = [self._add_buttons(buttons) for buttons in buttons_on(trajectory.header, parts)]
        self._lines = [self._add_lines(lines.at(lines.width == width), parts) for width in np.unique(lines.width)]

    def _add_cloth(self, parts: list[ClothPart]) -> list[tuple[pyvista.PolyData, np.ndarray]]:
        """Surfaces of the parts of the garments, each with the drawn vertex behind each of its points.

        Vertices at UV seams are copied.
        """
        header, drawn = self._trajectory.header, self._drawn
        first = drawn.at(_finite(self._trajectory.positions[0]))
        of_vertex, corners, uvs = split_seams(len(first), drawn.faces, drawn.uvs(header.uvs), drawn.uv_faces)
        metres = split_seams(len(first), drawn.faces, drawn.uvs(uvs_in_metres(header)), drawn.uv_faces)[2]
        added = []
        for part in parts:
            points, corner = np.unique(corners[np.isin(drawn.parent, part.faces)], return_inverse=True)
            colour, images = part.colour, []
            if part.image is not None and uvs is not None:
                images.append((_pixels(part.image), uvs[points]))
            threads = THREADS.get(part.fabric.threads)
            plain = part.image is None or header.appearances is None
            if self._view.weave and plain and threads and metres is not None and np.ptp(metres[points]) > 0.0:
                images.append((thread_image(threads, colour), metres[points] / SIDE))
                colour = (1.0, 1.0, 1.0)
            mesh = self._add(first[of_vertex[points]], corner.reshape(-1, 3), colour, part.fabric.gloss, images)
            added.append((mesh, of_vertex[points]))
        return added

    def _add(
        self,
        points: np.ndarray,
        faces: np.ndarray,
        colour: Colour,
        gloss: float,
        images: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    ) -> pyvista.PolyData:
        """A surface in the picture.

        Args:
            points: (points, 3) [m].
            faces: (faces, 3) int.
            colour: sRGB [0 to 1].
            gloss: share of the light that it mirrors.
            images: (height, width, 3) uint8 and the UVs (points, 2) that lay it on, each multiplies the colour.
        """
        import pyvista
        from vtkmodules.vtkCommonDataModel import vtkDataObject
        from vtkmodules.vtkRenderingCore import vtkPolyDataMapper

        cells = np.column_stack([np.full(len(faces), 3), faces]).ravel()
        mesh = pyvista.PolyData(np.array(points, dtype=np.float32), cells)
        mesh.point_data["Normals"] = np.zeros_like(mesh.points)
        mesh.point_data.active_normals_name = "Normals"
        for k, (_, uvs) in enumerate(images):
            mesh.point_data[f"uvs{k}"] = uvs.astype(np.float32)
        actor = self._plotter.add_mesh(mesh, color=colour, specular=gloss, specular_power=_SHARPNESS, **_MATT)
        if images:
            # Of two textures, only this mapper takes each with UVs of its own.
            mapper = vtkPolyDataMapper()
            mapper.SetInputData(mesh)
            mapper.ScalarVisibilityOff()
            actor.SetMapper(mapper)
            for k, (pixels, _) in enumerate(images):
                actor.GetProperty().SetTexture(f"image{k}", _texture(pixels))
                mapper.MapDataArrayToMultiTextureAttribute(
                    f"image{k}", f"uvs{k}", vtkDataObject.FIELD_ASSOCIATION_POINTS, -1
                )
        return mesh

    def _add_lines(self, lines: SewingLines, parts: list[ClothPart]) -> tuple[pyvista.PolyData, SewingLines]:
        """Lines of one width on the cloth."""
        import pyvista

        count = len(lines.face)
        cells = np.column_stack([np.full(count, 2), np.arange(2 * count).reshape(-1, 2)]).ravel()
        mesh = pyvista.PolyData(np.zeros((2 * count, 3), dtype=np.float32), lines=cells)
        mesh.cell_data["colours"] = lines.colours(parts, self._drawn.parent)
        pixels = self._view.height / (2.0 * self._camera.distance * np.tan(np.deg2rad(FIELD_OF_VIEW / 2)))
        width = max(lines.width[0] * pixels, 1.0)
        mesh.point_data["Normals"] = np.zeros_like(mesh.points)
        mesh.point_data.active_normals_name = "Normals"
        self._plotter.add_mesh(mesh, scalars="colours", rgb=True, line_width=width, **_MATT)
        return mesh, lines

    def _add_buttons(self, buttons: Buttons) -> tuple[pyvista.PolyData, Buttons]:
        """Buttons of one colour, on cloth that lies anywhere."""
        nowhere = np.zeros((len(self._trajectory.header.rest_positions), 3))
        return self._add(buttons.at(nowhere, nowhere)[0], buttons.faces, buttons.colour, _BUTTON_GLOSS), buttons

    def _light(self) -> None:
        import pyvista

        turn = self._camera.heading() + np.deg2rad(self._view.azimuth - View.azimuth)
        for (x, y, z), intensity in LIGHTS:
            position = x * np.cos(turn) + z * np.sin(turn), y, z * np.cos(turn) - x * np.sin(turn)
            light = pyvista.Light(
                position=position, focal_point=(0, 1, 0), intensity=intensity, light_type="scene light"
            )
            self._plotter.add_light(light)
        self._plotter.renderer.set_background(self._view.background)
        self._plotter.renderer.SetPass(_shaded_hollows())

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

    def draw(self, t: int) -> np.ndarray:
        """Picture of frame t, (height, width, 3) uint8 sRGB [0 to 255].

        Args:
            t: number of the frame.

        Raises:
            Pb4uError: the renderer returns no picture.
        """
        trajectory = self._trajectory
        cloth = self._drawn.at(_finite(trajectory.positions[t]))
        normals = _normals(cloth, self._drawn.faces)
        for mesh, of_vertex in self._cloth:
            _move(mesh, cloth[of_vertex], normals[of_vertex])
        for mesh, lines in self._lines:
            on_lines = lines.of(normals)
            _move(mesh, lines.of(cloth) + ABOVE * on_lines, on_lines)
        for mesh, buttons in self._buttons:
            _move(mesh, *buttons.at(cloth, normals))
        if self._body is not None:
            points = trajectory.body_positions[t]
            outward = _normals(points, trajectory.header.body_faces)
            _move(self._body, points - _UNDER * outward, outward)
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
        points = self._camera.wearer(t)
        low = points[points[:, 1] < points[:, 1].min() + _FOOT_HEIGHT]
        size = np.maximum(np.ptp(low[:, [0, 2]], axis=0), 0.25) * 0.9
        centre = (low.max(axis=0) + low.min(axis=0)) / 2
        scaled = self._shadow_shape * np.array([size[0], 0.0, size[1]])
        self._shadow.points = scaled + np.array([centre[0], 0.0, centre[2]])

    def _aim(self, t: int) -> None:
        target = self._camera.target(t)
        _, upward, towards = self._camera.axes(t)
        camera = self._plotter.camera
        camera.focal_point = target
        camera.position = target + self._camera.distance * towards
        camera.up = upward
        camera.view_angle = FIELD_OF_VIEW
        self._plotter.renderer.ResetCameraClippingRange()

    def close(self) -> None:
        """Free the window."""
        self._plotter.close()


def _shaded_hollows() -> vtkOpenGLFXAAPass:
    """Drawing in which hollows get less light of all around, with smooth edges.

    The multisampling that VTK smooths edges with otherwise does not reach what it draws for this.
    """
    from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLFXAAPass, vtkRenderStepsPass, vtkSSAOPass

    hollows, smooth = vtkSSAOPass(), vtkOpenGLFXAAPass()
    hollows.SetDelegatePass(vtkRenderStepsPass())
    hollows.SetRadius(_HOLLOW)
    hollows.SetBias(_LEAST_HOLLOW)
    hollows.SetKernelSize(_RAYS)
    hollows.BlurOn()
    smooth.SetDelegatePass(hollows)
    return smooth


def _move(mesh: pyvista.PolyData, points: np.ndarray, normals: np.ndarray) -> None:
    mesh.points = _finite(points)
    mesh.point_data["Normals"] = normals


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return area_weighted_normals(_finite(points), faces).astype(np.float32)


def _finite(points: np.ndarray) -> np.ndarray:
    return np.nan_to_num(np.array(points, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def _pixels(image: bytes) -> np.ndarray:
    from PIL import Image

    with Image.open(io.BytesIO(image)) as opened:
        return np.asarray(opened.convert("RGB"))


def _texture(pixels: np.ndarray) -> pyvista.Texture:
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkTexture

    texture: pyvista.Texture = pyvista.Texture(pixels)  # type: ignore[no-untyped-call]
    texture.repeat, texture.interpolate, texture.mipmap = True, True, True
    texture.SetBlendingMode(vtkTexture.VTK_TEXTURE_BLENDING_MODE_MODULATE)
    return texture


def render(trajectory: Trajectory, frames: Sequence[int], view: View | None = None) -> Iterator[np.ndarray]:
    """Pictures of the given frames, one after the other, each (height, width, 3) uint8 sRGB [0 to 255].

    Args:
        trajectory: to draw.
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
    choose_opengl()
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
