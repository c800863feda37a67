"""How named fabrics drape: coefficient and folds of a disc on a disc, beside what is published.

    python benchmarks/fabrics.py [FABRIC ..] [--edges 6,14] [--seconds 3] [--json FILE]

A disc of 30 cm is held flat between two of 18 cm, as in Cusick's meter (BS 5058, ISO 9073-9), and what hangs over falls
freely by the solver. The drape coefficient is the share of the ring that its shadow covers. `drape_bands.json` holds
what is published of a fabric, or of its class, with the source; no value of a fabric is chosen by what comes out here.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

from pb4u.environment import Environment
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.garment import Garment
from pb4u.garment.material import FABRICS, Material, load_material
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.models import load_simulator
from pb4u.simulation.simulator import RunRecord

RADIUS, HELD = 0.15, 0.09
"""Radii [m] of the disc and of what holds it."""

BANDS = Path(__file__).parent / "drape_bands.json"

_CELL = 5e-4
"""Width [m] of a cell of the shadow."""


def disc(edge: float, material: Material) -> Garment:
    """A flat disc of triangles of about that edge length [m], its warp along the z axis, pinned where it is held."""
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
    vertices = np.column_stack([points[:, 0], np.zeros(len(points)), -points[:, 1]])
    pinned = np.hypot(*points.T) <= HELD + 1e-6
    return Garment("disc", vertices, faces, material, pinned, rest_uv=points[faces])


def rippled(garment: Garment) -> np.ndarray:
    """Where the disc starts (vertices, 3) [m]: with a faint ripple of every wave number, so that folds may choose."""
    draw, start = np.random.default_rng(1), garment.vertices.copy()
    turn, radius = np.arctan2(-start[:, 2], start[:, 0]), np.hypot(start[:, 0], start[:, 2])
    height = 2e-4 * draw.standard_normal(len(start))
    height += sum(3e-4 * np.cos(k * turn + draw.uniform(0.0, 2.0 * np.pi)) for k in range(2, 13))
    start[:, 1] += np.clip((radius - HELD) / (RADIUS - HELD), 0.0, 1.0) * height
    return start


def shadow(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Area [m^2] that covers the ground, seen from above."""
    from PIL import Image, ImageDraw

    side = int(2.2 * RADIUS / _CELL)
    image = Image.new("1", (side, side))
    drawing, flat = ImageDraw.Draw(image), vertices[:, [0, 2]] / _CELL + 0.5 * side
    for face in faces:
        drawing.polygon([tuple(corner) for corner in flat[face]], fill=1)
    return float(np.asarray(image).sum()) * _CELL**2


@dataclass(frozen=True)
class Draped:
    """What a disc has come to.

    Args:
        coefficient: share of the ring that its shadow covers [%].
        folds: wave number of the strongest wave of its rim.
        speed: of the fastest vertex at the end [m/s].
        iterations: of the solver, mean a step.
        unsolved: steps that were left short of the tolerance.
        seconds: that it took.
    """

    coefficient: float
    folds: int
    speed: float
    iterations: float
    unsolved: int
    seconds: float


def draped(material: Material, edge: float, seconds: float) -> Draped:
    """Let a disc fall for so many seconds."""
    began, garment, frames = time.perf_counter(), disc(edge, material), round(30.0 * seconds)
    placement = PrescribedPlacement(np.broadcast_to(rippled(garment), (frames, *garment.vertices.shape)))
    scene = Scene((DressedGarment(garment, placement),), (), frames, environment=Environment(ground=None))
    simulator, record = load_simulator("solver", first_frame="placed", self_contact=True), RunRecord()
    trajectory = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
    vertices = trajectory.positions[-1].astype(np.float64)
    held, whole = np.pi * HELD**2, np.pi * RADIUS**2
    rim = np.flatnonzero(np.hypot(garment.vertices[:, 0], garment.vertices[:, 2]) > RADIUS - 1e-6)
    rim = rim[np.argsort(np.arctan2(-garment.vertices[rim, 2], garment.vertices[rim, 0]))]
    reach = np.hypot(vertices[rim, 0], vertices[rim, 2])
    waves = np.abs(np.fft.rfft(reach - reach.mean()))
    return Draped(
        100.0 * (shadow(vertices, garment.faces) - held) / (whole - held),
        int(waves[1:20].argmax()) + 1,
        float(np.linalg.norm(trajectory.velocities[-1], axis=1).max()),
        float(np.mean(record.solver_iterations)),
        record.unsolved,
        time.perf_counter() - began,
    )


def main() -> None:
    """Print a row a fabric and edge length."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("fabrics", nargs="*", default=list(FABRICS), help="names or material files; all by default")
    parser.add_argument("--edges", default="6,14", help="edge lengths [mm]")
    parser.add_argument("--seconds", type=float, default=3.0, help="simulated for each")
    parser.add_argument("--json", type=Path, help="file for the rows")
    options = parser.parse_args()
    bands, rows = json.loads(BANDS.read_text()), []
    print("fabric | edge mm | drape coefficient % | folds | published % | fastest mm/s | iterations | unsolved | s")
    for name in options.fabrics:
        for edge in map(float, options.edges.split(",")):
            found, band = draped(load_material(name), 1e-3 * edge, options.seconds), bands.get(name)
            published = f"{band['lowest']:g}-{band['highest']:g}" if band else "-"
            rows.append({"fabric": name, "edge_mm": edge, "published": band, **vars(found)})
            print(
                f"{name} | {edge:g} | {found.coefficient:.1f} | {found.folds} | {published} | "
                f"{1e3 * found.speed:.0f} | {found.iterations:.1f} | {found.unsolved} | {found.seconds:.0f}",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
