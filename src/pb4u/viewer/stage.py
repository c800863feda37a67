"""Where figures stand: light, ground, their places and the camera of one page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pb4u.viewer.clip import Clip
from pb4u.viewer.figure import Figure, ground_position

if TYPE_CHECKING:
    from viser import ClientHandle, SceneApi

_CELL = 0.5
_FIELD_OF_VIEW = np.deg2rad(30.0)
_AZIMUTH, _ELEVATION = np.deg2rad(25.0), np.deg2rad(8.0)
_GAP = 0.25


def light(scene: SceneApi) -> None:
    """What all windows share: sky, fill and rim light, so that what the key light leaves dark stays readable."""
    scene.set_up_direction("+y")
    scene.world_axes.visible = False
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(190, 180, 170), intensity=1.5)
    for name, direction, intensity in (("fill", (-5.0, 3.0, 3.0), 0.9), ("rim", (0.0, 5.0, -6.0), 1.3)):
        scene.add_light_directional(f"/light/{name}", intensity=intensity, position=direction)


class Stage:
    """The scene of one page."""

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

    def set_up(self, clips: tuple[Clip, ...]) -> None:
        """Replace all figures."""
        for figure in self.figures:
            figure.remove()
        self._set += 1
        self.figures = tuple(
            Figure(self._client.scene, f"/set{self._set}/figure{n}", clip, place)
            for n, (clip, place) in enumerate(zip(clips, places(clips), strict=True))
        )

    def show(self, frames: list[int], body: bool, follow: bool) -> None:
        """Send a frame of every figure; the ground slides below them where the view follows."""
        for figure, t in zip(self.figures, frames, strict=True):
            figure.show(t, body, follow)
        away = ground_position(self.figures[0].clip.body(frames[0])) if follow and self.figures else np.zeros(3)
        self._ground.position = tuple(-np.mod(away, 2 * _CELL))

    def cast_shadows(self, cast: bool) -> None:
        """Let the key light cast shadows; it draws everything four times, which a software renderer feels."""
        self._key.cast_shadow = cast

    @property
    def waits(self) -> bool:
        """Whether a frame that was sent is still out of sight."""
        return any(figure.waits for figure in self.figures)

    def reveal(self) -> None:
        """Bring it into sight."""
        for figure in self.figures:
            figure.reveal()

    def frame_camera(self, follow: bool) -> None:
        """Look at all garments from the front, a little to the side."""
        shown = [figure.clip for figure in self.figures if figure.clip.frame_count]
        if not shown:
            return
        corners = []
        for clip, place in zip(shown, places(tuple(shown)), strict=True):
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
