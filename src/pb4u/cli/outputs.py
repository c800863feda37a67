"""Files that `pb4u simulate` writes, as one record, and their flags."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pb4u.cli.record_flags import option, record_flags
from pb4u.export.registry import formats_help
from pb4u.options import Flag, described

FORMATS = formats_help()
_PANEL = "Output"


@dataclass(frozen=True)
class Outputs:
    """Files that a run writes, and the measurements for them.

    Args:
        out: File to write, repeatable. Default: GARMENT_MOTION with .npz, .glb, .png and .mp4.
        json: Write counts, timing and metrics as JSON; '-' is standard output.
        measure: Also measure excess, which costs three solves a frame: the energy above the least of each step, as the
            height to which it would lift the garments. Needs --json.
        reference: Also measure the mean distance of the vertices from those of a trajectory, such as the solver's.
            Needs --json.
        save_scene: Also write a scene file, to run the same again: `pb4u simulate FILE`.
        live: Also write each frame there as it is computed: NAME.pc2 of each garment on its author's own mesh, and a
            line of progress.jsonl a step.
        bones: Give each surface of a .glb this many bones (48 at most) instead of morph targets, since game engines
            play bones; prints the resulting error.
    """

    out: Annotated[tuple[Path, ...], Flag(_PANEL, "FILE")] = ()
    json: Annotated[str | None, Flag(_PANEL, "FILE|-")] = None
    measure: Annotated[Literal["excess"] | None, Flag(_PANEL, "excess")] = None
    reference: Annotated[Path | None, Flag(_PANEL, "FILE.npz")] = None
    save_scene: Annotated[Path | None, Flag(_PANEL, "FILE")] = None
    live: Annotated[Path | None, Flag(_PANEL, "FOLDER")] = None
    bones: Annotated[int | None, Flag(_PANEL, "N")] = None


OUTPUT_FLAGS: dict[str, Any] = {
    **record_flags(Outputs),
    "out": Annotated[list[Path] | None, option(described(Outputs)["out"], f" {FORMATS}")],
}
