"""Network configurations as JSON, and back: frozen dataclasses tagged with the name of their type.

The types that may be read are those registered and, from there, every dataclass that a field is annotated with.
"""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, Union, cast, get_args, get_origin, get_type_hints

from pb4u.errors import InputError
from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.registry import CONFIGURATIONS

RENAMED = {"carried_shares": "warm_start_shares"}
"""Fields that checkpoints of before know by another name."""


def configuration_to_json(configuration: NetworkConfiguration) -> dict[str, Any]:
    """Plain JSON data of a network configuration; each part names its type.

    Args:
        configuration: the configuration.
    """
    return cast(dict[str, Any], _encode(configuration))


def configuration_from_json(data: Any) -> NetworkConfiguration:
    """Network configuration that `configuration_to_json` wrote.

    Args:
        data: plain JSON data.

    Raises:
        InputError: a type or a field is unknown, or a value is refused.
    """
    decoded = _decode(data, _known_types(data))
    if not isinstance(decoded, NetworkConfiguration):
        raise InputError(f"The configuration describes a {type(decoded).__name__}, not a network.")
    return decoded


def _known_types(data: Any) -> dict[str, type]:
    """The dataclasses that a configuration of the kind of `data` is made of, by name; of an unknown kind, all."""
    name = data.get("type", "") if isinstance(data, dict) else ""
    types: dict[str, type] = {}
    waiting: list[Any] = [CONFIGURATIONS[name]] if name in CONFIGURATIONS else list(CONFIGURATIONS.values())
    while waiting:
        annotation = waiting.pop()
        waiting += get_args(annotation)
        if is_dataclass(annotation) and isinstance(annotation, type) and annotation.__name__ not in types:
            types[annotation.__name__] = annotation
            waiting += get_type_hints(annotation).values()
    return types


def _encode(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {
            "type": type(value).__name__,
            **{entry.name: _encode(getattr(value, entry.name)) for entry in fields(value)},
        }
    if isinstance(value, (tuple, list)):
        return [_encode(item) for item in value]
    return value


def _decode(data: Any, types: dict[str, type]) -> Any:
    if isinstance(data, list):
        return tuple(_decode(item, types) for item in data)
    if not isinstance(data, dict):
        return data
    name = data.get("type")
    if name not in types:
        raise InputError(f"The configuration has a part of unknown type {name!r}.")
    values = {RENAMED.get(str(key), str(key)): _decode(value, types) for key, value in data.items() if key != "type"}
    allowed = {entry.name for entry in fields(types[name])}
    unknown = sorted(set(values) - allowed)
    if unknown:
        raise InputError(f"The configuration's {name} has unknown fields: {', '.join(unknown)}.")
    hints = get_type_hints(types[name])
    for key, value in values.items():
        if not _fits(value, hints[key]):
            raise InputError(f"The configuration's {name} cannot have {key} = {str(value)[:60]}.")
    try:
        return types[name](**values)
    except (TypeError, ValueError) as error:
        raise InputError(f"The configuration's {name} cannot be made: {error}") from error


def _fits(value: Any, annotation: Any) -> bool:
    """Whether a decoded value is of the kind that a field is annotated with; a number has to be finite."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        return any(_fits(value, part) for part in parts)
    if origin is tuple:
        kinds = parts[:1] * len(value) if isinstance(value, tuple) and parts[1:] == (Ellipsis,) else parts
        return (
            isinstance(value, tuple)
            and len(value) == len(kinds)
            and all(_fits(entry, kind) for entry, kind in zip(value, kinds, strict=True))
        )
    if annotation is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if annotation is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, annotation) if isinstance(annotation, type) else True
