"""Resolution-adaptive garment simulation: any body, any garment, any triangle count.

The shortest useful program:

    import pb4u

    simulator = pb4u.load_simulator("solver")
    scene = pb4u.make_scene("tshirt", body="woman", motion="walk", triangles=5_000, frames=60)
    simulator.simulate(scene).save("walk.npz")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "Body": "pb4u.body.body_model:ShapedBody",
    "Garment": "pb4u.garment.garment:Garment",
    "InputError": "pb4u.errors:InputError",
    "Material": "pb4u.garment.material:Material",
    "Motion": "pb4u.motion.motion:Motion",
    "Pb4uError": "pb4u.errors:Pb4uError",
    "Run": "pb4u.run:Run",
    "Scene": "pb4u.scene.scene:Scene",
    "Simulator": "pb4u.simulation.simulator:Simulator",
    "Trajectory": "pb4u.scene.trajectory:Trajectory",
    "WornGarment": "pb4u.run:WornGarment",
    "build_garment": "pb4u.garment.library:build_garment",
    "export_trajectory": "pb4u.export.registry:export",
    "load_body": "pb4u.body.library:load_body",
    "load_motion": "pb4u.motion.library:load_motion",
    "load_simulator": "pb4u.simulation.models:load_simulator",
    "make_scene": "pb4u.scene.assembly:make_scene",
    "measure": "pb4u.measures.metrics:measure",
    "read_garment": "pb4u.garment.garment_file:read_garment",
}

__all__ = [
    "Body",
    "Garment",
    "InputError",
    "Material",
    "Motion",
    "Pb4uError",
    "Run",
    "Scene",
    "Simulator",
    "Trajectory",
    "WornGarment",
    "build_garment",
    "export_trajectory",
    "load_body",
    "load_motion",
    "load_simulator",
    "make_scene",
    "measure",
    "read_garment",
]

if TYPE_CHECKING:
    from pb4u.body.body_model import ShapedBody as Body
    from pb4u.body.library import load_body
    from pb4u.errors import InputError, Pb4uError
    from pb4u.export.registry import export as export_trajectory
    from pb4u.garment.garment import Garment
    from pb4u.garment.garment_file import read_garment
    from pb4u.garment.library import build_garment
    from pb4u.garment.material import Material
    from pb4u.measures.metrics import measure
    from pb4u.motion.library import load_motion
    from pb4u.motion.motion import Motion
    from pb4u.run import Run, WornGarment
    from pb4u.scene.assembly import make_scene
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Trajectory
    from pb4u.simulation.models import load_simulator
    from pb4u.simulation.simulator import Simulator


def __getattr__(name: str) -> Any:
    """Public names are imported when first used, so that `import pb4u` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'pb4u' has no attribute {name!r}")
    module, attribute = _HOMES[name].split(":")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
