"""Simulators by name, as `--model` takes them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from pb4u.errors import InputError, unknown_name
from pb4u.simulation.simulator import Simulator

if TYPE_CHECKING:
    import torch

    from pb4u.simulation.checkpoint import Checkpoint

OPTIONS: dict[str, frozenset[str]] = {
    "solver": frozenset({"contact", "self_contact", "body_surface", "first_frame"}),
    "quick-solver": frozenset({"contact", "self_contact", "body_surface", "first_frame", "refine"}),
    "skinning": frozenset(),
    "newton": frozenset({"device"}),
}
"""Models that are no networks, each with the options of `load_simulator` that it looks at; a network looks at all."""
_BEST = "best.safetensors"
_WHY_WITHOUT_SELF_CONTACT = {
    "skinning": "skinning carries every vertex with the body and keeps no cloth from crossing",
    "newton": "newton runs with its own self-contact off",
}
"""What simulators that cannot keep cloth from crossing say when they are asked to."""
_PRECISIONS = ("float32", "bfloat16")
_DEVICES = ("auto", "cpu", "cuda")
_TRAINING_STATE = "pb4u_training"
"""Key in the header of a training's last.safetensors; `training`, which writes it, lies above this package."""


def model_descriptions() -> dict[str, str]:
    """One line of description of every simulator that needs no file, by name."""
    from pb4u.simulation.checkpoint import built_in_models

    descriptions = {name: _network_line(name) for name in built_in_models()}
    descriptions |= {
        "solver": "minimises the physics energies each frame: the reference",
        "quick-solver": "at most --refine iterations of it a step, without a network: the fastest on a processor",
        "skinning": "no physics: the garment follows the body",
        "newton": "the cloth solver of the newton package"
        + ("" if find_spec("newton") else ' (needs the "newton" extra)'),
    }
    return descriptions


def _network_line(name: str) -> str:
    return "compared by `pb4u evaluate`" if name.startswith("comparison-") else "trained network"


def default_model() -> str:
    """Name of the best network that is shipped: paper-size, else of the widest training; without any, the solver."""
    from pb4u.simulation.checkpoint import built_in_models

    return next((name for name in ("pb4u", "pb4u-wide", "pb4u-small") if name in built_in_models()), "solver")


def looks_at(model: str | Path, option: str) -> bool:
    """Whether a model does something with an option of `load_simulator`.

    Args:
        model: its name or file.
        option: name of the option.
    """
    return str(model) not in OPTIONS or option in OPTIONS[str(model)]


