"""Files and first frames of released research code; what computes registers itself in modules of its own."""

from __future__ import annotations

from pb4u.export.registry import WRITERS, Format

WRITERS[".pkl"] = Format(
    (".pkl",),
    "PKL is the result layout of HOOD's family, for their viewers",
    "pb4u.compat.result_pickle:write_result",
)
