"""What is wrong with a garment before it is simulated: all of its faults, and refusals of those that are too grave."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import ShapedBody
from pb4u.body.built_in import BUILT_IN
from pb4u.body.length_units import extent_of, garment_unit
from pb4u.body.library import load_body
from pb4u.collision.crossings import self_crossings
from pb4u.errors import InputError, warn
from pb4u.garment.body_pieces import body_faces
from pb4u.garment.findings import (
    Finding,
    Severity,
    body_findings,
    coarse_findings,
    contact_findings,
    crossing_findings,
    far_finding,
    limb_findings,
    penetration_findings,
    placement_findings,
    support_findings,
    surface_findings,
    turned_findings,
)
from pb4u.garment.fit import SURELY_WORN, Fit, RestBody, find_fit
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import fix_command
from pb4u.garment.limbs_inside import limbs_outside
from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.support import Support, find_support
from pb4u.garment.tangles import tangles
from pb4u.garment.thread_seams import drawn_together, sewable_threads
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.triangle_mesh import edge_lengths

# Mean distance to the body [m] from which another body is tried, and the share of it that fits clearly better. Of
# garments made for a woman or a man, the right body has 13 to 23 mm and at most 0.65 of the wrong one's; loose ones
# have over 0.8 on a body that they were not made for.
_BADLY, _BETTER = 0.025, 0.75
# Findings after which nothing is said of what holds the garment up, of limbs, and of how coarse it is.
_NOT_WORN = ("far", "inside", "unsure", "body")


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All faults of a garment on a body, and the measurements.

    Args:
        findings: worst first.
        fit: how the garment has to move to be worn; None without a body.
        measures: name -> number, SI units; None for what the body does not let be measured.
        held_by: what holds it up: "pins", "shoulders", "straps", "waistband" or "collar"; None if nothing does, or if
            it is not worn.
    """

    findings: tuple[Finding, ...]
    fit: Fit | None
    measures: dict[str, float | None]
    held_by: str | None = None

    @property
    def is_refused(self) -> bool:
        """Whether simulation refuses the garment as it is."""
        return any(f.severity is Severity.REFUSED for f in self.findings)

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of all findings."""
        return tuple(f.code for f in self.findings)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary for a JSON report."""
        findings = [
            {**asdict(f), "severity": f.severity.value, "where": list(f.where), "vertices": list(f.vertices)}
            for f in self.findings
        ]
        summary = {"refused": self.is_refused, "findings": findings, "measures": self.measures}
        return {**summary, "held_by": self.held_by}


