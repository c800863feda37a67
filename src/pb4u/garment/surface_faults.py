"""Faults of an author's mesh on its own, on whatever body: one list for all that read a garment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pb4u.garment.source_surface import SourceSurface
from pb4u.garment.surface_parts import gap_between, sewn_on
from pb4u.garment.tacks import FARTHEST
from pb4u.garment.thread_seams import sewable_threads
from pb4u.geometry.topology import connected_labels
from pb4u.geometry.triangle_mesh import edge_lengths

# Deviation of edge lengths, of their mean, above which they count as graded; built-in garments have about a tenth.
_GRADED = 0.35
# Share of faces with another layer behind them above which the cloth is reported as double: a hem or a pocket has less.
_DOUBLE = 0.2


class Fault(NamedTuple):
    """Something about a mesh that a simulation cannot use, or that its author may not have meant.

    Args:
        code: short fixed name.
        sentence: the fault and its place.
        fix: how to mend it.
        meanwhile: how a simulation of the unrepaired mesh handles it.
        mendable: whether `repair` mends it.
        faces: indices of the author's polygons concerned.
        vertices: indices of the author's vertices concerned.
        is_refused: whether it cannot be simulated.
        is_note: whether nothing need be done about it.
    """

    code: str
    sentence: str
    fix: str
    meanwhile: str = ""
    mendable: bool = False
    faces: np.ndarray | None = None
    vertices: np.ndarray | None = None
    is_refused: bool = False
    is_note: bool = False


def surface_faults(surface: SourceSurface) -> list[Fault]:
    """Faults of a mesh on its own.

    Args:
        surface: the mesh.
    """
    topology, first = surface.topology, first_of
    if not len(surface.faces):
        sentence = f"None of its {len(surface.all_faces)} faces has an area."
        return [Fault("no-area", sentence, "export the garment again", is_refused=True)]
    faults = []
    if len(edges := topology.non_manifold_edges):
        extra, on = surface.extra_faces, sewn_on(surface)
        sentence = (
            f"{len(edges)} edge(s) are shared by three or more faces, the first {first(edges)} (pairs of vertices)."
        )
        fix = f"delete the faces {first(extra)}"
        if on.any():
            extra = np.unique(surface.polygon[surface.kept[on]])
            sentence = f"{sentence[:-1]}: {len(extra)} faces are sewn on there, such as a pocket or a flap."
            fix = "remove them, or separate them from the cloth in the program it comes from"
        faults.append(Fault("non-manifold", sentence, fix, "", bool(on.any()), extra, edges, is_refused=True))
    if len(collapsed := surface.polygon[surface.collapsed & ~surface.repeated]):
        sentence = f"{len(collapsed)} triangle(s) have no area, the first {first(collapsed)}."
        faults.append(Fault("degenerate", sentence, "drop them", "they are left out", True, collapsed))
    if len(repeated := surface.polygon[surface.repeated]):
        sentence = f"{len(repeated)} face(s) exist twice, the first {first(repeated)}."
        faults.append(Fault("duplicate", sentence, "drop them", "they are left out", True, repeated))
    if len(isolated := topology.isolated_vertices):
        sentence = f"{len(isolated)} vertices belong to no face, the first {first(isolated)}."
        meanwhile = "they are not simulated, and follow the nearest cloth in exports"
        faults.append(Fault("isolated", sentence, "drop them", meanwhile, True, vertices=isolated))
    if len(loose := surface.unwelded):
        sentence = (
            f"{len(loose)} border vertices coincide with others, the first {first(loose)}: a seam that will open."
        )
        faults.append(Fault("unwelded", sentence, "weld them", "", True, vertices=loose))
    threads = sewable_threads(surface)
    if (count := _pieces(surface, threads)) > 1:
        sentence = f"The garment is in {count} pieces that nothing holds together."
        fix = (
            "weld the seams between them"
            if len(loose)
            else "join them in the program they come from, or delete all but one"
        )
        if (gap := gap_between(surface)) is not None and gap.pairs:
            along = f"{gap.pairs} vertices of their borders face each other {1000 * gap.along:.2g} mm apart"
            sentence = f"{sentence[:-1]}: {along}."
            fix = f"merge vertices within {1000 * gap.along * 1.5:.2g} mm in the program it comes from"
        elif gap is not None:
            sentence = f"{sentence[:-1]}, {100 * gap.nearest:.2g} cm apart at the nearest."
        faults.append(Fault("pieces", sentence, fix, mendable=bool(len(loose))))
    if len(threads):
        ends = surface.source.vertices[threads]
        longest = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max()
        sentence = f"{len(threads)} lines of its file are threads of seams, up to {100 * longest:.2g} cm long."
        fix, sewing = "none is needed: they are sewn", "they are sewn: both ends are merged at their midpoint"
        faults.append(Fault("threads", sentence, fix, sewing, vertices=np.unique(threads), is_note=True))
    if len(lines := surface.unsewn) > len(threads):
        lines = lines[~(lines[:, None] == threads).all(axis=2).any(axis=1)]
        sentence = f"{len(lines)} lines of its file join vertices like threads of a seam, the first {first(lines)}."
        fix = (
            f"they are not sewn, since they are longer than {100 * FARTHEST:.0f} cm, end inside the cloth, or would "
            "fold it: bring the borders together in the program it comes from, or give it as a pattern"
        )
        faults.append(Fault("unsewn", sentence, fix, vertices=np.unique(lines)))
    if len(turned := surface.turned_over):
        sentence = f"{len(turned)} face(s) are flipped relative to their neighbours, the first {first(turned)}."
        faults.append(Fault("orientation", sentence, "flip them", "they are flipped for the simulation", True, turned))
    if not surface.flipped[1]:
        sentence = "The cloth has only one side, like a Moebius strip."
        faults.append(Fault("one-sided", sentence, "cut it open at the twist"))
    if is_double(surface):
        share = surface.double.mean()
        polygons = surface.polygon[surface.kept[surface.double]]
        sentence = f"{100 * share:.0f}% of the cloth is double, back to back, the first faces {first(polygons)}."
        faults.append(Fault("double-layer", sentence, "keep the outer layer only", mendable=True, faces=polygons))
    lengths = edge_lengths(surface.source.vertices, topology.edges)
    if lengths.std() > _GRADED * lengths.mean():
        sentence = f"Edge lengths vary by {lengths.std() / lengths.mean():.2f} of their mean, more than {_GRADED}."
        fix = f"simulate it evenly meshed with `--triangles {len(surface.faces)}`"
        faults.append(Fault("graded", sentence, fix))
    if len(bare := surface.untextured):
        sentence = f"{len(bare)} of its {len(surface.source.polygons)} faces have no UVs, the first {first(bare)}."
        fix = "unwrap them in the program they come from to see images and threads there"
        faults.append(Fault("no-uvs", sentence, fix, faces=bare))
    return faults


def _pieces(surface: SourceSurface, threads: np.ndarray) -> int:
    """Number of connected pieces, once the threads (threads, 2) are sewn."""
    ends = surface.topology.piece_of_vertex
    joined = connected_labels(len(ends), *ends[threads].T)
    return len(np.unique(joined[ends[surface.faces[:, 0]]]))


def is_double(surface: SourceSurface) -> bool:
    """Whether so much of the cloth is double that it is a shell or a lining, not a hem.

    Args:
        surface: the mesh.
    """
    return bool(len(surface.faces)) and float(surface.double.mean()) > _DOUBLE


def first_of(ids: np.ndarray) -> str:
    """The first of some indices (n,), or of pairs of indices (n, 2), as text.

    Args:
        ids: (n,) or (n, 2) int64.
    """
    rows = np.asarray(ids)[:5].tolist()
    return ", ".join("-".join(map(str, row)) if isinstance(row, list) else str(row) for row in rows)
