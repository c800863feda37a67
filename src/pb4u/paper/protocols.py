"""What is run, for each table and figure of the paper: plain records. How they are drawn is in `report.py`."""

from __future__ import annotations

from dataclasses import dataclass

from pb4u.garment.cuts import CUTS
from pb4u.garment.material import MATERIALS
from pb4u.training.catalogue import MOTIONS, RECORDINGS, TRAINING_GARMENTS, UNSEEN_GARMENTS

_NETWORKS = (
    "literal_small",
    "pb4u-small",
    "comparison-pb4u",
    "comparison-mgn",
    "comparison-hood",
    "comparison-eslr",
    "comparison-contourcraft",
)
_ABLATIONS = ("comparison-literal", "comparison-literal-without-control")
"""The paper's own network, trained at 1,200 triangles alone, K drawn or always 5, all else alike."""


@dataclass(frozen=True)
class Protocol:
    """A protocol: values that are all combined with each other, or from which scenes are drawn at random.

    Args:
        name: value of `--protocol`.
        reproduces: the table or figure of the paper that it reproduces, as a sentence.
        models: simulators by default; those without weights are left out, with a note.
        levels: resolutions, by name or number of triangles.
        varied: quantity that the tables and figures compare, in words.
        pictured: one moment of every model is drawn at the top level, on the first motion and body.
        garments: built-in names.
        motions: built-in motions, used without recordings.
        recordings: CMU trials that replace them if available.
        bodies: built-in names.
        frames: frames to write of each scene.
        steps: numbers of propagation steps; None is the model's own rule.
        scalings: rules of update scaling in use, as `--scaling` names them; None is that of the model's training.
        scenes: number of random scenes drawn from these values, with body shapes and seeds of motions; 0 uses all
            combinations.
        materials: names of cloths to draw from.
        excess: also measure what single steps leave on states shared by all models, and the distance from the solver.
    """

    name: str
    reproduces: str
    models: tuple[str, ...]
    levels: tuple[str, ...]
    varied: str
    pictured: bool = False
    garments: tuple[str, ...] = TRAINING_GARMENTS
    motions: tuple[str, ...] = MOTIONS["test"]
    recordings: tuple[str, ...] = RECORDINGS["test"]
    bodies: tuple[str, ...] = ("woman",)
    frames: int = 30
    steps: tuple[int | None, ...] = (None,)
    scalings: tuple[str | None, ...] = (None,)
    scenes: int = 0
    materials: tuple[str, ...] = ()
    excess: bool = False

    def pictures(self, level: str, motion: str, body: str) -> bool:
        """Whether scenes at a place of the protocol are drawn.

        Args:
            level: name of the resolution.
            motion: its name.
            body: its name.
        """
        return self.pictured and (level, motion, body) == (self.levels[-1], self.motions[0], self.bodies[0])


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol(
            name="resolution",
            reproduces="The paper's table on unseen resolutions, its figure of stretch over time and its picture grid.",
            models=(*_NETWORKS, "skinning", "solver"),
            levels=("11K", "18K", "25K", "38K"),
            varied="resolution",
            pictured=True,
        ),
        Protocol(
            name="unseen",
            reproduces=(
                "The paper's table on garments never trained on, at the top level, and their rows of the picture grid."
            ),
            models=(*_NETWORKS, "skinning", "solver"),
            garments=UNSEEN_GARMENTS,
            levels=("38K",),
            varied="garment",
            pictured=True,
        ),
        Protocol(
            name="depth",
            reproduces="The paper's figure of the loss against the number of propagation steps at three resolutions.",
            models=("literal_small", "comparison-pb4u", "solver"),
            garments=("dress",),
            motions=("walk",),
            recordings=("07_02",),
            levels=("12K", "25K", "48K"),
            steps=(1, 5, 10, 15, 20, 25, 30),
            varied="propagation steps",
        ),
        Protocol(
            name="efficiency",
            reproduces="The paper's table of loss and latency on the dress at three resolutions.",
            models=(*_NETWORKS, "skinning", "solver"),
            garments=("dress",),
            motions=("walk",),
            recordings=("07_02",),
            levels=("12K", "25K", "48K"),
            varied="resolution",
        ),
        Protocol(
            name="ablation",
            reproduces=(
                "The paper's ablation of propagation control and update scaling, at the ratios of its 11K, 25K and 38K "
                "to the mesh of the training."
            ),
            models=(*_ABLATIONS, "solver"),
            levels=("1200", "2730", "4140"),
            scalings=(None, "none"),
            varied="the network's parts",
            pictured=True,
        ),
        Protocol(
            name="controls",
            reproduces="What the network is worth: beside it its start alone, gradient descent and the solver.",
            models=("pb4u-light", "pb4u-wide", "warm-start", "gradient-descent", "quick-solver", "solver"),
            garments=("tshirt", "dress", "skirt", "trousers"),
            motions=tuple(f"{name}-{seed}" for name in ("walk", "dance", "jump") for seed in (2000, 2001, 2002)),
            recordings=(),
            levels=("base",),
            frames=60,
            varied="what stands in the network's place",
            excess=True,
        ),
        Protocol(
            name="robustness",
            reproduces=(
                "What happens in the hands of others: garments, body shapes, motions, materials and levels drawn by "
                "seed, each network alone and by default."
            ),
            models=("pb4u-light", "quick-solver", "solver"),
            garments=tuple(CUTS),
            motions=MOTIONS["train"],
            bodies=("woman", "man"),
            levels=("base",),
            frames=60,
            varied="everything",
            scenes=64,
            materials=tuple(MATERIALS),
        ),
    )
}
