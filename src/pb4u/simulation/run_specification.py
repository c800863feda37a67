"""A whole run: the scene, and how it is simulated."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from pb4u.errors import InputError, unknown_name
from pb4u.scene.specification import SceneSpecification, require_name, require_switch, require_whole

if TYPE_CHECKING:
    from pb4u.simulation.simulator import Simulator

Device = Literal["auto", "cpu", "cuda"]
FirstFrameChoice = Literal["auto", "settled", "long_step"]


@dataclass(frozen=True)
class RunSpecification:
    """A scene and how it is simulated.

    Args:
        scene: what is simulated.
        model: "auto", "solver", "skinning", "newton", a shipped network or a checkpoint file.
        contact: push the garment out of the body after each step (networks and solver).
        refine: solver iterations after each step of a network.
        passes: how often a network is asked in a step; None is decided by `resolved_passes`.
        propagation_steps: override of K for a network; None follows the paper's rule.
        device: where networks and newton compute.
        first_frame: how frame 0 is made: "settled" by the solver, or by one "long_step" of the method itself; "auto"
            is decided by `resolved_first_frame`.

    Raises:
        InputError: a value of a wrong type or out of range.
    """

    scene: SceneSpecification = field(default_factory=SceneSpecification)
    model: str | Path = "auto"
    contact: bool = True
    refine: int = 5
    passes: int | None = None
    propagation_steps: int | None = None
    device: Device = "auto"
    first_frame: FirstFrameChoice = "auto"

    def __post_init__(self) -> None:
        require_name("model", self.model)
        require_switch("contact", self.contact)
        require_whole("number of refining iterations", self.refine)
        require_whole("number of passes", self.passes, optional=True)
        require_whole("number of propagation steps", self.propagation_steps, optional=True)
        if self.refine < 0:
            raise InputError(f"The number of refining iterations must be 0 or more, not {self.refine}.")
        if self.passes is not None and self.passes < 1:
            raise InputError(f"A network takes at least 1 pass a step, not {self.passes}.")
        if self.device not in get_args(Device):
            raise unknown_name("device", str(self.device), get_args(Device))
        if self.first_frame not in get_args(FirstFrameChoice):
            raise unknown_name("first frame", str(self.first_frame), get_args(FirstFrameChoice))

    @property
    def resolved_passes(self) -> int | None:
        """How often a network is asked in a step; None is its own number.

        Once where the solver refines: what a further pass improves, the solver improves more cheaply.
        """
        return 1 if self.passes is None and self.refine else self.passes

    @property
    def resolved_first_frame(self) -> Literal["settled", "long_step"]:
        """How frame 0 is made: the paper's long step where a network runs alone, else settled by the solver."""
        if self.first_frame != "auto":
            return self.first_frame
        return "settled" if self.refine or str(self.model) == "solver" else "long_step"

    def simulator(self) -> Simulator:
        """What simulates the scene.

        Raises:
            InputError: an unknown model, a bad file or an impossible option.
        """
        # It brings torch, which a description does without.
        from pb4u.simulation.models import load_simulator

        if self.first_frame not in ("auto", replace(self, first_frame="auto").resolved_first_frame):
            raise InputError(f"{self.model} cannot start with a first frame made as {self.first_frame} yet.")
        return load_simulator(
            self.model,
            contact=self.contact,
            refine=self.refine,
            propagation_steps=self.propagation_steps,
            passes=self.resolved_passes,
            device=self.device,
        )
