"""The same dress of different cloths, built in and of your own.

    python examples/04_change_the_material.py
    python examples/04_change_the_material.py --garment skirt --materials silk leather my_cloth.json

A JSON file has the fields of pb4u.Material; `pb4u assets write silk silk.json` writes one to start from.
"""

from __future__ import annotations

import argparse

import numpy as np

import pb4u


def main() -> None:
    """Simulate the garment once for each material."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--garment", default="dress")
    parser.add_argument("--motion", default="turn")
    parser.add_argument("--materials", nargs="+", default=["silk", "denim"])
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--out", default="cloth", help="beginning of the names of the files to write")
    options = parser.parse_args()

    # SI units throughout: kg/m^2, pascals, joules, metres. This one is heavy, soft in its plane, stiff to bend, and
    # alike in all directions.
    felt = pb4u.Material.isotropic(density=0.5, lame_mu=15_000.0, lame_lambda=20_000.0, bending=5e-4, thickness=2e-3)
    cloths: dict[str, str | pb4u.Material] = {name: name for name in options.materials}
    cloths["felt"] = felt

    simulator = pb4u.load_simulator(options.model)
    print(f"{options.garment} on {options.motion}, {simulator.name}")
    for name, material in cloths.items():
        scene = pb4u.make_scene(
            options.garment,
            motion=options.motion,
            material=material,
            triangles=options.triangles,
            frames=options.frames,
        )
        garment = scene.garments[0].garment
        trajectory = simulator.simulate(scene)

        # How far the cloth swings: the spread of the lowest tenth of its vertices, over the whole clip.
        low = trajectory.positions[:, np.argsort(garment.vertices[:, 1])[: len(garment.vertices) // 10]]
        spread = np.linalg.norm(np.ptp(low, axis=1)[:, [0, 2]], axis=1).max()
        stem = f"{options.out}_{name.removesuffix('.json').replace('/', '_')}"
        print(
            f"{name:>10}: {1000 * garment.vertex_masses.sum():4.0f} g, hem at {low[..., 1].mean():.3f} m, at most "
            f"{spread:.2f} m wide, written {trajectory.save(f'{stem}.npz')}"
        )


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
