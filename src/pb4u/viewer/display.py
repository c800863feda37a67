"""The scene of one page: light, ground, figures side by side and the camera; and whether the browser keeps up."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from pb4u.export.shading import LIGHTS, SKIN
from pb4u.viewer.clip import Clip, middle
from pb4u.viewer.overlay import OVERLAYS, Overlay
from pb4u.viewer.surface import Dragged, GarmentsSurface, PaintedSurface, PlainSurface, Surface, coloured_glb
from pb4u.viewer.view_state import SHADED, ViewState

if TYPE_CHECKING:
    from viser import ClientHandle, SceneApi

_CELL = 0.5
"""Of the grid on the ground [m]: about half a step of a walk, so that speed can be read from it."""

_FIELD_OF_VIEW = np.deg2rad(30.0)
"""Of a portrait lens: a wider one would draw near limbs too large."""

_AZIMUTH, _ELEVATION = np.deg2rad(25.0), np.deg2rad(8.0)
"""From where one clip is seen: front and side at once, from the height of the chest."""

_MARGIN, _DEPTH = 1.2, 0.3
"""A tenth of the picture stays free on every side; half the depth of a body comes nearer than its middle [m]."""

_GAP = 0.25
"""Between bodies that stand side by side [m]: room for a skirt that swings out."""

_LAMP, _SKY = 2.6, 0.35
"""Intensity of a light that pictures have at 1, and of what comes from all around, in the browser's unit."""

_IN_FLIGHT = 2
"""Frames that may be under way: one is drawn while the next one travels."""

_PATIENCE = 5.0
"""Seconds after which a frame counts as lost, so that a browser that never answers is sent another."""

_ASK_AGAIN, _READING = 0.004, 0.2
"""Seconds between looks at whether the browser has answered; seconds that it is given to read a painted mesh."""

_HAND = 0.012
"""Radius [m] of the ball that stands for a hand: two finger tips'."""

_FOOT_HEIGHT, _FOOT_LENGTH = 0.12, 0.25
"""Of an adult's foot, ankle included [m]: what lies that low shades the ground, at least as far as one foot does."""

_PATCH_SPREAD = 1.9
"""Size of the patch over that of the feet: it fades to nothing at its rim, so half of it lies beyond them."""


def light(scene: SceneApi) -> None:
    """Add the lights that all windows share: sky, fill and rim, so that surfaces outside the key light stay readable.

    Args:
        scene: of the server.
    """
    scene.set_up_direction("+y")
    scene.world_axes.visible = False
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(190, 180, 170), intensity=_SKY)
    for name, (position, intensity) in zip(("fill", "rim"), LIGHTS[1:], strict=True):
        scene.add_light_directional(f"/light/{name}", intensity=_LAMP * intensity, position=position)