def load_simulator(
    name: str | Path = "auto",
    *,
    contact: bool = True,
    self_contact: bool | None = None,
    body_surface: bool = False,
    refine: int = 5,
    propagation_steps: int | None = None,
    passes: int | None = None,
    device: str = "auto",
    first_frame: str = "auto",
    precision: str = "auto",
) -> Simulator:
    """Simulator called `name`, loaded.

    Args:
        name: "auto", "solver", "quick-solver", "skinning", "newton", a shipped network, a checkpoint file, or a .pth of
            the released code of Pb4U-GNet, HOOD or ContourCraft.
        contact: push the garment out of the body after each step (networks and solvers).
        self_contact: cloth feels cloth, within a garment and between garments (networks and solvers, which do unless
            this is False).
        body_surface: cloth stays clear of faces and edges of the body too, not at its vertices alone.
        refine: most solver iterations after each step of a network, or of the quick solver; fewer where the cloth is
            near balance.
        propagation_steps: override of K for a network; None follows the paper's rule.
        passes: evaluations of a network in a step; None is its own number, with its further ones where a step needs
            them, or 1 where the solver refines.
        device: "auto", "cpu" or "cuda".
        first_frame: way to make frame 0: "settled" by the solver, in one "long_step" of the method's own as in the
            paper, "placed" as it is, "release", "hood", "mgn" or "contourcraft" as in their released code, or "auto":
            settled where the solver runs.
        precision: of a network's products: "float32", "bfloat16", or "auto": bfloat16 where the device multiplies
            faster in it and the solver refines.

    Raises InputError for an unknown name, a bad file or an impossible option.
    """
    from pb4u.physics.contact.response import Contact, ContactResponse, NoContact
    from pb4u.physics.incremental_potential import IncrementalPotential
    from pb4u.simulation.first_frame import AsPlaced, FirstFrame, OneLongStep, Settled
    from pb4u.simulation.simulator import SkinningSimulator
    from pb4u.simulation.start_protocols import MovingStart, SkinnedStart, StandingStart
    from pb4u.simulation.step_start import CarriedStart, FreeFlight
    from pb4u.simulation.stepwise_simulator import NetworkSimulator, QuickSolverSimulator, SolverSimulator

    potential = (
        IncrementalPotential() if self_contact is False else IncrementalPotential().with_self_contact(body_surface)
    )
    ways: dict[str, FirstFrame] = {
        "settled": Settled(potential=potential),
        "long_step": OneLongStep(),
        "placed": AsPlaced(),
        "release": StandingStart(),
        "hood": StandingStart(push=1.0),
        "mgn": MovingStart(),
        "contourcraft": SkinnedStart(),
    }
    if body_surface and self_contact is False:
        raise InputError("Cloth is kept off the body's surface by self-contact; leave --self-contact off out.")
    if first_frame not in ("auto", *ways):
        raise unknown_name("first frame", first_frame, ("auto", *ways))
    if refine < 0:
        raise InputError(f"The number of refining iterations must be 0 or more, not {refine}.")
    if precision not in ("auto", *_PRECISIONS):
        raise unknown_name("precision", precision, ("auto", *_PRECISIONS))
    if device not in _DEVICES:
        raise unknown_name("device", device, _DEVICES)
    wanted = default_model() if str(name) == "auto" else str(name)
    answering: Contact = ContactResponse() if contact else NoContact()
    if first_frame != "auto" and not looks_at(wanted, "first_frame"):
        raise InputError(f"{wanted} starts in a way of its own; leave the first frame to it.")
    if self_contact and not looks_at(wanted, "self_contact"):
        raise InputError(
            f"{_WHY_WITHOUT_SELF_CONTACT[wanted]}, so --self-contact cannot be on; leave it out, or take --model "
            "solver or a network."
        )
    if wanted == "skinning":
        return SkinningSimulator()
    if wanted == "solver":
        beginning = ways.get(first_frame, ways["settled"])
        # Where cloth stops cloth, what free flight leaves behind a fast limb would stay hooked on it.
        start = FreeFlight() if self_contact is False else CarriedStart()
        return SolverSimulator(contact=answering, first_frame=beginning, potential=potential, start=start)
    if wanted == "quick-solver":
        return QuickSolverSimulator(refine, answering, ways.get(first_frame, ways["settled"]), potential)
    if wanted == "newton":
        from pb4u.simulation.newton_simulator import NewtonSimulator

        return NewtonSimulator(device)
    if wanted not in model_descriptions():
        _refuse_other_files_of_a_training(Path(wanted))
    if not Path(wanted).suffix and wanted not in model_descriptions():
        raise unknown_name("model", wanted, model_descriptions())
    # The solver improves a state more, and settles it better, than a further pass or one long step at the same cost.
    beginning = ways.get(first_frame, ways["settled" if refine else "long_step"])
    asked = 1 if passes is None and refine else passes
    on = _device(device)
    return NetworkSimulator(
        load_checkpoint_of(wanted),
        propagation_steps,
        refine,
        answering,
        on,
        asked,
        beginning,
        potential,
        _precision(precision, on, refine),
    )


def load_checkpoint_of(name: str) -> Checkpoint:
    """Checkpoint of a shipped network, of a checkpoint file or of a .pth of the released code.

    Args:
        name: its name or path.

    Raises InputError where there is none, or its file cannot be used.
    """
    from pb4u.simulation.checkpoint import from_pretrained
    from pb4u.simulation.released_weights import SUFFIXES, read_released

    return read_released(name).checkpoint() if Path(name).suffix.lower() in SUFFIXES else from_pretrained(name)


def _refuse_other_files_of_a_training(path: Path) -> None:
    """Of what `pb4u train` leaves in its folder, only some files are models."""
    best = path / _BEST if path.is_dir() else path.with_name(_BEST)
    advice = f"give {best if best.is_file() else 'a .safetensors file of weights'}"
    if path.is_dir():
        raise InputError(f"{path} is a folder, not a model; {advice}.")
    if path.is_file() and _TRAINING_STATE in _header(path):
        raise InputError(f"{path} is what a training goes on from, not a model; {advice}.")


def _header(path: Path) -> dict[str, str]:
    from safetensors import SafetensorError, safe_open

    from pb4u.reading_limits import require_small_header

    try:
        require_small_header(path)
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError, ValueError):
        return {}


def _device(name: str) -> str:
    import torch

    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("There is no CUDA device here; use --device cpu.")
    return "cuda" if name != "cpu" and torch.cuda.is_available() else "cpu"


def _precision(name: str, device: str, refine: int) -> torch.dtype:
    import torch

    if name == "auto":
        # What the products are rounded by, the solver's iterations take away; alone it would add up over frames.
        name = "bfloat16" if refine and has_bfloat16_units(device) else "float32"
    return torch.bfloat16 if name == "bfloat16" else torch.float32


def has_bfloat16_units(device: str) -> bool:
    """Whether a device, "cpu" or "cuda", multiplies matrices in bfloat16 faster than in float32."""
    import torch

    if device == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    # Vectors alone multiply in bfloat16 no faster than the compiled network does in float32; matrix units do. The
    # library tells no more in public than that bfloat16 works at all, which it does on any processor.
    found = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return found is not None and bool(found())
