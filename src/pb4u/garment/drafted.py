"""Built-in garments that are drafted from a body's measures and sewn around it: what each is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Drafted:
    """A garment that is sewn of a pattern drafted by measure.

    Args:
        fabric: default fabric, a name of `FABRICS`.
        parts: parts of two layers: beginning of their panels' names -> interfacing [N m].
        pins: name of the pinned vertices, as `resolve_pins` takes it.
    """

    fabric: str
    parts: Mapping[str, float] = field(default_factory=dict)
    pins: str = "none"


DRAFTED: dict[str, Drafted] = {
    "shirt": Drafted("cotton-poplin", {"stand": 1e-4, "fall": 5e-5, "placket": 5e-5, "cuff": 1e-4}),
    "jeans": Drafted("denim-11oz", {"band": 2e-4}, pins="waist"),
    "circle_dress": Drafted("viscose"),
}
