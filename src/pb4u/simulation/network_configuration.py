"""Network configurations as JSON, and back: frozen dataclasses by name, from a fixed list of types."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, cast

from pb4u.baselines.contact_losses import ContourLength, Ramp, Repulsion
from pb4u.baselines.contourcraft import ContourCraftConfiguration
from pb4u.baselines.eslr import EslrConfiguration
from pb4u.baselines.hood import HoodConfiguration, LevelsByHops, LevelsByLength
from pb4u.baselines.meshgraphnet import MeshGraphNetConfiguration
from pb4u.errors import InputError
from pb4u.graph.features import Feature, FeatureLayout, MaterialRange
from pb4u.graph.world_edges import WorldEdgeRule
from pb4u.model.pb4u_gnet import Pb4uConfiguration
from pb4u.model.propagation import PropagationForm
from pb4u.model.propagation_control import ConstantDistance, FixedSteps
from pb4u.model.update_scaling import MeanScaling, NoScaling, PerVertexScaling
from pb4u.nn.acceleration_model import NetworkConfiguration

NETWORK_TYPES: tuple[type, ...] = (
    Pb4uConfiguration,
    MeshGraphNetConfiguration,
    HoodConfiguration,
    EslrConfiguration,
    ContourCraftConfiguration,
)

PART_TYPES: tuple[type, ...] = (
    FeatureLayout,
    Feature,
    MaterialRange,
    WorldEdgeRule,
    PropagationForm,
    ConstantDistance,
    FixedSteps,
    PerVertexScaling,
    MeanScaling,
    NoScaling,
    LevelsByHops,
    LevelsByLength,
    Ramp,
    Repulsion,
    ContourLength,
)


def configuration_to_json(configuration: NetworkConfiguration) -> dict[str, Any]:
    """`configuration` as plain JSON data; each part names its type."""
    return cast(dict[str, Any], _encode(configuration))


def configuration_from_json(data: Any) -> NetworkConfiguration:
    """The configuration that `configuration_to_json` wrote.

    Raises InputError where a type or a field is unknown or a value is refused.
    """
    decoded = _decode(data)
    if not isinstance(decoded, NETWORK_TYPES):
        raise InputError(f"The configuration describes a {type(decoded).__name__}, not a network.")
    return cast(NetworkConfiguration, decoded)


def _encode(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {
            "type": type(value).__name__,
            **{entry.name: _encode(getattr(value, entry.name)) for entry in fields(value)},
        }
    if isinstance(value, (tuple, list)):
        return [_encode(item) for item in value]
    return value


def _decode(data: Any) -> Any:
    if isinstance(data, list):
        return tuple(_decode(item) for item in data)
    if not isinstance(data, dict):
        return data
    known = {kind.__name__: kind for kind in (*NETWORK_TYPES, *PART_TYPES)}
    name = data.get("type")
    if name not in known:
        raise InputError(f"The configuration holds a part of unknown type {name!r}.")
    given = {key: _decode(value) for key, value in data.items() if key != "type"}
    allowed = {entry.name for entry in fields(known[name])}
    unknown = sorted(set(given) - allowed)
    if unknown:
        raise InputError(f"The configuration's {name} has unknown fields: {', '.join(unknown)}.")
    try:
        return known[name](**given)
    except (TypeError, ValueError) as error:
        raise InputError(f"The configuration's {name} cannot be made: {error}") from error
