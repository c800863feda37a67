"""Cloth as the browser holds it: one mesh whose vertices are moved, or coloured meshes that take turns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from pb4u.viewer.coloured_mesh import ColouredMesh

if TYPE_CHECKING:
    from viser import GlbHandle, MeshHandle, SceneApi


class Surface(ABC):
    """Cloth in the scene of one page."""

    @abstractmethod
    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        """Send a frame; true where the page shows it at once, false where `reveal` is needed."""

    @abstractmethod
    def reveal(self) -> None:
        """Show the frame sent last."""

    @abstractmethod
    def remove(self) -> None:
        """Take it out of the scene."""


class PlainSurface(Surface):
    """One colour: after the first frame only positions travel, 12 bytes a vertex."""

    def __init__(
        self, scene: SceneApi, name: str, faces: np.ndarray, colour: tuple[float, float, float], wireframe: bool = False
    ) -> None:
        self._scene, self._name, self._wireframe = scene, name, wireframe
        self._faces = np.asarray(faces, dtype=np.uint32)
        self._colour = tuple(round(255 * channel) for channel in colour)
        self._mesh: MeshHandle | None = None

    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        if self._mesh is None:
            red, green, blue = self._colour
            self._mesh = self._scene.add_mesh_simple(
                self._name, positions, self._faces, color=(red, green, blue), side="double", wireframe=self._wireframe
            )
        else:
            self._mesh.vertices = positions
            self._mesh.visible = True
        return True

    def reveal(self) -> None:
        pass

    def hide(self) -> None:
        """Out of sight until it is shown again."""
        if self._mesh is not None:
            self._mesh.visible = False

    def remove(self) -> None:
        if self._mesh is not None:
            self._mesh.remove()


class PaintedSurface(Surface):
    """A colour at every vertex: three GLB meshes that take turns.

    A browser needs a moment to read a GLB and shows nothing meanwhile, so a frame is sent out of sight and revealed
    with the next one. The third keeps what was shown before alive, and with it the compiled shader.
    """

    _TURNS = 3

    def __init__(self, scene: SceneApi, name: str, faces: np.ndarray, vertices: int) -> None:
        self._scene, self._name = scene, name
        self._mesh = ColouredMesh(faces, vertices)
        self._nodes: list[GlbHandle] = []
        self._sent = 0

    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        assert colours is not None
        data, turn = self._mesh.glb(positions, colours), self._sent % self._TURNS
        if turn == len(self._nodes):
            self._nodes.append(self._scene.add_glb(f"{self._name}/{turn}", data, visible=False))
        else:
            self._nodes[turn].glb_data = data
        self._sent += 1
        return False

    def reveal(self) -> None:
        shown = (self._sent - 1) % self._TURNS
        for turn, node in enumerate(self._nodes):
            node.visible = turn == shown

    def remove(self) -> None:
        for node in self._nodes:
            node.remove()
