"""What is run, for each table and figure of the paper: plain records. How they are drawn is in `views.py`."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches

from pb4u.errors import InputError
from pb4u.evaluation.views import (
    AcrossLevels,
    AgainstSteps,
    LevelTable,
    OverTime,
    PictureGrid,
    TermsTable,
    View,
)
from pb4u.scene.catalogue import MOTIONS, RECORDINGS, TRAINING_GARMENTS, UNSEEN_GARMENTS

_NETWORKS = (
    "pb4u",
    "pb4u-small",
    "comparison-pb4u",
    "comparison-mgn",
    "comparison-hood",
    "comparison-eslr",
    "comparison-contourcraft",
)
_ABLATIONS = (
    "comparison-pb4u",
    "comparison-pb4u-without-control",
    "comparison-pb4u-without-scaling",
    "comparison-pb4u-without-both",
)


@dataclass(frozen=True)
class Protocol:
    """A protocol of the paper: everything that is combined with everything else, and what is made of it.

    Args:
        name: what `--protocol` takes.
        reproduces: the table or figure of the paper it stands for, as a sentence.
        models: simulators by default; those whose weights are not there are left out, with a line that says so.
        garments, bodies: built-in names.
        motions: built-in motions, where no recordings are given.
        recordings: CMU trials that take their place where they are.
        levels: resolutions, by name or number of triangles.
        frames: frames to write of each scene.
        steps: numbers of propagation steps; None is the model's own rule.
        varied: what the tables and figures compare, in words.
        views: how they are drawn, in the order of the page.
    """

    name: str
    reproduces: str
    models: tuple[str, ...]
    garments: tuple[str, ...]
    motions: tuple[str, ...]
    recordings: tuple[str, ...]
    levels: tuple[str, ...]
    varied: str
    views: tuple[View, ...]
    bodies: tuple[str, ...] = ("woman",)
    frames: int = 30
    steps: tuple[int | None, ...] = (None,)

    def pictures(self, level: str, motion: str, body: str) -> bool:
        """Whether scenes there are drawn: those of the top level on the first motion and body."""
        drawn = any(isinstance(view, PictureGrid) for view in self.views)
        return drawn and (level, motion, body) == (self.levels[-1], self.motions[0], self.bodies[0])


RESOLUTION = Protocol(
    name="resolution",
    reproduces="The paper's table on unseen resolutions, its figure of stretch over time and its picture grid.",
    models=(*_NETWORKS, "skinning", "solver"),
    garments=TRAINING_GARMENTS,
    motions=MOTIONS["test"],
    recordings=RECORDINGS["test"],
    levels=("11K", "18K", "25K", "38K"),
    varied="resolution",
    views=(TermsTable(), AcrossLevels(), OverTime("stretch", preferred="07_02"), PictureGrid()),
)

UNSEEN = Protocol(
    name="unseen",
    reproduces="The paper's table on garments never trained on, at the top level, and their rows of the picture grid.",
    models=(*_NETWORKS, "skinning", "solver"),
    garments=UNSEEN_GARMENTS,
    motions=MOTIONS["test"],
    recordings=RECORDINGS["test"],
    levels=("38K",),
    varied="garment",
    views=(TermsTable(), OverTime("stretch", preferred="07_02"), PictureGrid()),
)

DEPTH = Protocol(
    name="depth",
    reproduces="The paper's figure of the loss against the number of propagation steps at three resolutions.",
    models=("pb4u", "pb4u-small", "comparison-pb4u", "solver"),
    garments=("dress",),
    motions=("walk",),
    recordings=("07_02",),
    levels=("12K", "25K", "48K"),
    steps=(1, 5, 10, 15, 20, 25, 30),
    varied="propagation steps",
    views=(AgainstSteps(), LevelTable(("total",))),
)

EFFICIENCY = Protocol(
    name="efficiency",
    reproduces="The paper's table of loss and latency on the dress at three resolutions.",
    models=(*_NETWORKS, "skinning", "solver"),
    garments=("dress",),
    motions=("walk",),
    recordings=("07_02",),
    levels=("12K", "25K", "48K"),
    varied="resolution",
    views=(LevelTable(("total", "ms")), AcrossLevels(("ratio", "ms"))),
)

ABLATION = Protocol(
    name="ablation",
    reproduces="The paper's ablation of propagation control and update scaling.",
    models=(*_ABLATIONS, "solver"),
    garments=TRAINING_GARMENTS,
    motions=MOTIONS["test"],
    recordings=RECORDINGS["test"],
    levels=("11K", "25K", "38K"),
    varied="the network's parts",
    views=(LevelTable(("total",)), AcrossLevels(("stretch", "ratio", "survived_percent")), PictureGrid()),
)

PROTOCOLS: dict[str, Protocol] = {
    protocol.name: protocol for protocol in (RESOLUTION, UNSEEN, DEPTH, EFFICIENCY, ABLATION)
}


def protocol_named(name: str) -> Protocol:
    """The protocol called `name`. Raises InputError listing the names."""
    if name not in PROTOCOLS:
        near = get_close_matches(name, PROTOCOLS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(PROTOCOLS)}."
        raise InputError(f"There is no protocol {name!r}; {hint}")
    return PROTOCOLS[name]
