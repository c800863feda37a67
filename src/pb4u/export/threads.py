"""Threads of cloth as an image that repeats: weaves, knits and felts, laid on in metres by the UVs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.export.shading import UNDYED, Colour
from pb4u.geometry.topology import uv_islands
from pb4u.scene.trajectory import TrajectoryHeader

PITCH = 7e-4
"""From a thread to the next [m]."""

_COUNT, _PIXELS = 512, 4
"""Threads on a side of the image, and pixels of a thread's width."""

SIDE = _COUNT * PITCH
"""Of the image [m]: what few threads' own shades repeat at is not seen on a garment."""


class Threads(NamedTuple):
    """How the threads of a cloth run.

    Args:
        draft: rows of "1" where the thread of the warp is on top.
        relief: how much darker a thread is at its edges than in its middle [1].
        uneven: spread of the shades along the warp and along the weft [1].
        length: over which a thread keeps its shade [m].
        undyed: whether the weft is.
        wale: number of loops from one rib of a knit to the next; 0 for woven cloth.
        rib: how much lighter its ribs are than the gaps between them [1].
    """

    draft: tuple[str, ...]
    relief: float
    uneven: tuple[float, float]
    length: float
    undyed: bool = False
    wale: int = 0
    rib: float = 0.0


_TWILL = ("1100", "0110", "0011", "1001")

THREADS = {
    "plain": Threads(("10", "01"), 0.16, (0.06, 0.06), 0.012),
    "slub": Threads(("10", "01"), 0.20, (0.13, 0.15), 0.03),
    "twill": Threads(_TWILL, 0.16, (0.07, 0.05), 0.01),
    "denim": Threads(("1110", "0111", "1011", "1101"), 0.22, (0.20, 0.05), 0.02, undyed=True),
    "knit": Threads(("1",), 0.14, (0.05, 0.0), 0.004, wale=1),
    "rib": Threads(("1",), 0.14, (0.05, 0.0), 0.004, wale=8, rib=0.13),
    "felt": Threads(("10", "01"), 0.0, (0.14, 0.14), 0.003),
}
"""By the name that fabrics have them under."""


def thread_image(threads: Threads, colour: Colour) -> np.ndarray:
    """The image (pixels, pixels, 3) uint8 sRGB of `SIDE` metres, whose mean is the colour; rows follow the weft.

    Args:
        threads: how they run.
        colour: sRGB [0 to 1].
    """
    rng = np.random.default_rng(0)
    warp, weft = (1.0 + spread * _shades(rng, threads.length, axis) for axis, spread in enumerate(threads.uneven))
    draft = np.array([[mark == "1" for mark in row] for row in threads.draft])
    on_top = np.tile(draft, (_COUNT // len(draft), _COUNT // len(draft)))
    across = ((np.arange(_PIXELS) + 0.5) / _PIXELS - 0.5).astype(np.float32)
    thread = np.tile(1.0 - 4.0 * threads.relief * across**2, (_PIXELS, 1))
    over: np.ndarray = np.kron(np.where(on_top, warp, 0.0), thread)
    under: np.ndarray = np.kron(np.where(on_top, 0.0, weft), thread.T)
    if threads.wale:
        place = (2.0 * np.pi * np.arange(_COUNT * _PIXELS) / _PIXELS).astype(np.float32)
        # The two legs of a loop lean towards each other.
        over = over * (1.0 + 0.12 * np.cos(place[:, None] - 2.0 * np.pi * np.abs(np.tile(across, _COUNT))))
        over = over * (1.0 + threads.rib * np.cos(place / threads.wale))
    image = np.empty((*over.shape, 3), np.uint8)
    for channel, (dye, other) in enumerate(zip(colour, UNDYED if threads.undyed else colour, strict=True)):
        shades = dye * over + other * under
        image[..., channel] = np.clip(shades * (255.0 * dye / max(float(shades.mean()), 1e-6)), 0.0, 255.0)
    return image


def _shades(rng: np.random.Generator, length: float, axis: int) -> np.ndarray:
    """Noise (threads, threads) float32 of spread one that changes from thread to thread, and along each slowly."""
    frequency = np.fft.fftfreq(_COUNT, PITCH)
    kernel = np.exp(-0.5 * (np.pi * frequency * length) ** 2)
    spectrum = np.fft.fft(rng.standard_normal((_COUNT, _COUNT)), axis=axis)
    noise = np.fft.ifft(spectrum * (kernel[:, None] if axis == 0 else kernel), axis=axis).real
    return (noise / noise.std()).astype(np.float32)


def uvs_in_metres(header: TrajectoryHeader) -> np.ndarray | None:
    """UV coordinates (uv points, 2) float64 [m] along weft and warp, each island scaled and turned; None without UVs.

    The warp runs as the panels were cut, or else upward in the garment worn at rest. Islands of no area in UV space
    become a point.

    Args:
        header: of the surface.
    """
    if header.uvs is None or header.uv_faces is None:
        return None
    island, rest = uv_islands(header.uv_faces), np.asarray(header.rest_positions, dtype=np.float64)[header.faces]
    up = rest[..., 1]
    if header.rest_uv is not None:
        up = np.where(np.isfinite(header.rest_uv[..., 1]), header.rest_uv[..., 1], up)
    (ax, ay), (bx, by) = (header.uvs[header.uv_faces[:, k]].T - header.uvs[header.uv_faces[:, 0]].T for k in (1, 2))
    doubled, (a, b) = ax * by - ay * bx, (up[:, 1:] - up[:, :1]).T

    def summed(values: np.ndarray) -> np.ndarray:
        return np.bincount(island, values)

    areas = summed(np.linalg.norm(np.cross(rest[:, 1] - rest[:, 0], rest[:, 2] - rest[:, 0]), axis=1))
    flat = summed(np.abs(doubled))
    scale = np.sqrt(np.divide(areas, flat, out=np.zeros_like(flat), where=flat > 1e-12))
    warp = np.stack([summed(np.sign(doubled) * component) for component in (by * a - ay * b, ax * b - bx * a)], axis=1)
    length = np.linalg.norm(warp, axis=1, keepdims=True)
    warp = np.divide(warp, length, out=np.tile([0.0, 1.0], (len(warp), 1)), where=length > 1e-9 * flat[:, None])
    of_point = np.zeros(len(header.uvs), dtype=np.int64)
    of_point[header.uv_faces] = island[:, None]
    x, y = header.uvs.T
    east, north = warp[of_point].T
    return np.asarray(scale[of_point][:, None] * np.stack([x * north - y * east, x * east + y * north], axis=1))