def diagnose(
    garment: PolygonMesh | Garment,
    body: ShapedBody | AnimatedBody | None = None,
    file: str | Path = "GARMENT.obj",
    body_file: str | None = None,
) -> Diagnosis:
    """Faults of a garment, all of them, on its own and on the resting body.

    First-frame penetration, and whether the shoulders hold a garment without pins, are measured where the garment
    belongs, after the move that units and axes call for.

    Args:
        garment: as read, or as simulated.
        body: the body that wears it; without a body only the mesh itself is checked.
        file: the garment's file, named in the cures.
        body_file: name or file of the body for the suggested commands; by default a placeholder.
    """
    pinned, is_file = False, not isinstance(garment, Garment)
    if isinstance(garment, Garment):
        pinned = bool(garment.pinned.any())
        garment = PolygonMesh(garment.vertices, tuple(garment.faces))
    surface = SourceSurface.of(garment)
    findings = surface_findings(surface)
    if len(threads := sewable_threads(surface)):
        garment = drawn_together(surface, threads)
        surface = SourceSurface.of(garment)
    vertices = garment.vertices[np.unique(surface.faces)]
    lengths = edge_lengths(garment.vertices, surface.topology.edges)
    measures: dict[str, float | None] = {
        "vertices": float(len(garment.vertices)),
        "triangles": float(len(surface.faces)),
        "pieces": float(surface.piece_count),
        "boundary_loops": float(len(surface.topology.boundary_loops)),
        "mean_edge_length": float(lengths.mean()) if len(lengths) else 0.0,
        "edge_length_variation": float(lengths.std() / lengths.mean()) if len(lengths) and lengths.any() else 0.0,
    }
    fit, support_name = None, "pins" if pinned else None
    if body is not None and len(vertices):
        rest = RestBody.of(body)
        fit = find_fit(vertices, rest)
        mend = fix_command(file, rest.name if body_file is None else body_file, getattr(body, "own_shape", None))
        findings += body_findings(surface, rest)
        findings += placement_findings(vertices, fit, rest, mend)
        findings += crossing_findings(surface, fit.apply(garment.vertices), measures)
        findings += contact_findings(surface, fit, rest, measures, mend)
        if not any(f.code in _NOT_WORN for f in findings):
            where = fit.apply(garment.vertices), surface.faces
            if not pinned:
                support = find_support(*where, rest)
                findings += support_findings(*where, rest, support)
                support_name = support.name
            if isinstance(body, ShapedBody):
                findings += limb_findings(*where, body)
            findings += coarse_findings(*where, rest)
        if is_file and isinstance(body, ShapedBody):
            findings += _better_body(garment.vertices, surface.faces, body, fit)
    elif len(vertices) and (unit := garment_unit(extent_of(vertices))):
        findings.append(Finding("units", Severity.REFUSED, f"The garment {unit}.", "scale it to metres"))
    elif len(vertices):
        findings += crossing_findings(surface, garment.vertices, measures)
    if coarse := next((f for f in findings if f.code in ("coarse", "too-coarse")), None):
        # It asks for more than an evenly meshed garment of as many triangles.
        findings = [replace(f, fix=coarse.fix) if f.code == "graded" else f for f in findings]
    order = list(Severity)
    return Diagnosis(tuple(sorted(findings, key=lambda f: order.index(f.severity))), fit, measures, support_name)


def _better_body(vertices: np.ndarray, faces: np.ndarray, body: ShapedBody, fit: Fit) -> list[Finding]:
    """The other built-in body, where a garment fits this one badly and that one clearly better."""
    through = limbs_outside(fit.apply(vertices), faces, body)
    if body.name not in BUILT_IN or not (through or fit.misfit > _BADLY):
        return []
    for name in (other_name for other_name in BUILT_IN if other_name != body.name):
        other = load_body(name)
        assert isinstance(other, ShapedBody)
        better = find_fit(vertices[np.unique(faces)], RestBody.of(other))
        still_through = limbs_outside(better.apply(vertices), faces, other)
        share = 1.0 if len(still_through) < len(through) else _BETTER
        if better.misfit < share * fit.misfit and len(still_through) <= len(through):
            off = f"{1000 * better.misfit:.0f} mm off on average, and {1000 * fit.misfit:.0f} mm"
            sentence = f'It fits the body "{name}" better: there it is {off} on "{body.name}".'
            return [Finding("other-body", Severity.WARNING, sentence, f"give --body {name}")]
    return []


def require_worn(garment: Garment, body: ShapedBody | AnimatedBody, file: str | Path, support: Support | None) -> None:
    """Refuse a garment that does not fit around the resting body; warn if it starts inside the body, seems rotated or
    will fall.

    Args:
        garment: the garment.
        body: the body meant to wear it.
        file: file of the garment, for the suggested commands.
        support: what holds it up; None if this is not reported, such as for a pinned garment.

    Raises:
        InputError: it is far from the body, wholly inside it, or in other units or axes.
    """
    rest = RestBody.of(body)
    misfit = float(rest.misfit(garment.vertices))
    mend = fix_command(file, rest.name, getattr(body, "own_shape", None))
    findings = []
    if misfit > SURELY_WORN:
        findings = placement_findings(garment.vertices, find_fit(garment.vertices, rest), rest, mend)
    placed = not findings  # elsewhere, depth and support are those of the wrong place
    if placed and rest.is_closed:  # of one that is not, who loaded it was warned
        findings += penetration_findings(rest.signed_distances(garment.vertices), rest, mend)
        findings += turned_findings(garment.vertices, garment.faces, rest, mend)
    if placed and garment.is_authors_mesh:
        pairs = self_crossings(garment.vertices, garment.faces, sharing=True)
        owner = np.zeros(len(garment.vertices), dtype=np.int64)
        for tangle in tangles(["The garment"], owner, garment.vertices, garment.faces, pairs):
            fix = (
                "repair it in the program it comes from; otherwise a simulation with self-contact untangles it at "
                "its start"
            )
            findings.append(Finding("self-crossing", Severity.WARNING, f"{tangle}.", fix))
    if placed and support is not None:
        source = garment.source
        names = None if source is None else cKDTree(source.source.vertices).query(garment.vertices)[1]
        findings += support_findings(garment.vertices, garment.faces, rest, support, names)
    _tell(garment, findings)


