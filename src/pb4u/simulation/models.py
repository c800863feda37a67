"""Simulators by name, as `--model` takes them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pb4u.collision.compile_ahead import compile_ahead
from pb4u.errors import InputError, refuse_unknown, unknown_name
from pb4u.memory import keep_freed_memory
from pb4u.options import described
from pb4u.registry import Registry
from pb4u.run import PASSES, REFINEMENT, STEPS, Run, entries
from pb4u.simulation.simulator import Simulator

if TYPE_CHECKING:
    import torch

    from pb4u.simulation.checkpoint import Checkpoint

PARTS: dict[str, frozenset[str]] = {
    "solver": frozenset({STEPS}),
    "quick-solver": frozenset({STEPS, REFINEMENT}),
    "gradient-descent": frozenset({STEPS, REFINEMENT, PASSES}),
    "warm-start": frozenset({STEPS, REFINEMENT}),
    "skinning": frozenset(),
}
"""Models that are no networks, each with the parts that options apply to (`Flag.applies_to`); a network has all."""
SOLVERS = ("quick-solver", "solver")
"""Models whose steps the solver makes alone."""
_REFUSALS = {
    "first_frame": "{model} starts in a way of its own; leave the first frame to it.",
    "self_contact": "{model} carries every vertex with the body and keeps no cloth from crossing, so --self-contact "
    "cannot be on; leave it out, or take --model solver or a network.",
}
"""Options that a model without their part cannot do without, however they are asked for; other options are not looked
at, and only refused as flags."""
CONTROLS: Registry[Callable[..., Simulator]] = Registry("control")
"""What makes a control by its name, the network that it stands beside, its passes and the options of a simulator."""
TRAINABLE: Registry[str] = Registry("trainable network")
"""Advice, as part of a sentence, on how to train a network that has a name but no weights."""
_OF_NETWORKS = {"friction_law": "paper", "time_integration": "implicit-euler", "air": "off"}
"""Laws that a run of a network alone has where it leaves them open: it has learnt them."""

_BEST = "best.safetensors"
_TRAINING_STATE = "pb4u_training"
"""Key in the header of a training's last.safetensors; `training`, which writes it, lies above this package."""


def model_descriptions() -> dict[str, str]:
    """One line of description of every simulator that needs no file, by name, those that most users want first."""
    from pb4u.simulation.checkpoint import built_in_models

    networks = {name: _network_line(name) for name in built_in_models()}
    ours = {name: line for name, line in networks.items() if not name.startswith("comparison-")}
    solvers = {
        "quick-solver": "the solver with at most --refine iterations a step, no network: fastest for most garments",
        "solver": "minimises the physics energies each frame: the reference",
        "skinning": "no physics: the garment follows the body",
    }
    controls = {
        "gradient-descent": "control: the default network's start, search and passes with the gradient, no network",
        "warm-start": "control: where the default network's steps start, and nothing after",
    }
    usual = default_model()
    first = {name: line for name, line in ours.items() if name == usual}
    return {**first, **solvers, **ours, **(controls if networks else {}), **networks}


def _network_line(name: str) -> str:
    if name.startswith("comparison-"):
        return "small network with which `pb4u evaluate` compares methods"
    role = "the default network"
    if name != default_model():
        other = "the paper's own network" if name.startswith("literal") else "a network"
        role = "the default network with --refine 0" if name == default_model(0) else other
    return f"{role}; `pb4u info --model {name}` says what it is"


def default_model(refine: int = Run.refine) -> str:
    """Name of the network that "auto" stands for; without any shipped, the solver.

    Where the solver refines a prediction, the light network leaves it as little to do as the wide one does.

    Args:
        refine: solver iterations after each of its steps.
    """
    from pb4u.simulation.checkpoint import built_in_models

    order = ("pb4u", *(("pb4u-light",) if refine else ()), "pb4u-wide", "pb4u-small")
    return next((name for name in order if name in built_in_models()), "solver")


def chosen_model(run: Run) -> str:
    """Name or file of the model that a run names, or leaves open.

    Args:
        run: whose scene is not looked at.
    """
    return default_model(run.refine) if str(run.model) == "auto" else str(run.model)


