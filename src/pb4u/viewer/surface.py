"""Cloth as the browser holds it: one mesh whose vertices are moved, or coloured meshes that take turns."""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pb4u.export.drawn_cloth import DrawnCloth
from pb4u.export.sewing_lines import ABOVE, SewingLines, sewing_lines
from pb4u.export.shading import cloth_parts, unit_normals
from pb4u.io.gltf_file import FLOAT, UNSIGNED_BYTE, UNSIGNED_INT, UNSIGNED_SHORT, GltfDocument, glb_head

if TYPE_CHECKING:
    from viser import GlbHandle, LineSegmentsHandle, MeshHandle, SceneApi

    from pb4u.scene.trajectory import TrajectoryHeader

Dragged = Callable[[str, tuple[float, float, float], tuple[float, float, float]], None]
"""Called with "start", "update" or "end" of a drag, the point where it began and that where it is, (3,) [m] each."""

_LINE_SHADE = 0.65
"""Colour of lines, which take no light here, over what they are in pictures: cloth in the light is about that dark."""


class Surface(ABC):
    """Cloth in the scene of one page."""

    @abstractmethod
    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        """Send a frame; true where the page shows it at once, false where `reveal` is needed.

        Args:
            positions: (vertices, 3) float32 [m].
            colours: (vertices, 4) uint8 linear RGBA; None if the surface has one colour.
        """

    @abstractmethod
    def reveal(self) -> None:
        """Show the frame sent last."""

    @abstractmethod
    def on_drag(self, dragged: Dragged | None) -> None:
        """Call a function when the left mouse button drags the cloth, instead of rotating the view; None to stop.

        Args:
            dragged: called one at a time, in the server's thread for messages.
        """

    @abstractmethod
    def remove(self) -> None:
        """Remove it from the scene."""


def _listen(node: MeshHandle, dragged: Dragged | None) -> None:
    node.remove_drag_callback()
    if dragged is not None:

        async def told(event: Any) -> None:
            # Awaited where messages come in, so that none overtakes another.
            dragged(event.phase, event.start_position, event.end_position)

        node.on_drag("left")(told)


class PlainSurface(Surface):
    """One colour: after the first frame only positions travel, 12 bytes a vertex.

    Args:
        scene: scene of one page.
        name: of the node.
        faces: (faces, 3) int.
        colour: sRGB from 0 to 1.
        wireframe: draw edges instead of faces.
    """

    def __init__(
        self, scene: SceneApi, name: str, faces: np.ndarray, colour: tuple[float, float, float], wireframe: bool = False
    ) -> None:
        self._scene, self._name, self._wireframe = scene, name, wireframe
        self._faces = np.asarray(faces, dtype=np.uint32)
        self._colour = tuple(round(255 * channel) for channel in colour)
        self._mesh: MeshHandle | None = None
        self._dragged: Dragged | None = None

    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        if self._mesh is None:
            red, green, blue = self._colour
            self._mesh = self._scene.add_mesh_simple(
                self._name, positions, self._faces, color=(red, green, blue), side="double", wireframe=self._wireframe
            )
            if self._dragged is not None:
                self.on_drag(self._dragged)
        else:
            self._mesh.vertices = positions
            self._mesh.visible = True
        return True

    def reveal(self) -> None:
        pass

    def on_drag(self, dragged: Dragged | None) -> None:
        self._dragged = dragged
        if self._mesh is not None:
            _listen(self._mesh, dragged)

    def hide(self) -> None:
        """Hide it until it is shown again."""
        if self._mesh is not None:
            self._mesh.visible = False

    def remove(self) -> None:
        if self._mesh is not None:
            self._mesh.remove()


