"""Configuration of a training as one typed record; as JSON, and with single fields replaced by name."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import Any, NamedTuple

from pb4u.errors import InputError, refuse_unknown, unknown_name
from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.registry import NETWORKS
from pb4u.network.update_scaling import SCALINGS, with_scaling
from pb4u.registry import Registry
from pb4u.simulation.network_configuration import configuration_from_json, configuration_to_json
from pb4u.training.curriculum import Curriculum
from pb4u.training.objective import LOSS_WEIGHTS

AFTER_SETTLING = ("skinned", "slowed", "zero", "carried")


@dataclass(frozen=True)
class DataSelection:
    """Selection of the garments, bodies and motions to train on.

    Args:
        garments: names of built-in garments, "cape" for a cape held by pins, and files of your own that fit the first
            body.
        triangles: triangle counts of each.
        bodies: names of built-in bodies.
        shapes: number of shapes of each body; the first is its default, the others are random.
        motions: names of built-in motions; none to use only recordings.
        clips: clips for each body shape, drawn from the built-in motions and their seeds, besides the recordings.
        clip_frames: length of a built-in clip [frames].
        fps: frames per second [1/s].
        drawn_shapes: lowest and highest value of each parameter of a random shape, within 0 to 1.
        varied: share of garments with a random cut.
        uneven: share of garments with half the edge length in one region.

    Raises:
        InputError: an empty selection or a number out of range.
    """

    garments: tuple[str, ...] = ("tshirt", "tanktop", "longsleeve", "dress")
    triangles: tuple[int, ...] = (11000,)
    bodies: tuple[str, ...] = ("woman", "man")
    shapes: int = 6
    motions: tuple[str, ...] = ("walk", "run", "jump", "arms", "twist", "squat", "turn", "dance")
    clips: int = 48
    clip_frames: int = 90
    fps: float = 30.0
    drawn_shapes: tuple[float, float] = (0.1, 0.9)
    varied: float = 0.0
    uneven: float = 0.0

    def __post_init__(self) -> None:
        if not self.garments or not self.triangles or not self.bodies:
            raise InputError("A training needs at least one garment, one triangle count and one body.")
        if self.shapes < 1 or self.clips < 0 or self.clip_frames < 8 or not 1.0 <= self.fps <= 1000.0:
            raise InputError(
                "A training needs 1 body shape or more, 0 clips or more, clips of 8 frames or more and 1 to 1000 fps."
            )
        if not 0.0 <= self.drawn_shapes[0] <= self.drawn_shapes[1] <= 1.0:
            raise InputError("data.drawn_shapes must be a lowest and a highest value from 0 to 1.")
        if not (0.0 <= self.varied <= 1.0 and 0.0 <= self.uneven <= 1.0):
            raise InputError("data.varied and data.uneven must be shares from 0 to 1.")


@dataclass(frozen=True)
class MaterialSampling:
    """Ranges from which materials are drawn (reference 1.7), bending and mu uniformly in their logarithm.

    Args:
        density: lowest and highest [kg/m^2].
        lame_mu: lowest and highest [Pa].
        lame_lambda: lowest and highest [Pa].
        bending: lowest and highest [J].

    Raises:
        InputError: a range that does not rise from above 0.
    """

    density: tuple[float, float] = (0.0434, 0.7)
    lame_mu: tuple[float, float] = (15909.0, 63636.0)
    lame_lambda: tuple[float, float] = (3535.41, 93333.74)
    bending: tuple[float, float] = (6.3708e-8, 1.31397e-3)

    def __post_init__(self) -> None:
        if any(not 0.0 < low <= high for low, high in asdict(self).values()):
            raise InputError("Each material range must be a lowest and a highest value above 0.")


@dataclass(frozen=True)
class TrainingConfiguration:
    """Configuration of a complete training.

    Args:
        network: network that is trained.
        data: garments, bodies and motions that it is trained on.
        curriculum: values that change over the budget.
        material: ranges from which cloth materials are drawn.
        batch: windows trained on together, over all devices.
        interleaved: number of windows that take turns, so that successive optimiser steps use different garments and
            motions; 1 finishes a window before the next, as in the released codes.
        seed: seed of the weights and of every sample.
        noise: standard deviation of noise on the positions of a window's first two frames [m].
        clearance: distance to the body that start positions are pushed out to [m].
        most_propagation_steps: K is drawn from 1 to this number at every step; 0 computes it from the resolution.
        after_settling: velocity after the settling step: "skinned"; "slowed", half to all of that, so that the data
            contain bodies that start to move; "zero"; or "carried" as in the released code.
        loss_weight: "joule", or "progress": relative to the energy decrease of the pass.
        inside_weight: weight of a second collision term in the loss, which begins at the skin [J/m^3]; 0 for none.
        statistics_windows: number of windows for the statistics that normalise the features.
        gradient_norm: largest norm of the gradient, in the unit of the loss; larger gradients are scaled down to it.
        ema_decay: decay of the averaged weights a step; the averaged weights are the result of a training.
        log_every: optimiser steps between lines.
        checkpoint_every: optimiser steps between checkpoints, which are written when all windows of a round have ended.
        validate_every: optimiser steps between validations, likewise.
        validation_clips: clips rolled out by a validation.
        validation_frames: frames of each.
        patience: validations without improvement after which the training stops; 0 never stops it.

    Raises:
        InputError: a value out of range.
    """

    network: NetworkConfiguration = field(default_factory=Pb4uConfiguration)
    data: DataSelection = field(default_factory=DataSelection)
    curriculum: Curriculum = field(default_factory=Curriculum)
    material: MaterialSampling = field(default_factory=MaterialSampling)
    batch: int = 1
    interleaved: int = 1
    seed: int = 0
    noise: float = 3e-3
    clearance: float = 2e-3
    most_propagation_steps: int = 28
    after_settling: str = "skinned"
    loss_weight: str = "joule"
    inside_weight: float = 0.0
    statistics_windows: int = 100
    gradient_norm: float = 1.0
    ema_decay: float = 0.999
    log_every: int = 100
    checkpoint_every: int = 1000
    validate_every: int = 2000
    validation_clips: int = 4
    validation_frames: int = 40
    patience: int = 0

    def __post_init__(self) -> None:
        for name in ("batch", "interleaved", "statistics_windows", "log_every", "checkpoint_every", "validate_every"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be 1 or more, not {getattr(self, name)}.")
        for name in ("noise", "clearance", "most_propagation_steps", "inside_weight", "patience", "seed"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} must not be below 0, but is {getattr(self, name)}.")
        if self.after_settling not in AFTER_SETTLING:
            raise InputError(f"after_settling must be one of {', '.join(AFTER_SETTLING)}, not {self.after_settling!r}.")
        if self.loss_weight not in LOSS_WEIGHTS:
            raise InputError(f"loss_weight must be one of {', '.join(LOSS_WEIGHTS)}, not {self.loss_weight!r}.")
        if self.validation_clips < 1 or self.validation_frames < 2:
            raise InputError("A validation needs 1 clip or more of 2 frames or more.")
        if not (self.gradient_norm > 0 and 0.0 <= self.ema_decay < 1.0):
            raise InputError("gradient_norm must be above 0, and ema_decay at least 0 and below 1.")


class TrainingPreset(NamedTuple):
    """A complete training.

    Args:
        configuration: its configuration.
        steps: optimiser steps if neither steps nor minutes are given.
    """

    configuration: TrainingConfiguration
    steps: int


TRAININGS: Registry[TrainingPreset] = Registry("training preset")
"""Complete trainings by name."""

_PARTS: dict[str, type] = {"data": DataSelection, "curriculum": Curriculum, "material": MaterialSampling}


def training_to_json(configuration: TrainingConfiguration) -> dict[str, Any]:
    """Plain JSON data of a training's configuration.

    Args:
        configuration: the configuration.
    """
    record = {entry.name: getattr(configuration, entry.name) for entry in fields(configuration)}
    record["network"] = configuration_to_json(configuration.network)
    return record | {name: asdict(record[name]) for name in _PARTS}


def training_from_json(record: Any) -> TrainingConfiguration:
    """Configuration that `training_to_json` wrote.

    Args:
        record: what `training_to_json` wrote.

    Raises:
        InputError: it is not a configuration of a training.
    """
    try:
        values = dict(record)
        values["network"] = configuration_from_json(values["network"])
        for name, kind in _PARTS.items():
            values[name] = kind(**{key: _tuples(value) for key, value in values[name].items()})
        return TrainingConfiguration(**values)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"The configuration of the training cannot be read: {error}") from error


def with_settings(configuration: TrainingConfiguration, settings: Sequence[str]) -> TrainingConfiguration:
    """Copy of a configuration with fields replaced by `KEY=VALUE` texts.

    Args:
        configuration: to be changed.
        settings: such as batch=2 or curriculum.learning_rate=1e-3; network=NAME replaces the network by a preset, and
            network.scaling=NAME the rule of update scaling.

    Raises:
        InputError: an unknown key (the message lists similar ones), or a value of another type.
    """
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals:
            raise InputError(f"--set takes KEY=VALUE, such as batch=2; {setting!r} has no =.")
        if key.strip() == "network":
            configuration = replace(configuration, network=NETWORKS.named(text.strip()))
            continue
        if key.strip() == "network.scaling":
            configuration = replace(configuration, network=_rescaled(configuration.network, text.strip()))
            continue
        configuration = _replaced(configuration, key.strip(), key.strip().split("."), text.strip())
    return configuration


def _rescaled(network: NetworkConfiguration, name: str) -> NetworkConfiguration:
    if not isinstance(network, Pb4uConfiguration):
        raise InputError(
            "network.scaling exists only for networks of Pb4U-GNet's family; this network has no update scaling."
        )
    refuse_unknown("scaling", [name], SCALINGS)
    return replace(network, scaling=with_scaling(network.scaling, name))


def _replaced(record: Any, key: str, path: list[str], text: str) -> Any:
    name, rest = path[0], path[1:]
    names = [entry.name for entry in fields(record)]
    if name not in names:
        raise unknown_name("setting", key, [key.removesuffix(name) + choice for choice in names])
    value = getattr(record, name)
    if is_dataclass(value):
        if not rest:
            inside = ", ".join(f"{key}.{entry.name}" for entry in fields(value))
            raise InputError(f"{key} has parts; set one of {inside}.")
        return replace(record, **{name: _replaced(value, key, rest, text)})
    if rest:
        raise InputError(f"There is no setting {key}; {name} has no parts.")
    parsed = _parsed(key, value, text)
    try:
        return replace(record, **{name: parsed})
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"{key} is {value!r} by default; {text!r} is of another shape.") from error


def _parsed(key: str, present: Any, text: str) -> Any:
    """`text` as a value of the type of `present`."""
    if isinstance(present, str):
        return text
    try:
        value = _tuples(ast.literal_eval(text))
    except (ValueError, SyntaxError):
        value = text
    if isinstance(present, tuple):
        if isinstance(value, str):
            value = tuple(part.strip() for part in value.split(",") if part.strip())
        elif not isinstance(value, tuple):
            value = (value,)
        # Empty tuples by default are of numbers.
        types = {type(entry) for entry in present} or {float}
        if all(_fits(entry, types) for entry in value):
            return value
    elif isinstance(value, int) and not isinstance(value, bool) and isinstance(present, float):
        return float(value)
    elif type(value) is type(present):
        return value
    raise InputError(f"{key} is {present!r} by default; {text!r} is of another type.")


def _fits(value: Any, types: set[type]) -> bool:
    return type(value) in types or (isinstance(value, int) and not isinstance(value, bool) and float in types)


def _tuples(value: Any) -> Any:
    return tuple(_tuples(entry) for entry in value) if isinstance(value, (list, tuple)) else value