def chosen_laws(run: Run) -> dict[str, str]:
    """Laws of motion by option, those that a run leaves open chosen: a solver corrects what a network never learnt.

    Args:
        run: whose scene is not looked at.
    """
    laws = dict(_OF_NETWORKS)
    if _solves(run):
        laws |= {"friction_law": "coulomb", "air": "on"}
    if chosen_model(run) in SOLVERS:
        laws["time_integration"] = "bdf2"
    if any(run.environment.wind):
        laws["air"] = "on"
    values = {name: getattr(run, name) for name in laws}
    return {name: laws[name] if value == "auto" else value for name, value in values.items()}


def _solves(run: Run) -> bool:
    """Whether the solver takes part in the steps of a run."""
    model = chosen_model(run)
    return (model in PARTS and not looks_at(model, "refine")) or run.refine > 0


def looks_at(model: str | Path, option: str) -> bool:
    """Whether a model does something with an option of a run.

    Args:
        model: its name or file.
        option: name of the option.
    """
    part = described(Run)[option].flag.applies_to
    return part is None or part in PARTS.get(str(model), (part,))


def refuse_useless(run: Run, flags: Collection[str] = ()) -> None:
    """Refuse options that the model of a run does not look at.

    Args:
        run: whose scene is not looked at.
        flags: names of the options that were given as flags.

    Raises:
        InputError: there is such a flag, or an option asks for what the model has no part for.
    """
    model = chosen_model(run)
    for name, entry in described(Run).items():
        if looks_at(model, name):
            continue
        if name in _REFUSALS:
            if getattr(run, name) not in (entry.default, False):
                raise InputError(_REFUSALS[name].format(model=model))
        elif name in flags:
            raise InputError(f"--{name.replace('_', '-')} does nothing with --model {model}; leave it out.")


def load_simulator(name: str | Path = "auto", **options: Any) -> Simulator:
    """Simulator called `name`, loaded.

    Args:
        name: "auto", "solver", "quick-solver", "gradient-descent", "warm-start", "skinning", a shipped network, a
            checkpoint file, or a .pth of the released code of Pb4U-GNet, HOOD or ContourCraft.
        options: entries of `[run]` in a scene file, by name; `Run` says what each is.

    Raises:
        InputError: an unknown name, a bad file or an impossible option.
    """
    refuse_unknown("option of a simulator", options, entries("run"))
    return simulator_of(Run(model=name, **options))


def simulator_of(run: Run) -> Simulator:
    """Simulator that the options of a run name, loaded.

    Args:
        run: whose scene is not looked at.

    Raises:
        InputError: an unknown model, a bad file or an impossible option.
    """
    from pb4u.physics.incremental_potential import IncrementalPotential
    from pb4u.physics.integrator import INTEGRATORS
    from pb4u.physics.solver.implicit_steps import free_flight
    from pb4u.physics.terms.air import Air
    from pb4u.physics.terms.damping import DAMPED
    from pb4u.physics.terms.pin_springs import PinSprings
    from pb4u.physics.terms.pull_springs import PullSprings
    from pb4u.simulation.first_frame import FIRST_FRAMES
    from pb4u.simulation.penetration_response import ContactResponse
    from pb4u.simulation.simulator import SkinningSimulator
    from pb4u.simulation.step_start import BodyMotionWarmStart
    from pb4u.simulation.stepwise_simulator import NetworkSimulator, QuickSolver, SolverSimulator

    compile_ahead()
    keep_freed_memory()
    model = chosen_model(run)
    refuse_useless(run)
    laws = chosen_laws(run)
    potential = IncrementalPotential().with_friction(laws["friction_law"])
    for term in (*DAMPED, PinSprings(), PullSprings()):
        potential = potential.with_term(term)
    if laws["air"] == "on":
        potential = potential.with_term(Air())
    if run.self_contact is not False:
        potential = potential.with_self_contact(bodies=run.contact)
    contact = ContactResponse() if run.contact else None
    # The solver improves a state more, and settles it better, than one long step of a network at the same cost.
    first = run.first_frame if run.first_frame != "auto" else "settled" if _solves(run) else "long_step"
    common: dict[str, Any] = {
        "contact": contact,
        "first_frame": FIRST_FRAMES.named(first),
        "potential": potential,
        "integrator": INTEGRATORS[laws["time_integration"]],
    }
    if model == "skinning":
        return SkinningSimulator()
    if model == "solver":
        # Where cloth stops cloth, what free flight leaves behind a fast limb would stay caught on it.
        # Chosen by heights over a body, sheets that fall on one another would begin too high: half more iterations.
        carried = BodyMotionWarmStart(potential.without_self_contact()).positions
        start = free_flight if run.self_contact is False else carried
        return SolverSimulator(start=start, **common)
    if model == "quick-solver":
        return QuickSolver(refine=run.refine, **common)
    # Where the solver refines, it improves a state more than a further pass does.
    passes = 1 if run.passes is None and run.refine else run.passes
    if model in PARTS:
        like = load_checkpoint_of(_shipped_network(model)).model.network
        return CONTROLS.named(model)(model, like, passes, refine=run.refine, **common)
    checkpoint = load_checkpoint_of(model)
    device = available_device(run.device)
    precision = _precision(run.precision, device, run.refine)
    return NetworkSimulator(
        checkpoint, run.propagation_steps, device, passes, precision, run.scaling, refine=run.refine, **common
    )


