"""The panel in the sidebar of the 3D view."""

import textwrap

import bpy

_ICONS = {"refused": "CANCEL", "warning": "ERROR", "note": "INFO"}
# Width of a character of the interface's font [pixels] at its usual size, to break sentences into lines.
_CHARACTER = 7


class PB4U_UL_garments(bpy.types.UIList):
    """The garments, inner first"""

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property, _index=0, _flag=0):
        row = layout.row()
        row.label(text=item.object.name if item.object else "(deleted)", icon="MOD_CLOTH")
        row.label(text=item.material or "default material")


class _Panel(bpy.types.Panel):
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "pb4u"


class PB4U_PT_garments(_Panel):
    """What is simulated"""

    bl_label = "Garments"

    def draw(self, context):
        layout, settings = self.layout, context.scene.pb4u
        layout.prop(settings, "body")
        row = layout.row()
        row.template_list("PB4U_UL_garments", "", settings, "garments", settings, "active_garment", rows=3)
        side = row.column(align=True)
        side.operator("pb4u.add_garment", icon="ADD", text="")
        side.operator("pb4u.remove_garment", icon="REMOVE", text="")
        side.operator("pb4u.move_garment", icon="TRIA_UP", text="").step = -1
        side.operator("pb4u.move_garment", icon="TRIA_DOWN", text="").step = 1
        if not 0 <= settings.active_garment < len(settings.garments):
            return
        entry = settings.garments[settings.active_garment]
        box = layout.box()
        box.prop(entry, "material")
        box.prop(entry, "parts")
        row = box.row(heading="Remesh")
        row.prop(entry, "own_triangles", text="")
        part = row.row()
        part.enabled = entry.own_triangles
        part.prop(entry, "triangles")
        if entry.object:
            box.prop_search(entry, "pins", entry.object, "vertex_groups")
            if entry.pins:
                for switch, value in (("springs", "pin_stiffness"), ("lets_go", "pins_until")):
                    row = box.row()
                    row.prop(entry, switch)
                    part = row.row()
                    part.enabled = getattr(entry, switch)
                    part.prop(entry, value)
        box.prop(entry, "tucked")


class PB4U_PT_check(_Panel):
    """What is wrong with the garments"""

    bl_label = "Check"

    def draw(self, context):
        layout, settings = self.layout, context.scene.pb4u
        layout.operator("pb4u.check", icon="CHECKMARK")
        if settings.checked:
            layout.label(text=settings.checked)
        for index, entry in enumerate(settings.findings):
            box = layout.box()
            head = box.row()
            head.label(text=entry.object or "Outfit", icon=_ICONS.get(entry.severity, "INFO"))
            if entry.vertices not in ("", "[]"):
                head.operator("pb4u.select_finding", text="", icon="RESTRICT_SELECT_OFF").index = index
            _sentence(box, context, entry.sentence)
            _sentence(box, context, f"Mend: {entry.fix}.")


class PB4U_PT_simulate(_Panel):
    """The simulation"""

    bl_label = "Simulate"

    def draw(self, context):
        layout, settings = self.layout, context.scene.pb4u
        layout.use_property_split = True
        layout.prop(settings, "model")
        layout.prop(settings, "self_contact")
        layout.prop(settings, "lead_in")
        layout.prop(settings, "own_range")
        if settings.own_range:
            layout.prop(settings, "frame_start")
            layout.prop(settings, "frame_end")
        layout.prop(settings, "folder")
        layout.prop(settings, "follow")
        if settings.running:
            layout.progress(factor=settings.progress, text=settings.status)
            layout.operator("pb4u.cancel", icon="CANCEL")
            return
        layout.operator("pb4u.simulate", icon="PLAY")
        if settings.status:
            _sentence(layout, context, settings.status)
        for note in settings.notes.splitlines():
            _sentence(layout.box(), context, note)
        row = layout.row(align=True)
        row.operator("pb4u.export")
        row.operator("pb4u.remove_result")
        layout.operator("pb4u.delete_unused")


def _sentence(layout, context, text):
    """A sentence in as many lines as the panel needs."""
    width = max(20, int(context.region.width / _CHARACTER / context.preferences.system.ui_scale))
    column = layout.column(align=True)
    for line in textwrap.wrap(text, width):
        column.label(text=line)


CLASSES = (PB4U_UL_garments, PB4U_PT_garments, PB4U_PT_check, PB4U_PT_simulate)