class Display:
    """The drawing of one page, sent no faster than its browser can receive it. Only one thread may use it.

    Args:
        client: the window.
        dragged: called when the mouse drags cloth, if a single clip that can be touched is in view.

    Attributes:
        looks: the overlay of each clip; empty before one is chosen.
    """

    def __init__(self, client: ClientHandle, dragged: Dragged) -> None:
        self._client, self._dragged = client, dragged
        self._figures: tuple[Figure, ...] = ()
        self._set = 0
        self._drawn: object = None
        self._overlay = SHADED
        self.looks: tuple[Overlay, ...] = ()
        position, intensity = LIGHTS[0]
        self._key = client.scene.add_light_directional("/light/key", intensity=_LAMP * intensity, position=position)
        self._ground = client.scene.add_grid(
            "/ground", plane="xz", infinite_grid=True, cell_size=_CELL, section_size=2 * _CELL, cell_thickness=0.6,
            section_thickness=0.9, cell_color=(214, 216, 220), section_color=(196, 199, 204), fade_distance=14.0,
            fade_strength=1.5, shadow_opacity=0.25, plane_color=(240, 241, 243), plane_opacity=1.0,
        )  # fmt: skip
        self._hand = client.scene.add_icosphere("/hand", radius=_HAND, color=(230, 120, 40), visible=False)
        self._held_at: tuple[float, float, float] | None = None
        self._questions = ThreadPoolExecutor(_IN_FLIGHT, thread_name_prefix="pb4u browser")
        self._asked: list[Future[None]] = []

    def update(self, state: ViewState) -> None:
        """Update the scene to a frozen state.

        Args:
            state: the state to show, from `ViewState.frozen`.

        Raises:
            Exception: why an overlay could not be painted; once, after the clips were shown shaded.
        """
        self._key.cast_shadow = state.shadows
        if state.hand != self._held_at:
            self._held_at = state.hand
            self._hand.visible = state.hand is not None
            if state.hand is not None:
                self._hand.position = state.hand
        for figure in self._figures:
            figure.on_drag(self._dragged if state.touchable else None)
        if state.picture == self._drawn or not state.clips or not all(clip.frame_count for clip in state.clips):
            if self.waits:
                with self._client.atomic():
                    for figure in self._figures:
                        figure.reveal()
            return
        self._drawn = state.picture
        if tuple(figure.clip for figure in self._figures) != state.clips:
            self._set_up(state.clips)
        failure = self._paint(state)
        frames = [state.frame_of(clip, state.clock.frame) for clip in state.clips]
        with self._client.atomic():
            for figure, t in zip(self._figures, frames, strict=True):
                figure.show(t, state.body, state.follow)
            # The ground slides below the bodies where the view follows.
            away = middle(state.clips[0].body(frames[0])) if state.follow else np.zeros(3)
            self._ground.position = tuple(-np.mod(away, 2 * _CELL))
        self._asked.append(self._questions.submit(self._wait_for_browser))
        if failure is not None:
            raise failure

    def _set_up(self, clips: tuple[Clip, ...]) -> None:
        """Replace all figures: side by side as seen from the front, the first on the viewer's left."""
        for figure in self._figures:
            figure.remove()
        self._set += 1
        side = _to_the_right(_heading(clips[0]))
        spacing = max(float(np.abs(side) @ np.ptp(clip.body(0), axis=0)) for clip in clips) + _GAP
        self._figures = tuple(
            Figure(self._client.scene, f"/set{self._set}/figure{n}", clip, (n - (len(clips) - 1) / 2) * spacing * side)
            for n, clip in enumerate(clips)
        )
        self._overlay, self.looks = SHADED, ()

    def _paint(self, state: ViewState) -> Exception | None:
        """Change the overlay where another is wanted; returns what kept it from being painted."""
        if state.overlay == self._overlay:
            return None
        self._overlay, failure = state.overlay, None
        try:
            self.looks = tuple(OVERLAYS[state.overlay](clip) for clip in state.clips)
            for look in self.looks:
                look.colours(0)
        except Exception as error:
            failure, self.looks = error, tuple(OVERLAYS[SHADED](clip) for clip in state.clips)
        for figure, look in zip(self._figures, self.looks, strict=True):
            figure.look(look)
        return failure

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

    def settle(self, state: ViewState, gone: Callable[[], bool]) -> None:
        """Draw a state and wait until the browser shows it.

        Args:
            state: the state to show, from `ViewState.frozen`.
            gone: whether nobody is waiting any more.
        """
        self.update(state)
        while any(not future.done() for future in self._asked) and not gone():
            time.sleep(_ASK_AGAIN)
        if self.waits:
            # It is read beside the messages, and nothing tells when.
            time.sleep(_READING)
            self.update(state)

    @property
    def waits(self) -> bool:
        """Whether a frame that was sent is still out of sight."""
        return any(figure.waits for figure in self._figures)

    def close(self) -> None:
        """Ask the browser no more."""
        self._questions.shutdown(wait=False, cancel_futures=True)

    def frame_camera(self, follow: bool) -> None:
        """Look at all clips from the front, a little to the side; `follow` as in the drawn state.

        Args:
            follow: whether the view follows the body.
        """
        if not self._figures:
            return
        corners = []
        for figure in self._figures:
            points = np.concatenate([figure.clip.garment(0), figure.clip.body(0)]) + figure.place
            points -= middle(figure.clip.body(0)) if follow else 0.0
            corners += [points.min(axis=0), points.max(axis=0)]
        low, high = np.min(corners, axis=0), np.max(corners, axis=0)
        camera = self._client.camera
        # A window that has not been drawn yet has no height; most are wider than high.
        aspect = camera.aspect if camera.image_height else 1.5
        azimuth = _heading(self._figures[0].clip) + (_AZIMUTH if len(self._figures) == 1 else 0.0)
        across = float(np.abs(_to_the_right(azimuth)) @ (high - low))
        size = max(high[1] - low[1], across / aspect) * _MARGIN
        distance = size / (2 * np.tan(_FIELD_OF_VIEW / 2)) + _DEPTH
        level = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
        target = (low + high) / 2
        with self._client.atomic():
            camera.fov = float(_FIELD_OF_VIEW)
            camera.up_direction = (0.0, 1.0, 0.0)
            camera.position = target + distance * (np.cos(_ELEVATION) * level + [0.0, np.sin(_ELEVATION), 0.0])
            camera.look_at = target