def require_metres(
    garment: Garment, body: ShapedBody | AnimatedBody | None = None, file: str | Path | None = None
) -> None:
    """Refuse a garment whose size is impossible in metres.

    Args:
        garment: as given.
        body: the body meant to wear it, whose size shows the unit; None without a body.
        file: file of the garment, for the suggested commands; None for arrays.

    Raises:
        InputError: it is in other units.
    """
    unit = garment_unit(extent_of(garment.vertices))
    if unit is None:
        return
    if file is None:
        raise InputError(f"garment {garment.name} {unit}; give its vertices in metres.")
    if body is not None:
        rest = RestBody.of(body)
        mend = fix_command(file, rest.name, getattr(body, "own_shape", None))
        findings = placement_findings(garment.vertices, find_fit(garment.vertices, rest), rest, mend)
        _tell(garment, [finding for finding in findings if finding.severity is Severity.REFUSED])
    raise InputError(f"{file} {unit}; scale it to metres with {fix_command(file)}.")


def require_clothes(garment: Garment, body: ShapedBody | AnimatedBody) -> None:
    """Refuse a body given as a garment, or as part of one.

    Args:
        garment: as read.
        body: the body meant to wear it.

    Raises:
        InputError: a part of the garment is a body.
    """
    rest = RestBody.of(body)
    if body_faces(garment.vertices, garment.faces, rest).any():
        mesh = PolygonMesh(garment.vertices, tuple(garment.faces)) if garment.source is None else garment.source.source
        _tell(garment, body_findings(SourceSurface.of(mesh), rest))


def require_near(garment: Garment, body: ShapedBody | AnimatedBody) -> None:
    """Refuse a garment from arrays in other units, far from the body, or wholly inside it.

    Args:
        garment: as given.
        body: the body that wears it.

    Raises:
        InputError: its size is impossible in metres, or it is not near the resting body.
    """
    require_metres(garment)
    rest = RestBody.of(body)
    inside = penetration_findings(rest.signed_distances(garment.vertices), rest, "")
    _tell(garment, [f for f in (*far_finding(garment.vertices, rest), *inside) if f.severity is Severity.REFUSED])


def require_fine(garment: Garment, body: ShapedBody | AnimatedBody, *, accepted: bool = False) -> None:
    """Refuse a garment too coarse to stay around the resting body; warn where skin may show through it.

    Args:
        garment: as simulated.
        body: the body that wears it.
        accepted: whether the user chose this coarseness: a warning then replaces the refusal.

    Raises:
        InputError: its edges span too large an angle around the body.
    """
    _tell(garment, coarse_findings(garment.vertices, garment.faces, RestBody.of(body)), accepted)


def _tell(garment: Garment, findings: list[Finding], accepted: bool = False) -> None:
    """Refuse the garment for the first finding that is too grave, unless that is accepted; else warn of all."""
    for finding in sorted(findings, key=lambda finding: finding.severity is not Severity.REFUSED):
        sentence = f"{garment.name}: {finding.sentence[:-1]}; {finding.fix}."
        if finding.severity is Severity.REFUSED and not accepted:
            raise InputError(sentence)
        warn(sentence)
