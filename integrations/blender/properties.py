"""What a scene keeps of its simulation: garments, body, options, findings."""

import bpy

from .environment import PlainError


def _suggested(kind):
    """Names of a kind that pb4u told when it was last found, for the search of a text field."""

    def search(_self, context, edit_text):
        from .preferences import preferences

        return [name for name in preferences(context).known(kind) if edit_text.lower() in name]

    return search


def _is_mesh(_self, each):
    return each.type == "MESH"


def _is_body(_self, each):
    return each.type in ("MESH", "ARMATURE")


class GarmentEntry(bpy.types.PropertyGroup):
    """A garment in the list."""

    object: bpy.props.PointerProperty(type=bpy.types.Object, name="Garment", poll=_is_mesh)
    material: bpy.props.StringProperty(
        name="Material",
        description="Built-in material, or a JSON file in SI units; empty for pb4u's default",
        search=_suggested("materials"),
        search_options={"SUGGESTION"},
    )
    parts: bpy.props.StringProperty(
        name="Parts",
        description="Materials of bands along its borders (hem, waist, cuff, collar, border), such as "
        "hem=denim, collar=rib; empty for none",
    )
    own_triangles: bpy.props.BoolProperty(
        name="Triangles",
        description="Simulate an even mesh of this many triangles; otherwise the garment's own faces",
    )
    triangles: bpy.props.IntProperty(name="Triangles", default=5000, min=100, max=1_000_000)
    pins: bpy.props.StringProperty(
        name="Pins", description="Vertex group whose vertices, of a weight of 0.5 or more, follow the body"
    )
    springs: bpy.props.BoolProperty(name="Give way", description="Hold the pins by springs; otherwise exactly")
    pin_stiffness: bpy.props.FloatProperty(
        name="Stiffness", description="Of the springs of all pins together [N/m]", default=300.0, min=1.0, max=1e7
    )
    lets_go: bpy.props.BoolProperty(name="Let go", description="Let the pins go at a frame")
    pins_until: bpy.props.IntProperty(name="Frame", description="Of the scene, from which pins let go", default=50)
    tucked: bpy.props.BoolProperty(
        name="Tucked in", description="Goes into what is worn from the waist, such as trousers"
    )


class FindingEntry(bpy.types.PropertyGroup):
    """A finding of the doctor."""

    object: bpy.props.StringProperty()
    severity: bpy.props.StringProperty()
    sentence: bpy.props.StringProperty()
    fix: bpy.props.StringProperty()
    vertices: bpy.props.StringProperty(description="Indices of the vertices concerned, a JSON list")


class SceneSettings(bpy.types.PropertyGroup):
    """All of a scene's simulation."""

    garments: bpy.props.CollectionProperty(type=GarmentEntry)
    active_garment: bpy.props.IntProperty()
    body: bpy.props.PointerProperty(
        type=bpy.types.Object,
        name="Body",
        description="Mesh that wears the garments, or the armature that moves its meshes",
        poll=_is_body,
    )
    model: bpy.props.StringProperty(
        name="Model",
        description="solver, a network by name, or a .safetensors file; empty for pb4u's default",
        search=_suggested("models"),
        search_options={"SUGGESTION"},
    )
    self_contact: bpy.props.BoolProperty(name="Self-contact", description="No cloth goes through cloth", default=True)
    lead_in: bpy.props.IntProperty(
        name="Settle", description="Frames for which the first frame is held while the cloth comes to rest", default=30,
        min=0, max=600,
    )  # fmt: skip
    own_range: bpy.props.BoolProperty(
        name="Own frame range", description="Simulate other frames than those that the scene renders"
    )
    frame_start: bpy.props.IntProperty(name="Start", default=1)
    frame_end: bpy.props.IntProperty(name="End", default=250)
    folder: bpy.props.StringProperty(
        name="Cache", description="Folder of the simulated frames", subtype="DIR_PATH", default="//pb4u_cache"
    )
    follow: bpy.props.BoolProperty(
        name="Show newest frame", description="Go to each frame as it is computed", default=True
    )
    findings: bpy.props.CollectionProperty(type=FindingEntry)
    checked: bpy.props.StringProperty(description="What the last check came to, in a sentence")
    status: bpy.props.StringProperty(options={"SKIP_SAVE"})
    notes: bpy.props.StringProperty(description="What the last run warned of, a sentence a line", options={"SKIP_SAVE"})
    progress: bpy.props.FloatProperty(min=0.0, max=1.0, options={"SKIP_SAVE"})
    running: bpy.props.BoolProperty(options={"SKIP_SAVE"})


def entry_values(entry, files, first_frame):
    """Entries of the scene file for a garment.

    Args:
        entry: of the list.
        files: where the garment was written.
        first_frame: number of the scene's frame that is simulated first.
    """
    pinned = files.pins is not None
    return {
        "garment": f"./{files.mesh.name}",
        "material": _material(entry),
        "triangles": entry.triangles if entry.own_triangles else None,
        "pins": None if files.pins is None else f"./{files.pins.name}",
        "pin_stiffness": entry.pin_stiffness if pinned and entry.springs else None,
        "pins_until": max(entry.pins_until - first_frame, 0) if pinned and entry.lets_go else None,
        "tucked": True if entry.tucked else None,
    }


def run_values(settings):
    """Entries of the scene file's last section."""
    without = settings.model == "skinning"
    if without and settings.self_contact:
        raise PlainError(f"{settings.model} knows no self-contact; turn it off, or choose another model.")
    return {
        "model": _file_or_name(settings.model),
        "self_contact": None if without else settings.self_contact,
        # A file that leaves these out means what files meant before there was a choice.
        "friction_law": "auto",
        "time_integration": "auto",
        "air": "auto",
    }


def _material(entry):
    """Material of a garment, or a table of them by part where parts have their own; what is left is its body."""
    whole = _file_or_name(entry.material)
    pairs = [[word.strip() for word in each.partition("=")] for each in entry.parts.split(",") if each.strip()]
    if any(not part or not material for part, _, material in pairs):
        raise PlainError(f"Parts are PART=MATERIAL, separated by commas, such as hem=denim, not {entry.parts}.")
    parts = {part: _file_or_name(material) for part, _, material in pairs}
    if not parts:
        return whole
    return parts if whole is None else {"body": whole, **parts}


def _file_or_name(value):
    """A name as it is, a file as Blender means it: // is the folder of the .blend."""
    if not value:
        return None
    return bpy.path.abspath(value) if "/" in value or "\\" in value or "." in value else value


CLASSES = (GarmentEntry, FindingEntry, SceneSettings)
