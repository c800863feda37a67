"""Faults of a garment, each in one plain sentence with its cure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.joint_names import plain_names
from pb4u.body.length_units import UNITS
from pb4u.collision.crossings import self_crossings
from pb4u.garment.body_pieces import body_faces, named
from pb4u.garment.coarseness import Coarseness
from pb4u.garment.fit import AXES, UPRIGHT, WHOLLY_INSIDE, WORST_MISFIT, Fit, RestBody, is_inside_out
from pb4u.garment.garment_file import MOST_SIMULATED
from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.support import Support
from pb4u.garment.surface_faults import Fault, first_of, surface_faults
from pb4u.garment.tangles import tangles
from pb4u.garment.untangling import untangle
from pb4u.geometry.topology import Topology

# A garment whose nearest point is farther from the body than this [m] does not touch it.
_FAR = 0.05


class Severity(str, Enum):
    """Severity of a fault: refused, a warning, or only a note."""

    REFUSED = "refused"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """One fault.

    Args:
        code: short fixed name.
        severity: whether simulation refuses it, warns, or only has a note for it.
        sentence: the fault and its place.
        fix: how to mend it.
        mendable: whether `repair` does that.
        where: indices of the first vertices, faces or edges concerned, as the sentence says.
        vertices: indices of all vertices concerned, in the author's mesh.
        tacks: pairs of vertices, in the author's mesh, to sew together as a remedy.
    """

    code: str
    severity: Severity
    sentence: str
    fix: str
    mendable: bool = False
    where: tuple[int, ...] = ()
    vertices: tuple[int, ...] = ()
    tacks: tuple[tuple[int, int], ...] = ()


def surface_findings(surface: SourceSurface) -> list[Finding]:
    """Faults of the mesh itself, independent of the body.

    Args:
        surface: of the author's mesh of the garment.
    """
    findings = [_finding(surface, fault) for fault in surface_faults(surface)]
    if len(surface.faces) > MOST_SIMULATED:
        sentence = f"The garment has {len(surface.faces):,} triangles; at most {MOST_SIMULATED:,} can be simulated."
        findings.append(Finding("too-many", Severity.REFUSED, sentence, "simulate it with `--triangles N`"))
    return findings


def _finding(surface: SourceSurface, fault: Fault) -> Finding:
    indices = fault.vertices if fault.faces is None else fault.faces
    first = () if indices is None else tuple(np.asarray(indices)[:20].tolist())
    concerned = fault.vertices
    if fault.faces is not None and concerned is None:
        concerned = _corners(surface, fault.faces)
    severity = Severity.REFUSED if fault.is_refused else Severity.NOTE if fault.is_note else Severity.WARNING
    return Finding(fault.code, severity, fault.sentence, fault.fix, fault.mendable, first, _indices(concerned))


def placement_findings(vertices: np.ndarray, fit: Fit, body: RestBody, mend: str) -> list[Finding]:
    """Faults of units, axes and position.

    Args:
        vertices: (vertices, 3) of the garment as given.
        fit: how it has to move to be worn.
        body: the resting body.
        mend: command that repairs the faults.
    """
    if fit.is_identity:
        return far_finding(vertices, body)
    if fit.is_unsure:
        sentence = (
            f"The position of the garment on the body is unclear: it fits about equally well in {1 + len(fit.alike)} "
            f"of {len(AXES)} orientations, {1000 * fit.misfit:.0f} mm off on average."
        )
        fix = (
            "give --body and --body-shape of the body that it was made for, or place it on the resting body in the "
            "program it comes from, in metres, Y up and facing +Z"
        )
        return [*far_finding(vertices, body), Finding("unsure", Severity.REFUSED, sentence, fix)]
    findings = []
    if fit.unit != "metres":
        sentence = f"The garment is in {fit.unit}: it spans {np.ptp(vertices, axis=0).max():.4g} {fit.unit}."
        findings.append(
            Finding("units", Severity.REFUSED, sentence, f"scale it by {UNITS[fit.unit]:g} with {mend}", True)
        )
    if fit.axes != UPRIGHT:
        sentence = f"The garment was made {fit.axes}, but pb4u uses Y up and a body that faces +Z."
        findings.append(Finding("axes", Severity.WARNING, sentence, f"turn it with {mend}", True))
    if fit.shift.any():
        why = "where it fits best" if fit.searched else "it was made around the body model's own origin"
        sentence = f"The garment has to move {fit.move} to be worn: {why}, {1000 * fit.misfit:.0f} mm off on average."
        code = "place" if fit.shift[[0, 2]].any() else "height"
        findings.append(Finding(code, Severity.WARNING, sentence, f"move it with {mend}", True))
    if fit.front_alike:
        sentence = (
            f"Front and back of the garment fit equally well: {fit.axes} is used, {fit.front_alike[0]} is as likely."
        )
        fix = "look at the repaired garment, and turn it about the vertical if it is back to front"
        findings.append(Finding("front", Severity.WARNING, sentence, fix))
    if float(body.misfit(vertices)) > WORST_MISFIT:
        away = 100 * float(np.median(np.abs(body.signed_distances(vertices))))
        why = "made at another place" if fit.axes == UPRIGHT else fit.axes
        sentence = (
            f'The garment is not on the body "{body.name}" as it stands, half of it is {away:.0f} cm away or more: it '
            f"seems to be {why if fit.unit == 'metres' else fit.unit}."
        )
        findings.append(Finding("misplaced", Severity.REFUSED, sentence, f"move it with {mend}", True))
    return findings + far_finding(fit.apply(vertices), body)


def limb_findings(vertices: np.ndarray, faces: np.ndarray, body: ShapedBody) -> list[Finding]:
    """Limbs of the resting body that are not inside a garment's sleeves and legs.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    from pb4u.garment.limbs_inside import limbs_outside

    limbs = limbs_outside(vertices, faces, body)
    if not limbs:
        return []
    sentence = f"{plain_names(limbs).capitalize()} of the body at rest: through the cloth, not inside it."
    fix = (
        "pose it around them in the program it comes from; a simulation pushes it out if that is enough, and "
        "otherwise refuses it"
    )
    return [Finding("limb-outside", Severity.WARNING, sentence, fix)]


