"""One clip in the scene of one page: garments on a body, at its place beside the others."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from pb4u.export.shading import CLOTH, SKIN
from pb4u.viewer.clip import Clip
from pb4u.viewer.overlay import Overlay, Shaded
from pb4u.viewer.surface import PaintedSurface, PlainSurface, Surface, coloured_glb

if TYPE_CHECKING:
    from viser import SceneApi

_FOOT_HEIGHT, _FOOT_LENGTH = 0.12, 0.25
"""Of an adult's foot, ankle included [m]: what lies that low shades the ground, at least as far as one foot does."""

_PATCH_SPREAD = 1.9
"""Size of the patch over that of the feet: it fades to nothing at its rim, so half of it lies beyond them."""


class Figure:
    """The cloth and the body of a clip.

    Args:
        scene: of one page.
        name: of the node that holds both.
        clip: what is shown.
        place: (3,) where its origin stands [m].
    """

    def __init__(self, scene: SceneApi, name: str, clip: Clip, place: np.ndarray) -> None:
        self._scene, self._name, self.clip, self._place = scene, name, clip, place
        self._node = scene.add_frame(name, show_axes=False, position=tuple(place))
        self._versions = 0
        self._overlay: Overlay = Shaded(clip)
        self._garment = self._new_garment()
        self._retired: list[Surface] = []
        self._body = PlainSurface(scene, f"{name}/body", clip.header.body_faces, SKIN)
        self._patch = scene.add_glb(f"{name}/patch", _contact_patch(), cast_shadow=False, receive_shadow=False)
        self._waiting: tuple[np.ndarray, bool, np.ndarray] | None = None

    def look(self, overlay: Overlay) -> None:
        """Paint the garment another way from the next frame on."""
        self.reveal()
        self._overlay = overlay
        self._retired.append(self._garment)
        self._garment = self._new_garment()

    def _new_garment(self) -> Surface:
        self._versions += 1
        name, header = f"{self._name}/garment{self._versions}", self.clip.header
        if self._overlay.painted:
            return PaintedSurface(self._scene, name, header.faces)
        return PlainSurface(self._scene, name, header.faces, CLOTH, self._overlay.wireframe)

    @property
    def waits(self) -> bool:
        """Whether a frame was sent that is still out of sight."""
        return self._waiting is not None

    def show(self, t: int, body: bool, follow: bool) -> None:
        """Send a frame, and reveal the one before where that waits.

        Args:
            t: the frame.
            body: whether the body is shown.
            follow: whether the body stays in the middle, and the ground moves.
        """
        self.reveal()
        positions, body_now = self.clip.garment(t), self.clip.body(t)
        colours = self._overlay.colours(t) if self._overlay.painted else None
        away = ground_position(body_now) if follow else np.zeros(3)
        self._waiting = body_now, body, away
        if self._garment.show(positions, colours):
            self.reveal()

    def reveal(self) -> None:
        """Bring the frame that waits into sight: garment, body and place together."""
        if self._waiting is None:
            return
        (body_now, body, away), self._waiting = self._waiting, None
        self._garment.reveal()
        self._darken_ground(body_now)
        if body:
            self._body.show(body_now, None)
        else:
            self._body.hide()
        self._node.position = tuple(self._place - away)
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
        """Take it out of the scene."""
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


def ground_position(body: np.ndarray) -> np.ndarray:
    """(3,) [m] the point of the ground below the middle of a body (vertices, 3)."""
    middle = np.median(body, axis=0)
    return np.array([middle[0], 0.0, middle[2]])
