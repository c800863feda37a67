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

from pb4u.registry import PROVIDERS

__version__ = "1.0.0"

_HOMES = {
    "AnimatedBody": "pb4u.body.animated_body:AnimatedBody",
    "Body": "pb4u.body.body_model:ShapedBody",
    "DressedGarment": "pb4u.scene.scene:DressedGarment",
    "Environment": "pb4u.environment:Environment",
    "Frame": "pb4u.scene.trajectory:Frame",
    "Garment": "pb4u.garment.garment:Garment",
    "GarmentSkinning": "pb4u.garment.garment:GarmentSkinning",
    "InputError": "pb4u.errors:InputError",
    "InputWarning": "pb4u.errors:InputWarning",
    "Interrupted": "pb4u.errors:Interrupted",
    "Material": "pb4u.garment.material:Material",
    "Motion": "pb4u.motion.motion:Motion",
    "Panel": "pb4u.pattern.pattern:Panel",
    "Pattern": "pb4u.pattern.pattern:Pattern",
    "Pb4uError": "pb4u.errors:Pb4uError",
    "PolygonMesh": "pb4u.geometry.mesh_file:PolygonMesh",
    "Progress": "pb4u.progress:Progress",
    "Run": "pb4u.run:Run",
    "RunRecord": "pb4u.simulation.simulator:RunRecord",
    "Scene": "pb4u.scene.scene:Scene",
    "Seam": "pb4u.pattern.pattern:Seam",
    "Simulator": "pb4u.simulation.simulator:Simulator",
    "SourceMap": "pb4u.garment.garment:SourceMap",
    "State": "pb4u.scene.state:State",
    "Trajectory": "pb4u.scene.trajectory:Trajectory",
    "TrajectoryHeader": "pb4u.scene.trajectory:TrajectoryHeader",
    "VertexSequence": "pb4u.body.vertex_sequence:VertexSequence",
    "View": "pb4u.export.view:View",
    "WornGarment": "pb4u.run:WornGarment",
    "body_from_arrays": "pb4u.body.vertex_sequence:body_from_arrays",
    "build_garment": "pb4u.garment.library:build_garment",
    "dress": "pb4u.pattern.dressing:dress",
    "export_trajectory": "pb4u.export.registry:export",
    "load_body": "pb4u.body.library:load_body",
    "load_motion": "pb4u.motion.library:load_motion",
    "load_simulator": "pb4u.simulation.models:load_simulator",
    "make_scene": "pb4u.scene.assembly:make_scene",
    "measure": "pb4u.measures.metrics:measure",
    "read_garment": "pb4u.garment.garment_file:read_garment",
    "read_pattern": "pb4u.pattern.files:read_pattern",
    "no_progress": "pb4u.progress:no_progress",
}

__all__ = list(_HOMES)

PROVIDERS |= {
    "network configuration": ("pb4u.paper.network_presets",),
    "network preset": ("pb4u.paper.network_presets",),
    "training preset": ("pb4u.paper.training_presets",),
    "trainable network": ("pb4u.paper.training_presets",),
    "control": ("pb4u.paper.controls",),
    "first frame": ("pb4u.compat.first_frames",),
    "kind of weights": ("pb4u.compat.released_weights",),
    "dictionary of garments": ("pb4u.compat.garment_dictionary",),
    "recording as recorded": ("pb4u.compat.recording_as_released",),
    "format": ("pb4u.compat",),
}
"""Who registers what; here, above all layers, so that none below names research."""

if TYPE_CHECKING:
    from pb4u.body.animated_body import AnimatedBody as AnimatedBody
    from pb4u.body.body_model import ShapedBody
    from pb4u.body.library import load_body as load_body
    from pb4u.body.vertex_sequence import VertexSequence as VertexSequence, body_from_arrays as body_from_arrays
    from pb4u.environment import Environment as Environment
    from pb4u.errors import (
        InputError as InputError,
        InputWarning as InputWarning,
        Interrupted as Interrupted,
        Pb4uError as Pb4uError,
    )
    from pb4u.export.registry import export
    from pb4u.export.view import View as View
    from pb4u.garment.garment import Garment as Garment, GarmentSkinning as GarmentSkinning, SourceMap as SourceMap
    from pb4u.garment.garment_file import read_garment as read_garment
    from pb4u.garment.library import build_garment as build_garment
    from pb4u.garment.material import Material as Material
    from pb4u.geometry.mesh_file import PolygonMesh as PolygonMesh
    from pb4u.measures.metrics import measure as measure
    from pb4u.motion.library import load_motion as load_motion
    from pb4u.motion.motion import Motion as Motion
    from pb4u.pattern.dressing import dress as dress
    from pb4u.pattern.files import read_pattern as read_pattern
    from pb4u.pattern.pattern import Panel as Panel, Pattern as Pattern, Seam as Seam
    from pb4u.progress import Progress as Progress, no_progress as no_progress
    from pb4u.run import Run as Run, WornGarment as WornGarment
    from pb4u.scene.assembly import make_scene as make_scene
    from pb4u.scene.scene import DressedGarment as DressedGarment, Scene as Scene
    from pb4u.scene.state import State as State
    from pb4u.scene.trajectory import Frame as Frame, Trajectory as Trajectory, TrajectoryHeader as TrajectoryHeader
    from pb4u.simulation.models import load_simulator as load_simulator
    from pb4u.simulation.simulator import RunRecord as RunRecord, Simulator as Simulator

    Body = ShapedBody
    export_trajectory = export


def __getattr__(name: str) -> Any:
    """Public names are imported when first used, so that `import pb4u` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'pb4u' has no attribute {name!r}")
    module, attribute = _HOMES[name].split(":")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