def coarse_findings(vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> list[Finding]:
    """Triangles too few for the body.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
    """
    coarse = Coarseness.of(vertices, faces, body)
    if not coarse.is_few:
        return []
    spans = f"one edge in ten covers {coarse.degrees:.0f} of the 360 degrees around a limb or the trunk"
    fix = f"ask for more with `--triangles {coarse.enough}`"
    if coarse.is_lost:
        sentence = f"Its {coarse.triangles:,} triangles are too few to stay around the body: {spans}."
        fix = f"{fix}, or keep its own with `--triangles {coarse.triangles}`"
        return [Finding("too-coarse", Severity.REFUSED, sentence, fix)]
    sentence = f"Its {coarse.triangles:,} triangles are few for the body, so skin or a limb may come through: {spans}."
    return [Finding("coarse", Severity.WARNING, sentence, fix)]


def far_finding(vertices: np.ndarray, body: RestBody) -> list[Finding]:
    """A garment that does not come near the body.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        body: the resting body.
    """
    distance = float(np.abs(body.signed_distances(vertices)).min())
    if distance <= _FAR:
        return []
    sentence = f'The garment is far from the body "{body.name}": its nearest point is {distance:.2f} m away.'
    return [Finding("far", Severity.REFUSED, sentence, "place it on the body in the program it comes from")]


def body_findings(surface: SourceSurface, body: RestBody) -> list[Finding]:
    """A body given as a garment, or as part of one.

    Args:
        surface: of the author's mesh of the garment.
        body: the resting body.
    """
    mask = body_faces(surface.source.vertices, surface.faces, body)
    if not mask.any():
        return []
    polygons = np.unique(surface.polygon[surface.kept[mask]])
    name = named(surface.source, polygons)
    part = f"Its object {name}" if name else "The garment" if mask.all() else f"A piece of {len(polygons):,} faces"
    sentence = f'{part} is a body, no garment: it reaches from head to foot of "{body.name}", on its skin or closed.'
    fix = "give it as --body" if mask.all() else "delete it in the program it comes from, and export only the clothes"
    where = tuple(polygons[:20].tolist())
    return [
        Finding("body", Severity.REFUSED, sentence, fix, where=where, vertices=_indices(_corners(surface, polygons)))
    ]


def support_findings(
    vertices: np.ndarray, faces: np.ndarray, body: RestBody, support: Support, names: np.ndarray | None = None
) -> list[Finding]:
    """A garment without pins that will slide down.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64.
        body: the resting body.
        support: what holds it up.
        names: (vertices,) number of each vertex in the author's mesh; its index in `vertices` by default.
    """
    if support.name == "shoulders":
        return []
    if support.held is not None:
        sentence = f"Nothing but its {support.name}, {int(support.held.sum())} vertices, can hold the garment up."
        fix = "none is needed: `pb4u simulate` pins it to the body, and `--pins none` releases it"
        return [Finding("unsupported", Severity.NOTE, sentence, fix)]
    why, fix = "none of it lies on the shoulders", "simulate it with `--pins waist`"
    topology = Topology(faces, len(vertices))
    if len(np.unique(topology.piece_of_vertex[faces[:, 0]])) > 1:
        why, fix = "its pieces are not joined, and none of it lies on the shoulders", "join its pieces first"
    straps = support.loose
    names = np.arange(len(vertices)) if names is None else names
    tacks = tuple((int(names[a]), int(names[b])) for strap in straps for a, b in strap.tacks)
    if straps:
        gap = max(strap.gap for strap in straps)
        why = (
            f"{len(straps)} of its straps have loose ends, {100 * gap:.1f} cm from the border to which they should "
            "be sewn"
        )
        fix = "sew them in the program they come from"
    if tacks:
        fix = "sew them with " + " ".join(f"`--tack {a}:{b}`" for a, b in tacks)
    sentence = f"Nothing holds the garment up: {why}; it would slide down."
    ends = tuple(int(names[vertex]) for strap in straps for vertex in strap.end)
    severity = Severity.WARNING if straps else Severity.NOTE
    return [Finding("unsupported", severity, sentence, fix, where=ends[:20], vertices=ends, tacks=tacks)]


def contact_findings(
    surface: SourceSurface, fit: Fit, body: RestBody, measures: dict[str, float | None], mend: str
) -> list[Finding]:
    """First-frame penetration, a garment inside out, a body that is not closed.

    Args:
        surface: of the author's mesh of the garment.
        fit: how the garment has to move to be worn.
        body: the resting body.
        measures: numbers by name; this function adds its own.
        mend: command that repairs the faults.
    """
    used = np.unique(surface.faces)
    placed = fit.apply(surface.source.vertices)
    distances = body.signed_distances(placed[used])
    findings = penetration_findings(distances, body, mend, used)
    closed = body.is_closed
    measures["penetration_percent"] = 100.0 * float((distances < 0.0).mean()) if closed else None
    measures["penetration_depth_max"] = max(0.0, -float(distances.min())) if closed else None
    return findings if surface.flipped[0].any() else findings + turned_findings(placed, surface.faces, body, mend)


def turned_findings(vertices: np.ndarray, faces: np.ndarray, body: RestBody, mend: str) -> list[Finding]:
    """A garment inside out.

    Args:
        vertices: (vertices, 3) of the garment where it is worn [m].
        faces: (faces, 3) int64, neighbours turned alike.
        body: the resting body.
        mend: command that mends it.
    """
    # Seen from within the body every garment looks away from its skin.
    within = body.is_closed and (body.signed_distances(vertices[np.unique(faces)]) < 0.0).mean() > 0.5
    if within or not is_inside_out(vertices, faces, body):
        return []
    sentence = "All faces look inwards, at the body."
    return [Finding("inside-out", Severity.WARNING, sentence, f"turn them with {mend}", True)]


def crossing_findings(surface: SourceSurface, vertices: np.ndarray, measures: dict[str, float | None]) -> list[Finding]:
    """A garment that passes through itself; open seams count as welded.

    Args:
        surface: of the author's mesh of the garment.
        vertices: (vertices, 3) of the garment where it is worn [m].
        measures: numbers by name; this function adds its own.
    """
    welded = surface.weld_target[surface.faces]
    proper = np.flatnonzero((welded != np.roll(welded, 1, axis=1)).all(axis=1))
    faces = welded[proper]
    pairs = self_crossings(vertices, faces, sharing=True)
    measures["self_intersections"] = float(len(pairs))
    if not len(pairs):
        return []
    (tangle,) = tangles(["The garment"], np.zeros(len(vertices), dtype=np.int64), vertices, faces, pairs)
    polygons = surface.polygon[surface.kept[proper[pairs]]]
    start = untangle(vertices, faces, gap=0.0)
    sentence = f"{tangle}, the first faces {first_of(polygons)} (pairs)."
    where, concerned = tuple(polygons.reshape(-1)[:20].tolist()), _indices(_corners(surface, polygons))
    if not start.is_free:
        fix = "repair it in the program it comes from, or simulate it with `--self-contact off`"
        return [Finding("self-crossing", Severity.REFUSED, sentence, fix, where=where, vertices=concerned)]
    farthest = float(np.linalg.norm(start.vertices - vertices, axis=1).max())
    fix = (
        "repair it in the program it comes from; otherwise the simulation untangles it at its start, by at most "
        f"{1000 * farthest:.1f} mm"
    )
    return [Finding("self-crossing", Severity.WARNING, sentence, fix, where=where, vertices=concerned)]


def penetration_findings(
    distances: np.ndarray, body: RestBody, mend: str, ids: np.ndarray | None = None
) -> list[Finding]:
    """Vertices that start inside the body.

    Args:
        distances: (vertices,) signed, to the body [m].
        body: the resting body.
        mend: command that repairs the faults.
        ids: (vertices,) number of each vertex; its index in `distances` by default.
    """
    if not body.is_closed:
        sentence = f'The body "{body.name}" is not a closed surface, so penetration is not reported.'
        return [Finding("open-body", Severity.WARNING, sentence, "close its holes")]
    inside = distances < 0.0
    if not inside.any():
        return []
    deepest = int(distances.argmin())
    names = np.arange(len(distances)) if ids is None else ids
    where = tuple(names[np.argsort(distances)[: min(20, int(inside.sum()))]].tolist())
    concerned = _indices(names[inside])
    if inside.mean() > WHOLLY_INSIDE:
        sentence = (
            f'The garment lies wholly inside the body "{body.name}" ({100 * inside.mean():.0f}% of its vertices).'
        )
        fix = "make it larger, or use the body for which it was made"
        return [Finding("inside", Severity.REFUSED, sentence, fix, where=where, vertices=concerned)]
    sentence = (
        f"{100 * inside.mean():.1f}% of the vertices start inside the body, the deepest "
        f"{-1000 * distances[deepest]:.1f} mm (vertex {names[deepest]})."
    )
    return [Finding("penetration", Severity.WARNING, sentence, f"push them out with {mend}", True, where, concerned)]


def _corners(surface: SourceSurface, faces: np.ndarray) -> np.ndarray:
    """Vertices (n,) at the corners of some faces of the author's mesh, whatever shape the indices have."""
    return np.concatenate([surface.source.polygons[face] for face in np.unique(faces).tolist()])


def _indices(vertices: np.ndarray | None) -> tuple[int, ...]:
    return () if vertices is None else tuple(np.unique(vertices).tolist())
