"""How good is a model? Beside it, the solver: the same physics energies, minimised every frame.

    python examples/05_compare_with_the_solver.py
    python examples/05_compare_with_the_solver.py --model skinning --garment dress --motion dance
    python examples/05_compare_with_the_solver.py --model runs/small/best.safetensors

The solver's energy is a floor: what nothing that obeys the same physics gets far below.
"""

from __future__ import annotations

import argparse

import numpy as np

import pb4u
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord, Simulator


def timed(simulator: Simulator, scene: pb4u.Scene) -> tuple[Trajectory, float]:
    """The trajectory, and the milliseconds that a step of it took."""
    record = RunRecord()
    frames = simulator.written_frames(scene, record)
    return Trajectory.collect(simulator.header(scene), frames), record.ms_per_step


def main() -> None:
    """Simulate one scene twice and print the two side by side."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="pb4u-light")
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--lead-in", type=int, default=30)
    parser.add_argument("--out", default="compared", help="beginning of the names of the files to write")
    options = parser.parse_args()

    # Bare, so that the model itself is judged: by default a few solver iterations polish every step of a network.
    model, solver = pb4u.load_simulator(options.model, refine=0), pb4u.load_simulator("solver")
    if model.name == solver.name:
        print("This compares the solver with itself; try --model pb4u-light or --model skinning.")
    scene = pb4u.make_scene(
        options.garment,
        motion=options.motion,
        triangles=options.triangles,
        frames=options.frames,
        lead_in=options.lead_in,
        fps=model.fps or 30.0,  # a network runs at the frame rate it was trained at
    )
    (ours, our_time), (floor, floor_time) = timed(model, scene), timed(solver, scene)
    mine, least = pb4u.measure(ours)["metrics"], pb4u.measure(floor)["metrics"]

    print(f"{'':>22} {model.name:>12} {'solver':>12}")
    print(f"{'ms a step':>22} {our_time:12.1f} {floor_time:12.1f}")
    for term in ("stretch", "bending", "collision", "gravity", "friction", "inertia", "total"):
        print(f"{term + ' [J]':>22} {mine[term]['mean']:12.4f} {least[term]['mean']:12.4f}")
    for name in ("strain_p95", "penetration_percent"):
        print(f"{name:>22} {mine[name]['mean']:12.4f} {least[name]['mean']:12.4f}")
    apart = np.linalg.norm(ours.positions - floor.positions, axis=-1)
    print(f"vertices are {1000 * apart.mean():.1f} mm apart on average, {1000 * apart.max():.0f} mm at most")
    print("written:", ours.save(f"{options.out}_model.npz"), floor.save(f"{options.out}_solver.npz"))


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
