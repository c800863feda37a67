"""Dress a body, let it walk, and save what the cloth does.

    python examples/00_simulate_and_save.py
    python examples/00_simulate_and_save.py --garment dress --body man --motion dance --frames 90

`pb4u assets` lists every built-in name.
"""

from __future__ import annotations

import argparse

import pb4u


def main() -> None:
    """Simulate one garment and write it in two formats."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--body", default="woman")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--model", default="auto", help="auto, a network, solver, skinning or newton")
    parser.add_argument("--out", default="walk", help="name of the files to write, without a suffix")
    options = parser.parse_args()

    # A scene is everything that a simulation needs: the garment cut for this body, and the body in motion.
    scene = pb4u.make_scene(
        options.garment, options.body, options.motion, triangles=options.triangles, frames=options.frames
    )

    # A simulator turns a scene into a trajectory. "auto" is the network of the package, refined by the solver.
    simulator = pb4u.load_simulator(options.model)
    trajectory = simulator.simulate(scene, lambda done, total: print(f"frame {done} of {total}", end="\r", flush=True))

    # A trajectory is plain arrays: metres, Y up, one row a frame.
    frames, vertices, _ = trajectory.positions.shape
    print(f"{simulator.name}: {frames} frames of {vertices} vertices, {len(trajectory.faces)} triangles")
    print(f"lowest point of the hem: {trajectory.positions[-1, :, 1].min():.3f} m above the ground")

    # The .npz holds everything and is read back with pb4u.Trajectory.open; the .glb opens in any 3D viewer.
    print("written:", trajectory.save(f"{options.out}.npz"), pb4u.export_trajectory(trajectory, f"{options.out}.glb"))


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