def _shipped_network(control: str) -> str:
    """Name of the network that a control stands beside."""
    name = default_model()
    if name == "solver":
        raise InputError(
            f"{control} uses the start and the line search of the default network, but no network is installed."
        )
    return name


def unknown_model(name: str) -> InputError:
    """Error for a name that is no model's; of a network that can be trained under it, where the paper's is and how.

    Args:
        name: name that was given.
    """
    meant, names = name.lower().replace("-", "_"), model_descriptions()
    trainable = TRAINABLE.get(meant)
    if trainable is None or meant in names:
        return unknown_name("model", name, names)
    networks = ", ".join(n for n in names if n not in PARTS and not n.startswith("comparison-"))
    return InputError(f"There is no model {name!r} with weights: {trainable}; the weights shipped are {networks}.")


def load_checkpoint_of(name: str) -> Checkpoint:
    """Checkpoint of a shipped network, of a checkpoint file or of a .pth of the released code.

    Args:
        name: its name or path.

    Raises:
        InputError: there is none, or its file cannot be used.
    """
    from pb4u.simulation.checkpoint import READERS, built_in_models, from_pretrained

    if name in built_in_models():
        return from_pretrained(name)
    _refuse_other_files_of_a_training(Path(name))
    if not Path(name).suffix:
        raise unknown_model(name)
    return READERS.get(Path(name).suffix.lower(), from_pretrained)(name)


def _refuse_other_files_of_a_training(path: Path) -> None:
    """Refuse files of a training's folder that are no models, such as its state."""
    best = path / _BEST if path.is_dir() else path.with_name(_BEST)
    advice = f"give {best if best.is_file() else 'a .safetensors file of weights'}"
    if path.is_dir():
        raise InputError(f"{path} is a folder, not a model; {advice}.")
    if path.is_file() and _TRAINING_STATE in _header(path):
        raise InputError(f"{path} is the saved state of a training, not a model; {advice}.")


def _header(path: Path) -> dict[str, str]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError, ValueError):
        return {}


def available_device(name: str) -> str:
    """ "cpu" or "cuda", whichever "auto", "cpu" or "cuda" stands for here.

    Args:
        name: the device requested: "auto", "cpu" or "cuda".

    Raises:
        InputError: the device is a card, and there is none, or its driver is too old.
    """
    import torch

    if name == "cuda" and not torch.cuda.is_available():
        if torch.version.cuda is not None:
            raise InputError(
                f"No CUDA device here works with CUDA {torch.version.cuda} of this torch; update the driver "
                "of the card, install a torch for an older CUDA, or use --device cpu."
            )
        raise InputError("There is no CUDA device here; use --device cpu.")
    return "cuda" if name != "cpu" and torch.cuda.is_available() else "cpu"


def _precision(name: str, device: str, refine: int) -> torch.dtype:
    import torch

    if name == "auto":
        # What the products are rounded by, the solver's iterations take away; alone it would add up over frames.
        name = "bfloat16" if refine and has_bfloat16_units(device) else "float32"
    elif name == "bfloat16" and device == "cuda" and not has_bfloat16_units(device):
        raise InputError("This card cannot multiply in bfloat16; leave out --precision, or give float32.")
    return torch.bfloat16 if name == "bfloat16" else torch.float32


def has_bfloat16_units(device: str) -> bool:
    """Whether a device, "cpu" or "cuda", multiplies matrices in bfloat16 faster than in float32.

    Args:
        device: "cpu" or "cuda".
    """
    import torch

    if device == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    # Vectors alone multiply in bfloat16 no faster than the compiled network does in float32; matrix units do. The
    # library tells no more in public than that bfloat16 works at all, which it does on any processor.
    check = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return check is not None and bool(check())
