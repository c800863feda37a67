"""Simulate garments with pb4u from Blender: the panel "pb4u" in the sidebar of the 3D view.

Blender needs nothing but this folder. The simulation is the `pb4u` command of a Python environment of its own, which
reads the scene from files and writes frames that are played on the artist's meshes as they are computed.
"""

import bpy

from . import operators, panels, preferences, properties
from .job import end_running

_CLASSES = (*properties.CLASSES, preferences.Preferences, *operators.CLASSES, *panels.CLASSES)


@bpy.app.handlers.persistent
def _end_with_the_file(*_):
    end_running()


def register():
    """Make the add-on's parts known to Blender."""
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.pb4u = bpy.props.PointerProperty(type=properties.SceneSettings)
    bpy.app.handlers.load_pre.append(_end_with_the_file)


def unregister():
    """Take them back; a run under way ends."""
    end_running()
    bpy.app.handlers.load_pre.remove(_end_with_the_file)
    del bpy.types.Scene.pb4u
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