class Figure:
    """The cloth and the body of a clip.

    Args:
        scene: scene of one page.
        name: of the node that holds both.
        clip: the clip to show.
        place: (3,) position of its origin [m].
    """

    def __init__(self, scene: SceneApi, name: str, clip: Clip, place: np.ndarray) -> None:
        self._scene, self._name, self.clip, self.place = scene, name, clip, place
        self._node = scene.add_frame(name, show_axes=False, position=tuple(place))
        self._versions = 0
        self._overlay: Overlay = OVERLAYS[SHADED](clip)
        self._dragged: Dragged | None = None
        self._garment = self._new_garment()
        self._retired: list[Surface] = []
        self._body = PlainSurface(scene, f"{name}/body", clip.header.body_faces, SKIN)
        self._patch = scene.add_glb(f"{name}/patch", _contact_patch(), cast_shadow=False, receive_shadow=False)
        self._waiting: tuple[np.ndarray, bool, np.ndarray] | None = None

    def look(self, overlay: Overlay) -> None:
        """Change the look of the garment from the next frame on.

        Args:
            overlay: how to paint it.
        """
        self.reveal()
        self._overlay = overlay
        self._retired.append(self._garment)
        self._garment = self._new_garment()
        self._garment.on_drag(self._dragged)

    def on_drag(self, dragged: Dragged | None) -> None:
        """Call a function when the mouse drags the cloth; see `Surface.on_drag`.

        Args:
            dragged: the function; None to stop.
        """
        if dragged is not self._dragged:
            self._dragged = dragged
            self._garment.on_drag(dragged)

    def _new_garment(self) -> Surface:
        self._versions += 1
        name, header = f"{self._name}/garment{self._versions}", self.clip.header
        if self._overlay.scale is not None:
            return PaintedSurface(self._scene, name, header.faces)
        return GarmentsSurface(self._scene, name, header, self._overlay.wireframe)

    @property
    def waits(self) -> bool:
        """Whether a frame was sent that is still out of sight."""
        return self._waiting is not None

    def show(self, t: int, body: bool, follow: bool) -> None:
        """Send a frame, and reveal the previous one if it is still hidden.

        Args:
            t: the frame.
            body: whether the body is shown.
            follow: whether the body stays in the middle, and the ground moves.
        """
        self.reveal()
        positions, body_now = self.clip.garment(t), self.clip.body(t)
        colours = self._overlay.colours(t)
        away = middle(body_now) if follow else np.zeros(3)
        self._waiting = body_now, body, away
        if self._garment.show(positions, colours):
            self.reveal()

    def reveal(self) -> None:
        """Reveal the hidden frame: garment, body and position together."""
        if self._waiting is None:
            return
        (body_now, body, away), self._waiting = self._waiting, None
        self._garment.reveal()
        self._darken_ground(body_now)
        if body:
            self._body.show(body_now, None)
        else:
            self._body.hide()
        self._node.position = tuple(self.place - away)
        for surface in self._retired:
            surface.remove()
        self._retired.clear()

    def _darken_ground(self, body: np.ndarray) -> None:
        """A soft patch under the feet, without which they seem to float."""
        low = body[body[:, 1] < body[:, 1].min() + _FOOT_HEIGHT]
        size = np.maximum(np.ptp(low[:, [0, 2]], axis=0), _FOOT_LENGTH) * _PATCH_SPREAD
        middle = (low.max(axis=0) + low.min(axis=0)) / 2
        self._patch.scale = (float(size[0]), 1.0, float(size[1]))
        self._patch.position = (float(middle[0]), 2e-3, float(middle[2]))

    def remove(self) -> None:
        """Remove it from the scene."""
        self._node.remove()


@functools.cache
def _contact_patch() -> bytes:
    """A disc of radius 0.5 m that fades from its middle outwards, as GLB."""
    rings, spokes = np.meshgrid(np.linspace(0.0, 1.0, 16), np.linspace(0.0, 2 * np.pi, 48, endpoint=False))
    points = np.stack([rings * np.sin(spokes), np.zeros_like(rings), rings * np.cos(spokes)], axis=-1) / 2
    at = np.arange(rings.size).reshape(rings.shape)
    a, b = at[:, :-1], at[:, 1:]
    c, d = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    faces = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))])
    shade = np.zeros((rings.size, 4), dtype=np.uint8)
    shade[:, 3] = (75 * (1.0 - rings) ** 1.5).ravel()
    return coloured_glb(points.reshape(-1, 3), shade, faces, transparent=True)


def _to_the_right(azimuth: float) -> np.ndarray:
    """(3,) unit vector to the right of one who looks at the origin from `azimuth` [rad]."""
    return np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])


def _heading(clip: Clip) -> float:
    return float(clip.header.metadata.get("heading", 0.0))
