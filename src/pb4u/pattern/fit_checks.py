"""Refusals of patterns that do not go on a body: placed elsewhere, too narrow, too tight, or slipping off."""

from __future__ import annotations

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.errors import InputError
from pb4u.garment.body_form import form_of
from pb4u.pattern.body_measurements import trunk_girths
from pb4u.pattern.mesh import PatternMesh
from pb4u.pattern.placement import shoulder_point

_TIGHT = 0.1
"""Mean strain of the cloth from which on a pattern is too small for a body: those that fit have 0.02 to 0.05."""

_TIGHT_PANEL = 0.2
"""The same of one panel, such as a waistband that does not close: those that fit have 0.13 at most."""

_NARROW = 0.8
"""Share of the waist from which on cloth goes around a body: narrower cloth is not strained, but ends around the neck.
"""

_SLIPPED = 0.05
"""Drop [m] of a shoulder seam from which on a garment has slipped off: those that stay drop by less than 0.01."""

_SLICE = 0.03
"""Half height [m] of a ring of cloth whose strain tells what girth it was cut for."""

_REMEDY = "check the pattern's unit, or make it from the body's measures, which `pb4u measure-body` writes."


def refuse_far(mesh: PatternMesh, body: ShapedBody) -> None:
    """Refuse panels that the file does not place around the body.

    Args:
        mesh: the panels.
        body: the resting body.

    Raises:
        InputError: a panel is farther away than the body is high.
    """
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    beyond = np.maximum(low - mesh.placed, mesh.placed - high).max(axis=1)
    for number, panel in enumerate(mesh.pattern.panels):
        if (away := beyond[mesh.panel == number].min()) > body.height:
            raise InputError(
                f"{mesh.pattern.name} is not placed around {body.name}: its panel {panel.name} is "
                f"{away:,.1f} m away; check the panel's translation and the pattern's unit."
            )


def refuse_narrow(mesh: PatternMesh, body: ShapedBody, placed: np.ndarray) -> None:
    """Refuse cloth over the trunk that cannot go around it, and cloth below it, which nothing holds.

    Args:
        mesh: the panels.
        body: the resting body.
        placed: (points, 3) of the panels around it [m].

    Raises:
        InputError: too much of it is too narrow, or all of it is too low.
    """
    form, pattern = form_of(body), mesh.pattern
    trunk = [k for k, panel in enumerate(pattern.panels) if panel.label != "arm"]
    clouds = [placed[mesh.panel == k] for k in trunk]
    low, high = (np.array([end(points[:, 1]) for points in clouds]) for end in (np.min, np.max))
    widths = np.array([np.hypot(*np.ptp(points[:, [0, 2]], axis=0)) for points in clouds])
    levels = np.linspace(form.crotch, form.neck[1], 64)[:, None]
    widest = float((widths * ((low <= levels) & (levels <= high))).sum(axis=1).max(initial=0.0))
    waist = trunk_girths(body)["waist"][1]
    if len(clouds) and high.max() < form.crotch:
        raise InputError(
            f"{pattern.name} is placed too low for {body.name}: its highest panel, "
            f"{pattern.panels[trunk[high.argmax()]].name}, ends {100 * high.max():.0f} cm above the floor, and the "
            f"crotch is at {100 * form.crotch:.0f} cm; {_REMEDY}"
        )
    if 0.0 < widest < _NARROW * waist:
        raise InputError(
            f"{pattern.name} is too small for {body.name}: its panels are {100 * widest:.0f} cm wide together "
            f"(the widest, {pattern.panels[trunk[widths.argmax()]].name}, {100 * widths.max():.0f} cm), and the "
            f"waist measures {100 * waist:.0f} cm; {_REMEDY}"
        )


def refuse_slipped(mesh: PatternMesh, body: ShapedBody, placed: np.ndarray, places: np.ndarray) -> None:
    """Refuse cloth that was placed on the shoulders and hangs below them.

    Args:
        mesh: the panels.
        body: the resting body.
        placed: (points, 3) of the panels around it [m].
        places: (vertices, 3) of the hanging garment [m].

    Raises:
        InputError: it slips off.
    """
    top = shoulder_point(mesh, placed)
    drop = 0.0 if top is None else float(placed[top, 1] - places[mesh.vertex[top], 1])
    if drop > _SLIPPED:
        raise InputError(
            f"{mesh.pattern.name} is too large for {body.name}: it slips off the shoulders, by "
            f"{100 * drop:.0f} cm; make it from the body's measures, which `pb4u measure-body` writes."
        )


def refuse_tight(mesh: PatternMesh, body: ShapedBody, places: np.ndarray, mean: float, strains: np.ndarray) -> None:
    """Refuse cloth that is strained too much, all or a panel; names the girths of the body that are too large.

    Args:
        mesh: the panels.
        body: the resting body.
        places: (vertices, 3) of the hanging garment [m].
        mean: of the strains, weighted by area.
        strains: (faces,) largest principal strain of each.

    Raises:
        InputError: it is too tight.
    """
    panels = mesh.pattern.panels
    of_panel = [strains[mesh.face_panel == number].mean() for number in range(len(panels))]
    worst = int(np.argmax(of_panel))
    if mean <= _TIGHT and of_panel[worst] <= _TIGHT_PANEL:
        return
    levels = places[mesh.sewn_faces, 1].mean(axis=1)
    sleeve = np.array([panel.label == "arm" for panel in panels])[mesh.face_panel]
    differ, level = "", {}
    if panels[worst].label != "arm":
        level = {panels[worst].name: float(levels[mesh.face_panel == worst].mean())}
    for name, (height, girth) in trunk_girths(body, **level).items():
        around = strains[(np.abs(levels - height) < _SLICE) & ~sleeve]
        if len(around) and around.mean() > 0.5 * _TIGHT:
            differ += f"; {name}: {100 * girth:.0f} cm, cut for about {100 * girth / (1.0 + around.mean()):.0f}"
    raise InputError(
        f"{mesh.pattern.name} is too small for {body.name}: its cloth would be strained by "
        f"{100 * mean:.0f} % on average, and by {100 * of_panel[worst]:.0f} % in panel {panels[worst].name}"
        f"{differ}; {_REMEDY}"
    )
