"""From a simulation to an animated mesh in Blender.

    python examples/06_into_blender.py --garment dress --motion dance
    blender --python dress_in_blender.py

Writes an OBJ and a PC2 point cache, the USD of garment and body where the "usd" extra is installed, and the lines
that load them. Other programs: USD opens in Houdini, Maya and Unreal; MDD and GLB are written in the same way.
"""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

import pb4u

SCRIPT = """\
import bpy

bpy.context.scene.render.fps = {fps}  # a point cache knows frames, not seconds
bpy.context.scene.frame_start, bpy.context.scene.frame_end = 0, {last}

# The garment: the OBJ gives faces and UVs, the cache moves its vertices.
bpy.ops.wm.obj_import(filepath={obj!r})
garment = bpy.context.selected_objects[0]
cache = garment.modifiers.new("simulation", "MESH_CACHE")
cache.cache_format = "PC2"
cache.filepath = {pc2!r}
cache.frame_start = 0
# Leave the axes of the modifier alone: the importer turned the object, not its vertices.
"""

USD_SCRIPT = """
# Garment and body in one file, animated as they are; the garment above is then there twice.
# bpy.ops.wm.usd_import(filepath={usd!r})
"""


def main() -> None:
    """Simulate, export, and show how to load it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trajectory", type=Path, help="an .npz that was saved before, instead of simulating")
    parser.add_argument("--garment", default="dress")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--triangles", type=int, default=2500)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--model", default="auto")
    parser.add_argument("--folder", type=Path, default=Path())
    options = parser.parse_args()

    if options.trajectory:
        trajectory = pb4u.Trajectory.open(options.trajectory)
    else:
        scene = pb4u.make_scene(
            options.garment, motion=options.motion, triangles=options.triangles, frames=options.frames
        )
        trajectory = pb4u.load_simulator(options.model).simulate(scene)

    stem = (options.folder / Path(trajectory.metadata["garment"]).stem).resolve()
    pc2 = pb4u.export_trajectory(trajectory, stem.with_suffix(".pc2"))  # and the OBJ that it moves, of the same name
    lines = SCRIPT.format(
        fps=round(trajectory.fps), last=trajectory.frame_count - 1, obj=str(pc2.with_suffix(".obj")), pc2=str(pc2)
    )
    if find_spec("pxr"):
        lines += USD_SCRIPT.format(usd=str(pb4u.export_trajectory(trajectory, stem.with_suffix(".usdc"))))
    script = stem.with_name(f"{stem.name}_in_blender.py")
    script.write_text(lines)
    print(lines)
    print(f"# Run these lines in Blender, or: blender --python {script}")


if __name__ == "__main__":
    try:
        main()
    except pb4u.Pb4uError as error:
        raise SystemExit(str(error)) from None
