"""One clip in the scene of one page: a garment on a body, at its place beside the others."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from pb4u.export.shading import CLOTH, SKIN
from pb4u.viewer.clip import Clip
from pb4u.viewer.coloured_mesh import ColouredMesh
from pb4u.viewer.overlay import Overlay, Shaded
from pb4u.viewer.surface import PaintedSurface, PlainSurface, Surface

if TYPE_CHECKING:
    from viser import SceneApi


class Figure:
    """A garment and a body.

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
            return PaintedSurface(self._scene, name, header.faces, len(header.rest_positions))
        return PlainSurface(self._scene, name, header.faces, CLOTH, self._overlay.wireframe)

    @property
    def waits(self) -> bool:
        """Whether a frame was sent that is still out of sight."""
        return self._waiting is not None

    def show(self, t: int, body: bool, follow: bool) -> None:
        """Send frame t, and reveal the one before where that waits."""
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
        low = body[body[:, 1] < body[:, 1].min() + 0.12]
        size = np.maximum(np.ptp(low[:, [0, 2]], axis=0), 0.25) * 1.9
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
    return ColouredMesh(faces, rings.size, transparent=True).glb(points.reshape(-1, 3), shade)


def ground_position(body: np.ndarray) -> np.ndarray:
    """(3,) [m] the point of the ground below the middle of a body (vertices, 3)."""
    middle = np.median(body, axis=0)
    return np.array([middle[0], 0.0, middle[2]])
