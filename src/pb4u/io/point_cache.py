"""What is before the vertices in the point caches PC2 and MDD."""

from __future__ import annotations

import struct

PC2_MAGIC = b"POINTCACHE2\0"
PC2_HEADER = struct.Struct("<12siiffi")
"""Little-endian: magic, version 1, points, first frame, sampling, samples; the vertices are little-endian too."""
MDD_HEADER = struct.Struct(">ii")
"""Big-endian (LightWave): samples, points. The time of each sample [s] and the vertices follow, big-endian too."""


def pc2_header(points: int, samples: int) -> bytes:
    """The bytes before the vertices of a PC2: magic, version 1, points, first frame 0, sampling 1, samples.

    Args:
        points: vertices of each sample.
        samples: number of samples.
    """
    return PC2_HEADER.pack(PC2_MAGIC, 1, points, 0.0, 1.0, samples)
