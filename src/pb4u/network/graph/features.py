"""Every feature a graph can have: its width, unit, whether it is normalised, and where it comes from.

A `FeatureLayout` is an ordered choice of them; it is stored in a checkpoint, so a network always gets the columns that
it was trained with.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from pb4u.errors import InputError


@dataclass(frozen=True)
class Feature:
    """One named group of columns.

    Args:
        name: name in layouts.
        width: number of columns.
        unit: SI unit, "1" where it has none.
        normalised: whether running statistics centre and scale it.
        typical: usual spread, used until there are statistics; spreads below a hundredth of it are raised to that.
        source: meaning and origin of the definition; for the reader, so not compared.
    """

    name: str
    width: int
    unit: str
    normalised: bool
    typical: float
    source: str = field(compare=False)


def _index(*features: Feature) -> dict[str, Feature]:
    return {feature.name: feature for feature in features}


DT = Feature("dt", 1, "1", False, 1.0, "log(dt / (1/30 s)); a constant dt would leave a running spread of zero")

TIME_STEP = Feature("time_step", 1, "s", True, 0.1, "dt itself: the released networks")

NODE_FEATURES = _index(
    Feature("velocity", 3, "m/step", True, 1e-2, "garment: velocity x dt; body: now - previous frame (reference 1.2)"),
    Feature("velocity_ahead", 3, "m/step", True, 1e-2, "garment: velocity x dt; body: next frame - now (release)"),
    Feature("normal", 3, "1", True, 0.6, "area-weighted unit vertex normal (reference 1.2)"),
    Feature("areal_density", 1, "1", False, 1.0, "log areal density, [0, 1] over the training range; -1 on the body"),
    Feature("vertex_mass", 1, "log kg", True, 2.0, "log vertex mass, -1 on the body: released form (reference 1.2)"),
    Feature("material", 3, "1", False, 1.0, "bending, mu, lambda, [0, 1] over the training range; -1 on the body"),
    DT,
    TIME_STEP,
    Feature("mass", 1, "kg", True, 1e-4, "vertex mass, -1 on the body: the released ContourCraft"),
)

MESH_EDGE_FEATURES = _index(
    Feature("direction", 3, "1", True, 0.6, "unit vector from receiver to sender, now (paper, edge feature 1)"),
    Feature("rest_direction", 3, "1", True, 0.6, "the same at rest (paper, edge feature 2)"),
    Feature("length_ratio", 1, "1", True, 0.1, "length now / length at rest (paper, edge feature 3)"),
    DT,
    Feature("material", 3, "1", False, 1.0, "mean of both ends' bending, mu, lambda (reference 1.2, release)"),
    Feature("relative_position", 3, "m", True, 1e-2, "sender - receiver, now: fine15 and HOOD (reference 1.2)"),
    Feature("length", 1, "m", True, 1e-2, "its norm: fine15 and HOOD"),
    Feature("rest_relative_position", 3, "m", True, 1e-2, "sender - receiver at rest: fine15 and HOOD"),
    Feature("rest_length", 1, "m", True, 1e-2, "its norm: fine15 and HOOD"),
    TIME_STEP,
)

WORLD_EDGE_FEATURES = _index(
    Feature("direction", 3, "1", True, 0.6, "unit vector from receiver to sender, now (paper, edge feature 1)"),
    Feature(
        "relative_distance", 1, "1", True, 0.3, "distance now / radius of the world edges; no length at rest exists"
    ),
    Feature("relative_now", 3, "m", True, 1e-2, "receiver - sender, both now (reference 1.2)"),
    Feature("distance_now", 1, "m", True, 1e-2, "its norm"),
    Feature("relative_next", 3, "m", True, 1e-2, "receiver - sender, garment now and body next (reference 1.2)"),
    Feature("distance_next", 1, "m", True, 1e-2, "its norm"),
    Feature("relative_velocity", 3, "m/step", True, 1e-2, "garment's velocity - body's next one (reference 6.1)"),
    Feature("relative_speed", 1, "m/step", True, 1e-2, "its norm: ContourCraft"),
    DT,
    TIME_STEP,
)

FOUND_EDGE_FEATURES = _index(
    Feature("relative_position", 3, "m", True, 1e-2, "sender - receiver, now (reference 6.1)"),
    Feature("length", 1, "m", True, 1e-2, "its norm"),
    Feature("previous_relative_position", 3, "m", True, 1e-2, "sender - receiver, a step before"),
    Feature("previous_length", 1, "m", True, 1e-2, "its norm"),
    Feature("relative_velocity", 3, "m/step", True, 1e-2, "sender's velocity - receiver's"),
    Feature("relative_speed", 1, "m/step", True, 1e-2, "its norm"),
    DT,
    Feature("future_pinned", 1, "1", False, 1.0, "1 between where pinned and other vertices will be (release)"),
    Feature("material", 3, "1", False, 1.0, "mean of both ends' bending, mu, lambda"),
)

TABLES = {
    "node": NODE_FEATURES,
    "mesh_edge": MESH_EDGE_FEATURES,
    "world_edge": WORLD_EDGE_FEATURES,
    "found_edge": FOUND_EDGE_FEATURES,
}

DESCENT = Feature(
    "descent",
    3,
    "1",
    True,
    0.05,
    "Jacobi descent of the incremental potential where the pass starts, in edge lengths; ours",
)

ADVANCE = Feature("advance", 3, "cm/step^2", False, 1.0, "acceleration from free flight to where the pass starts; ours")


@dataclass(frozen=True)
class MaterialRange:
    """Ranges of material parameters that are mapped to [0, 1]: those of training (reference 1.7).

    Args:
        density: lowest and highest [kg/m^2].
        lame_mu: lowest and highest [Pa].
        lame_lambda: lowest and highest [Pa].
        bending: lowest and highest [J].
        margin: how far beyond [0, 1] values may be before they are clamped; None never clamps, like the released code.
    """

    density: tuple[float, float] = (0.0434, 0.7)
    lame_mu: tuple[float, float] = (15909.0, 63636.0)
    lame_lambda: tuple[float, float] = (3535.41, 93333.74)
    bending: tuple[float, float] = (6.3708e-8, 1.31397e-3)
    margin: float | None = 1.0


@dataclass(frozen=True)
class FeatureLayout:
    """Feature columns that a network gets as input, in order.

    Args:
        node: names from `NODE_FEATURES`.
        mesh_edge: names from `MESH_EDGE_FEATURES`.
        world_edge: names from `WORLD_EDGE_FEATURES`.
        extra: further node features, passed to the builder by name; zero on the body.
        material_range: ranges of material parameters that are mapped to [0, 1].
        found_edge: names from `FOUND_EDGE_FEATURES`, for edges found at every step between garment vertices that
            come near each other.

    Raises:
        InputError: a name that its table does not have.
    """

    node: tuple[str, ...] = ("velocity", "normal", "dt", "areal_density", "material")
    mesh_edge: tuple[str, ...] = ("direction", "rest_direction", "length_ratio", "dt", "material")
    world_edge: tuple[str, ...] = ("relative_now", "distance_now", "relative_next", "distance_next", "dt")
    extra: tuple[Feature, ...] = ()
    material_range: MaterialRange = field(default_factory=MaterialRange)
    found_edge: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for label, table in TABLES.items():
            for name in getattr(self, label):
                if name not in table:
                    raise InputError(f"There is no {label} feature {name!r}; there are: {', '.join(table)}.")

    def columns(self, table: str) -> tuple[Feature, ...]:
        """Chosen features of one of `TABLES`; for nodes with the extra ones.

        Args:
            table: one of `TABLES`.
        """
        chosen = tuple(TABLES[table][name] for name in getattr(self, table))
        return (*chosen, *self.extra) if table == "node" else chosen


def total_width(columns: tuple[Feature, ...]) -> int:
    """Number of columns of all features together.

    Args:
        columns: the features.
    """
    return sum(feature.width for feature in columns)


def map_log(values: Tensor, limits: tuple[float, float], margin: float | None = 1.0) -> Tensor:
    """Dimensionless values (...) on a log scale, limits[0] -> 0 and limits[1] -> 1, clamped.

    Args:
        values: (...) of any unit, 0 or more.
        limits: both above 0, in the unit of the values.
        margin: how far beyond [0, 1] values may be before they are clamped; None for no clamping.
    """
    low, high = (float(torch.tensor(limit, dtype=torch.float64).log()) for limit in limits)
    return _mapped(values.clamp_min(torch.finfo(values.dtype).tiny).log(), low, high, margin)


def map_linear(values: Tensor, limits: tuple[float, float], margin: float | None = 1.0) -> Tensor:
    """Dimensionless values (...) on a linear scale, limits[0] -> 0 and limits[1] -> 1, clamped.

    Args:
        values: (...) of any unit.
        limits: in the unit of the values.
        margin: how far beyond [0, 1] values may be before they are clamped; None for no clamping.
    """
    return _mapped(values, *limits, margin)


def _mapped(values: Tensor, low: float, high: float, margin: float | None) -> Tensor:
    if low == high:
        return torch.zeros_like(values)
    shares = (values - low) / (high - low)
    return shares if margin is None else shares.clamp(-margin, 1.0 + margin)
