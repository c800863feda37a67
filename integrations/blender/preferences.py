"""The add-on's preferences: where pb4u is, and the button that installs it."""

import json
from pathlib import Path

import bpy

from .environment import find_command


class Preferences(bpy.types.AddonPreferences):
    """Where pb4u is, and what it was found to offer."""

    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="Command",
        description="The pb4u command, or the folder of the environment it is in; empty to let the add-on find it",
        subtype="FILE_PATH",
    )
    source: bpy.props.StringProperty(
        name="Install from",
        description="What pip installs: the name in the package index, or a wheel, a folder or an address of your own",
        default="pb4u",
    )
    status: bpy.props.StringProperty(options={"SKIP_SAVE"})
    offered: bpy.props.StringProperty(description="Names of materials and models as pb4u told them, in JSON")

    def known(self, kind):
        return json.loads(self.offered or "{}").get(kind, [])

    def draw(self, _context):
        layout = self.layout
        layout.prop(self, "command")
        row = layout.row()
        row.operator("pb4u.find")
        box = layout.box()
        box.prop(self, "source")
        for line in (
            f"Install makes a Python environment in {environment_folder()}",
            f"and runs `pip install {self.source}` there: about 1 GB with PyTorch, from the network.",
            "Blender's own Python is left as it is.",
        ):
            box.label(text=line)
        box.operator("pb4u.install")
        if self.status:
            layout.label(text=self.status)


def preferences(context):
    """The add-on's preferences."""
    return context.preferences.addons[__package__].preferences


def environment_folder(create=False):
    """Folder of the environment that the add-on makes; it outlives updates of the add-on."""
    return Path(bpy.utils.extension_path_user(__package__, path="", create=create)) / "environment"


def command(context):
    """The `pb4u` command.

    Raises:
        PlainError: it is not there.
    """
    chosen = preferences(context).command
    return find_command(bpy.path.abspath(chosen) if chosen else "", environment_folder())
