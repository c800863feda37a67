"""One garment at several triangle counts: what changes, and what a frame costs.

    python examples/03_choose_a_resolution.py
    python examples/03_choose_a_resolution.py --model pb4u-light
    python examples/03_choose_a_resolution.py --garment dress --triangles 2500 11000 25000

A Pb4U network takes K propagation steps, K = D / mean edge length: a finer mesh gets more of them, so that a push
travels the same way over the cloth at every count. The solver and skinning have no K.
"""

from __future__ import annotations

import argparse

import pb4u
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord


def main() -> None:
    """Simulate the same scene at each count and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, nargs="+", default=[1000, 2500, 5000])
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--out", default="resolution", help="beginning of the names of the files to write")
    options = parser.parse_args()

    simulator = pb4u.load_simulator(options.model)
    print(f"{options.garment} on {options.motion}, {simulator.name}")
    print("triangles  mean edge     K  ms a step  strain p95  penetration")
    for triangles in options.triangles:
        scene = pb4u.make_scene(options.garment, motion=options.motion, triangles=triangles, frames=options.frames)

        # written_frames yields frames as they are simulated; the record notes what each step took.
        record = RunRecord()
        trajectory = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
        trajectory.save(f"{options.out}_{triangles}.npz")

        garment, metrics = scene.garments[0].garment, pb4u.measure(trajectory)["metrics"]
        steps = simulator.propagation_steps(scene)
        print(
            f"{garment.triangle_count:9d}  {1000 * garment.mean_edge_length:6.1f} mm  {steps or '-':>4}  "
            f"{record.ms_per_step:9.1f}  {metrics['strain_p95']['mean']:10.3f}  "
            f"{metrics['penetration_percent']['mean']:9.2f} %"
        )


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