class GarmentsSurface(Surface):
    """Garments with their hems and seams; each part of one colour is a separate surface.

    Args:
        scene: scene of one page.
        name: of the nodes.
        header: of the garments.
        wireframe: draw edges instead of faces, hems and seams.
    """

    def __init__(self, scene: SceneApi, name: str, header: TrajectoryHeader, wireframe: bool = False) -> None:
        parts = cloth_parts(replace(header, appearances=None))
        # The edges of a wireframe are those that are simulated.
        self._drawn = DrawnCloth(header, coarse=0) if wireframe else DrawnCloth(header)
        self._lines: list[tuple[SewingLines, LineSegmentsHandle]] = []
        lines = self._drawn.lines(sewing_lines(header))
        colours = (_LINE_SHADE * lines.colours(parts, self._drawn.parent)).astype(np.uint8)
        for width in [] if wireframe else np.unique(lines.width).tolist():
            chosen = lines.width == width
            handle = scene.add_line_segments(
                f"{name}/lines {width}", np.zeros((chosen.sum(), 2, 3), np.float32),
                np.repeat(colours[chosen][:, None], 2, axis=1), thickness=width,
            )  # fmt: skip
            self._lines.append((lines.at(chosen), handle))
        self._parts: list[tuple[np.ndarray, PlainSurface]] = []
        for number, part in enumerate(parts):
            rows, corners = np.unique(self._drawn.faces[np.isin(self._drawn.parent, part.faces)], return_inverse=True)
            surface = PlainSurface(scene, f"{name}/{number}", corners.reshape(-1, 3), part.colour, wireframe)
            self._parts.append((rows, surface))

    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        cloth = self._drawn.at(positions)
        if self._lines:
            above = cloth + ABOVE * unit_normals(cloth, self._drawn.faces)
            for lines, handle in self._lines:
                handle.points = lines.of(above).reshape(-1, 2, 3)
        return all([surface.show(cloth[rows], None) for rows, surface in self._parts])

    def reveal(self) -> None:
        pass

    def on_drag(self, dragged: Dragged | None) -> None:
        for _, surface in self._parts:
            surface.on_drag(dragged)

    def remove(self) -> None:
        for node in [surface for _, surface in self._parts] + [handle for _, handle in self._lines]:
            node.remove()


class PaintedSurface(Surface):
    """A mesh with a colour at every vertex, shown by three GLB copies in turn, since a browser takes time to read one.

    A browser needs a moment to read a GLB and shows nothing meanwhile, so a frame is sent hidden and revealed with the
    next one. The third keeps the previous mesh alive, and with it the compiled shader.

    Args:
        scene: scene of one page.
        name: of the nodes.
        faces: (faces, 3) int.
    """

    _TURNS = 3

    def __init__(self, scene: SceneApi, name: str, faces: np.ndarray) -> None:
        self._scene, self._name, self._faces = scene, name, faces
        self._nodes: list[GlbHandle] = []
        self._sent = 0

    def show(self, positions: np.ndarray, colours: np.ndarray | None) -> bool:
        assert colours is not None
        data, turn = coloured_glb(positions, colours, self._faces), self._sent % self._TURNS
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

    def on_drag(self, dragged: Dragged | None) -> None:
        """Does nothing: the browser ends a drag when its mesh is hidden, and each of these is hidden in turn.

        Args:
            dragged: never called.
        """

    def remove(self) -> None:
        for node in self._nodes:
            node.remove()


def coloured_glb(positions: np.ndarray, colours: np.ndarray, faces: np.ndarray, transparent: bool = False) -> bytes:
    """The smallest GLB that a browser can take thirty times a second: a mesh with a colour at every vertex.

    Args:
        positions: (vertices, 3) float [m].
        colours: (vertices, 4) uint8 linear RGBA.
        faces: (faces, 3) int.
        transparent: whether the alpha of the colours counts.
    """
    short = len(positions) < 65536
    binary = io.BytesIO()
    document = GltfDocument(binary)
    attributes = {
        "POSITION": document.add_vectors(positions, bounded=True),
        "COLOR_0": document.add(np.asarray(colours, dtype=np.uint8), "VEC4", UNSIGNED_BYTE, normalized=True),
    }
    corners = np.ravel(faces).astype("<u2" if short else "<u4")
    indices = document.add(corners, "SCALAR", UNSIGNED_SHORT if short else UNSIGNED_INT)
    # Normals are named but not sent (zeros, by the format): the browser computes them from the positions, and without
    # the name it would shade every triangle flat.
    attributes["NORMAL"] = len(document.json["accessors"])
    document.json["accessors"].append({"componentType": FLOAT, "count": len(positions), "type": "VEC3"})
    matt = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.9}, "doubleSided": True}
    primitive = {"attributes": attributes, "indices": indices, "material": 0}
    content = binary.getvalue()
    document.json |= {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{**matt, "alphaMode": "BLEND"} if transparent else matt],
        "buffers": [{"byteLength": len(content)}],
    }
    return glb_head(document.json, len(content)) + content
