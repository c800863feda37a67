"""The scene of one page: light, ground, figures side by side and the camera; and whether the browser keeps up."""

from __future__ import annotations

import contextlib
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from pb4u.viewer.clip import Clip
from pb4u.viewer.figure import Figure, ground_position
from pb4u.viewer.overlay import Overlay
from pb4u.viewer.view_state import ViewState

if TYPE_CHECKING:
    from viser import ClientHandle, SceneApi

_CELL = 0.5
"""Of the grid on the ground [m]: about half a step of a walk, so that speed can be read from it."""

_FIELD_OF_VIEW = np.deg2rad(30.0)
"""Of a portrait lens: a wider one would draw near limbs too large."""

_AZIMUTH, _ELEVATION = np.deg2rad(25.0), np.deg2rad(8.0)
"""From where one clip is seen: front and side at once, from the height of the chest."""

_GAP = 0.25
"""Between bodies that stand side by side [m]: room for a skirt that swings out."""

_IN_FLIGHT = 2
"""Frames that may be under way: one is drawn while the next one travels."""

_PATIENCE = 5.0
"""Seconds after which a frame counts as lost, so that a browser that never answers is sent another."""


def light(scene: SceneApi) -> None:
    """What all windows share: sky, fill and rim light, so that what the key light leaves dark stays readable."""
    scene.set_up_direction("+y")
    scene.world_axes.visible = False
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(190, 180, 170), intensity=1.5)
    for name, direction, intensity in (("fill", (-5.0, 3.0, 3.0), 0.9), ("rim", (0.0, 5.0, -6.0), 1.3)):
        scene.add_light_directional(f"/light/{name}", intensity=intensity, position=direction)


class Display:
    """What one page draws, sent no faster than its browser takes it in. One thread alone works with it.

    Args:
        client: the window.
    """

    def __init__(self, client: ClientHandle) -> None:
        self._client = client
        self.figures: tuple[Figure, ...] = ()
        self._set = 0
        # Low and from the side, so that wrinkles show.
        self._key = client.scene.add_light_directional("/light/key", intensity=2.9, position=(4.0, 4.5, 5.0))
        self._ground = client.scene.add_grid(
            "/ground", plane="xz", infinite_grid=True, cell_size=_CELL, section_size=2 * _CELL, cell_thickness=0.6,
            section_thickness=0.9, cell_color=(214, 216, 220), section_color=(196, 199, 204), fade_distance=14.0,
            fade_strength=1.5, shadow_opacity=0.25, plane_color=(240, 241, 243), plane_opacity=1.0,
        )  # fmt: skip
        self._questions = ThreadPoolExecutor(_IN_FLIGHT, thread_name_prefix="pb4u browser")
        self._asked: list[Future[None]] = []

    @property
    def clips(self) -> tuple[Clip, ...]:
        """What stands there."""
        return tuple(figure.clip for figure in self.figures)

    def set_up(self, clips: tuple[Clip, ...]) -> None:
        """Replace all figures; their garments are shaded until they are painted."""
        for figure in self.figures:
            figure.remove()
        self._set += 1
        self.figures = tuple(
            Figure(self._client.scene, f"/set{self._set}/figure{n}", clip, place)
            for n, (clip, place) in enumerate(zip(clips, places(clips), strict=True))
        )

    def paint(self, looks: tuple[Overlay, ...]) -> None:
        """Paint the garments another way from the next frame on; one overlay for each clip."""
        for figure, look in zip(self.figures, looks, strict=True):
            figure.look(look)

    def show(self, state: ViewState) -> None:
        """Send a frame of every figure; the ground slides below them where the view follows."""
        frames = [state.frame_of(clip, state.clock.frame) for clip in self.clips]
        with self._client.atomic():
            for figure, t in zip(self.figures, frames, strict=True):
                figure.show(t, state.body, state.follow)
            away = ground_position(self.clips[0].body(frames[0])) if state.follow else np.zeros(3)
            self._ground.position = tuple(-np.mod(away, 2 * _CELL))
        self._asked.append(self._questions.submit(self._wait_for_browser))

    @property
    def ready(self) -> bool:
        """Whether the browser has kept up, so that another frame may be sent."""
        self._asked = [future for future in self._asked if not future.done()]
        return len(self._asked) < _IN_FLIGHT

    def _wait_for_browser(self) -> None:
        """Ask after a frame; messages are handled in the order sent, so an answer says that it was taken in.

        What is asked for is an entry of the browser's local storage that nobody wrote; it is the library's one
        question that costs nothing.
        """
        # No answer: the window is gone, has no storage, or is out of sight and does not draw.
        with contextlib.suppress(RuntimeError, TimeoutError):
            self._client.local_storage.get_item("pb4u", timeout=_PATIENCE)

    @property
    def waits(self) -> bool:
        """Whether a frame that was sent is still out of sight."""
        return any(figure.waits for figure in self.figures)

    def reveal(self) -> None:
        """Bring it into sight."""
        with self._client.atomic():
            for figure in self.figures:
                figure.reveal()

    def cast_shadows(self, cast: bool) -> None:
        """Let the key light cast shadows; it draws everything four times, which a software renderer feels."""
        self._key.cast_shadow = cast

    def close(self) -> None:
        """Ask the browser no more."""
        self._questions.shutdown(wait=False, cancel_futures=True)

    def frame_camera(self, follow: bool) -> None:
        """Look at all garments from the front, a little to the side."""
        shown = tuple(clip for clip in self.clips if clip.frame_count)
        if not shown:
            return
        corners = []
        for clip, place in zip(shown, places(shown), strict=True):
            away = ground_position(clip.body(0)) if follow else np.zeros(3)
            points = np.concatenate([clip.garment(0), clip.body(0)]) - away + place
            corners += [points.min(axis=0), points.max(axis=0)]
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        camera = self._client.camera
        aspect = camera.aspect if camera.image_height else 1.5
        azimuth = _heading(shown[0]) + (_AZIMUTH if len(shown) == 1 else 0.0)
        across = float(np.abs(lateral(azimuth)) @ (high - low))
        size = max(high[1] - low[1], across / aspect) * 1.2
        distance = size / (2 * np.tan(_FIELD_OF_VIEW / 2)) + 0.3
        target = (low + high) / 2
        direction = np.array(
            [np.sin(azimuth) * np.cos(_ELEVATION), np.sin(_ELEVATION), np.cos(azimuth) * np.cos(_ELEVATION)]
        )
        with self._client.atomic():
            camera.fov = float(_FIELD_OF_VIEW)
            camera.up_direction = (0.0, 1.0, 0.0)
            camera.position = target + distance * direction
            camera.look_at = target


def places(clips: tuple[Clip, ...]) -> list[np.ndarray]:
    """(3,) [m] of each clip: side by side as seen from the front, the first on the viewer's left."""
    ready = [clip for clip in clips if clip.frame_count]
    if not ready:
        return [np.zeros(3)] * len(clips)
    heading = _heading(ready[0])
    side = lateral(heading)
    spacing = max(float(np.abs(side) @ np.ptp(clip.body(0), axis=0)) for clip in ready) + _GAP
    middle = (len(clips) - 1) / 2
    return [(n - middle) * spacing * side for n in range(len(clips))]


def lateral(azimuth: float) -> np.ndarray:
    """(3,) unit vector to the right of one who looks at the origin from `azimuth` [rad]."""
    return np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])


def _heading(clip: Clip) -> float:
    return float(clip.header.metadata.get("heading", 0.0))
