"""Scenes that the released code was run on, as garments, bodies and time steps of ours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pb4u.environment import Environment
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.network.graph.builder import FoundEdges
from pb4u.network.graph.graph import BODY, GARMENT, Graph
from pb4u.network.graph.incidence import incidence
from pb4u.network.graph.pins import SeenGarments
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.colliders import ColliderFrame, PackedColliders, pack_colliders
from pb4u.scene.packed import pack
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import Checkpoint
from pb4u.simulation.network_pass import NetworkPass, StepFeatures

# Columns that the released code normalises, by the table of ours that holds them.
NODE = {"velocity": 3, "type": 9, "level": 4, "normal": 3, "time_step": 1, "vertex_mass": 1, "material": 3}
MESH = {
    "relative_position": 3,
    "length": 1,
    "rest_relative_position": 3,
    "rest_length": 1,
    "time_step": 1,
    "material": 3,
}
RELATIVE_MESH = {"direction": 3, "rest_direction": 3, "length_ratio": 1, "time_step": 1, "material": 3}
WORLD = {"relative_now": 3, "distance_now": 1, "relative_next": 3, "distance_next": 1, "time_step": 1}


class GoldenScene:
    """One network on one garment, in one of the two materials.

    Args:
        file: of the golden data.
        case: number of the material.
    """

    def __init__(self, file: Path, case: int) -> None:
        with np.load(file) as data:
            self.data = {key: data[key] for key in data.files}
        self.case = case
        density, mu, lam, bending = (float(value) for value in self.data[f"case{case}/material"])
        levels = sorted(key for key in self.data if key.startswith("scene/coarse_edge_index_"))
        coarse = tuple(_undirected(self.data[key]) for key in levels)
        self.garment = Garment(
            file.stem,
            self.data["scene/rest_pos"].astype(np.float64),
            self.data["scene/faces"].astype(np.int64),
            Material.isotropic(density, mu, lam, bending),
            self.data["scene/node_type"].reshape(-1) == 3,
            **({"coarse_edges": coarse} if coarse else {}),
        )
        contact = torch.from_numpy(self.data["scene/body_vertex_type"] != 2)
        faces = torch.from_numpy(self.data["scene/body_faces"].astype(np.int64))
        self.colliders: PackedColliders = pack_colliders([faces], [contact], [0])

    @classmethod
    def cases(cls, file: Path) -> list[GoldenScene]:
        """The scene in every material that the file has it in."""
        with np.load(file) as data:
            count = sum(key.endswith("/material") for key in data.files)
        return [cls(file, case) for case in range(count)]

    def value(self, step: int, name: str) -> np.ndarray:
        return self.data[f"case{self.case}/step{step}/{name}"]

    def has(self, step: int, name: str) -> bool:
        return f"case{self.case}/step{step}/{name}" in self.data

    @property
    def steps(self) -> range:
        return range(sum(key.startswith(f"case{self.case}/") and key.endswith("pred_pos") for key in self.data))

    def time_step(self, number: int, dtype: torch.dtype = torch.float64) -> TimeStep:
        """A step of the released rollout as it begins there."""
        garments = pack([self.garment], dtype)
        dt = float(self.value(number, "timestep"))
        at = {
            name: torch.from_numpy(self.value(number, name).astype(np.float64)).to(dtype)
            for name in ("pos", "prev_pos", "target_pos", "body_pos", "body_prev_pos", "body_target_pos")
        }
        # Where the network makes the velocity itself, it is now - previous.
        carried = torch.from_numpy(self.value(number, "velocity")).to(dtype) if self.has(number, "velocity") else None
        velocity = at["pos"] - at["prev_pos"] if carried is None else carried
        poses = (self.colliders.pose(at[name]) for name in ("body_prev_pos", "body_pos", "body_target_pos"))
        state = State(at["pos"], velocity / dt, number)
        return TimeStep(garments, state, ColliderFrame(*poses), dt, Environment((0, 0, 0)), at["target_pos"])


class GoldenEdges:
    """Finds the edges of self-contact that the released ContourCraft found.

    Args:
        scene: the golden one.
        step: number of the step.
    """

    def __init__(self, scene: GoldenScene, step: int) -> None:
        self.scene, self.step = scene, step

    def found(self, seen: SeenGarments) -> dict[str, FoundEdges]:
        count, edges = len(seen.positions), {}
        for kind in ("repulsion", "attraction"):
            sender, receiver = self.scene.value(self.step, f"{kind}_edge_index").astype(np.int64)
            order = np.argsort(receiver, kind="stable")
            ends = (incidence(torch.from_numpy(index[order]), count) for index in (sender, receiver))
            future = torch.from_numpy(self.scene.value(self.step, f"{kind}_label")[order])
            edges[kind] = FoundEdges(*ends, future.to(seen.positions)[:, None])
        return edges


def predicted(checkpoint: Checkpoint, step: TimeStep) -> tuple[Graph, Tensor, State]:
    """Graph that the network sees, its accelerations (vertices, 3) and the state after the step."""
    prepared = checkpoint.model.prepare(step.garments, dtype=step.garments.dtype)
    network = NetworkPass(checkpoint.model, prepared, StepFeatures(prepared, IncrementalPotential()))
    nothing = torch.zeros_like(step.state.positions)
    with torch.no_grad():
        acceleration = network.correction(step, nothing)
        return network.graph(step, nothing), acceleration, integrate(step, acceleration)


def columns(graph: Graph, checkpoint: Checkpoint, rows: str) -> Iterator[tuple[str, Tensor]]:
    """Columns that the encoder of nodes is fed, by name, cloth before body."""
    network, layout = checkpoint.model.network, checkpoint.model.network.configuration.layout
    sets = [graph.nodes[name] for name in (GARMENT, BODY) if name in graph.nodes]
    table = layout.columns(rows)
    parts = torch.split(torch.cat([each.features for each in sets]), [feature.width for feature in table], dim=1)
    for feature, values in zip(table, parts, strict=True):
        yield feature.name.removesuffix("_ahead"), values
    yield "type", network.node_type(torch.cat([each.types for each in sets]))


def _undirected(index: np.ndarray) -> np.ndarray:
    pairs = index.T.astype(np.int64)
    return np.unique(np.sort(pairs, axis=1), axis=0)
