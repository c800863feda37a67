"""The drape test of a fabric: a disc of it hangs over a smaller one, and its shadow is measured.

A disc of 30 cm is held flat between two of 18 cm, as in Cusick's meter (BS 5058, ISO 9073-9), and what hangs over falls
freely by the solver. The drape coefficient is the share of the free ring that its shadow covers. What is published of a
fabric, or of its class, stands in `garment/data/drape_bands.json`, with its source; no value of a fabric is chosen by
what comes out here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import Delaunay

from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.garment import Garment
from pb4u.garment.material import DATA, Material
from pb4u.io.reading_limits import read_json
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord

RADIUS, HELD = 0.15, 0.09
"""Radii [m] of the disc and of what holds it."""

EDGE, SHORTEST, LONGEST = 0.014, 0.003, 0.03
"""Edge length of the triangles [m]: of a garment of 11,000, the least that is computed in minutes, and the most that
makes folds."""

_HEIGHT = 0.07
"""Of the disc above the ground [m], as far as the ring is wide and more."""

_CELL = 5e-4
"""Width [m] of a cell of the shadow."""


class Band(NamedTuple):
    """Range of drape coefficients published for a fabric or its class.

    Args:
        lowest: drape coefficient [%].
        highest: drape coefficient [%].
        source: who measured it.
    """

    lowest: float
    highest: float
    source: str


@cache
def published() -> dict[str, Band]:
    """Published ranges of the built-in fabrics, by name; fabrics without any are left out."""
    return {name: Band(**record) for name, record in read_json(DATA / "drape_bands.json").items()}


@dataclass(frozen=True, eq=False)
class DrapeTest:
    """Result of a drape test.

    Args:
        coefficient: share of the ring that its shadow covers [%].
        folds: wave number of the strongest wave of its rim.
        speed: of the fastest vertex at the end [m/s].
        iterations: of the solver, mean a step.
        unsolved: number of steps that did not reach the tolerance.
        seconds: that it took.
        draped: the disc at the end, one frame.
    """

    coefficient: float
    folds: int
    speed: float
    iterations: float
    unsolved: int
    seconds: float
    draped: Trajectory


def drape_test(material: Material, edge: float = EDGE, seconds: float = 3.0) -> DrapeTest:
    """Let a disc of a fabric fall.

    Args:
        material: of the disc.
        edge: length of its triangles' edges [m].
        seconds: how long it falls [s]; after three most discs are at rest.

    Raises:
        InputError: an edge length too long for folds, or so short that the test would take hours.
    """
    if not SHORTEST <= edge <= LONGEST:
        raise InputError(
            f"The mesh of a drape test must have edges of {1e3 * SHORTEST:g} to {1e3 * LONGEST:g} mm, not "
            f"{1e3 * edge:g}."
        )
    began, garment, frames = time.perf_counter(), disc(edge, material), round(30.0 * seconds)
    placement = PrescribedPlacement(np.broadcast_to(rippled(garment), (frames, *garment.vertices.shape)))
    scene = Scene((DressedGarment(garment, placement),), (), frames, environment=Environment(ground=None))
    # A rule of second order leaves a disc swinging for many seconds; what counts here is where it comes to rest.
    settles: dict[str, Any] = {"first_frame": "placed", "self_contact": True, "time_integration": "implicit-euler"}
    simulator, record = load_simulator("solver", **settles), RunRecord()
    fallen = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
    last = replace(
        fallen,
        positions=fallen.positions[-1:],
        velocities=fallen.velocities[-1:],
        body_positions=fallen.body_positions[-1:],
    )
    vertices = last.positions[0].astype(np.float64)
    clamped, sheet = np.pi * HELD**2, np.pi * RADIUS**2
    rim = np.flatnonzero(np.hypot(garment.vertices[:, 0], garment.vertices[:, 2]) > RADIUS - 1e-6)
    rim = rim[np.argsort(np.arctan2(-garment.vertices[rim, 2], garment.vertices[rim, 0]))]
    reach = np.hypot(vertices[rim, 0], vertices[rim, 2])
    waves = np.abs(np.fft.rfft(reach - reach.mean()))
    return DrapeTest(
        100.0 * (shadow(vertices, garment.faces) - clamped) / (sheet - clamped),
        int(waves[1:20].argmax()) + 1,
        float(np.linalg.norm(last.velocities[0], axis=1).max()),
        float(np.mean(record.solver_iterations)),
        record.unsolved,
        time.perf_counter() - began,
        last,
    )


def disc(edge: float, material: Material) -> Garment:
    """A flat disc with the warp along the z axis, pinned on its support.

    Args:
        edge: about the length of its triangles' edges [m].
        material: of the disc.
    """
    rows, height = int(RADIUS / edge) + 2, edge * np.sqrt(3.0) / 2.0
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(-2 * rows, 2 * rows), np.arange(-2 * rows, 2 * rows)))
    points = np.column_stack([edge * (i + 0.5 * (j % 2)), height * j])
    radius = np.hypot(*points.T)
    points = points[(radius < RADIUS - 0.55 * edge) & (np.abs(radius - HELD) > 0.45 * edge)]
    for ring in (HELD, RADIUS):
        turns = np.linspace(0.0, 2.0 * np.pi, round(2.0 * np.pi * ring / edge), endpoint=False)
        points = np.concatenate([points, ring * np.column_stack([np.cos(turns), np.sin(turns)])])
    faces = Delaunay(points).simplices.astype(np.int64)
    sides = np.diff(points[faces], axis=1)
    doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    faces[doubled < 0.0] = faces[doubled < 0.0][:, ::-1]
    faces = faces[np.abs(doubled) > 1e-3 * edge**2]
    vertices = np.column_stack([points[:, 0], np.full(len(points), _HEIGHT), -points[:, 1]])
    pinned = np.hypot(*points.T) <= HELD + 1e-6
    return Garment(
        "disc", vertices, faces, material, pinned, uvs=points + RADIUS, uv_faces=faces, rest_uv=points[faces]
    )


def rippled(garment: Garment) -> np.ndarray:
    """Where the disc starts (vertices, 3) [m]: with a faint ripple of every wave number, so that folds may choose.

    Args:
        garment: the disc.
    """
    draw, start = np.random.default_rng(1), garment.vertices.copy()
    turn, radius = np.arctan2(-start[:, 2], start[:, 0]), np.hypot(start[:, 0], start[:, 2])
    height = 2e-4 * draw.standard_normal(len(start))
    height += sum(3e-4 * np.cos(k * turn + draw.uniform(0.0, 2.0 * np.pi)) for k in range(2, 13))
    start[:, 1] += np.clip((radius - HELD) / (RADIUS - HELD), 0.0, 1.0) * height
    return start


def shadow(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Area [m^2] that covers the ground, seen from above.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
    """
    from PIL import Image, ImageDraw

    side = int(2.2 * RADIUS / _CELL)
    image = Image.new("1", (side, side))
    drawing, flat = ImageDraw.Draw(image), vertices[:, [0, 2]] / _CELL + 0.5 * side
    for face in faces:
        drawing.polygon([tuple(corner) for corner in flat[face]], fill=1)
    return float(np.asarray(image).sum()) * _CELL**2
