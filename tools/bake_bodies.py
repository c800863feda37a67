"""Bakes the built-in bodies from Anny into the small files that ship with the package.

Needs the extra "anny": python tools/bake_bodies.py [FOLDER]
"""

from __future__ import annotations

import io
import itertools
import sys
from pathlib import Path

import numpy as np

import pb4u.body
from pb4u.body.anny_body import AnnyBody
from pb4u.body.baked_body import FORMAT_VERSION, shape_basis
from pb4u.body.built_in import BUILT_IN
from pb4u.body.contact_region import reachable
from pb4u.io.atomic_file import replace_file

GENDER = {"woman": 1.0, "man": 0.0}
PARAMETERS = ("height", "weight", "muscle")
# Anny interpolates height between two anchors and weight and muscle between three (0, 0.5, 1).
_FACTORS = {"height": (0, 1), "weight": (0, 1, 2), "muscle": (0, 1, 2)}
# Positions are stored in whole steps of this [m] or more, which bounds the size of the files and their rounding.
_VERTEX_STEP = 5e-6


def bake(out_folder: str | Path | None = None) -> list[Path]:
    """Write one file per built-in body; the same version of Anny gives the same files, byte for byte.

    Args:
        out_folder: where, the package itself by default.

    Returns:
        The paths of the files.

    Raises:
        MissingExtraError: the "anny" extra is not installed.
    """
    folder = Path(str(pb4u.body.__file__)).parent / "data" if out_folder is None else Path(out_folder)
    folder.mkdir(parents=True, exist_ok=True)
    anny = AnnyBody()
    return [_bake_one(anny, name, folder / f"{name}.npz") for name in BUILT_IN]


def _bake_one(anny: AnnyBody, name: str, path: Path) -> Path:
    term_basis = np.array(list(itertools.product(*(_FACTORS[key] for key in PARAMETERS))), dtype=np.uint8)
    vertices, joints = _shape_terms(anny, GENDER[name], term_basis.astype(np.int64))
    steps = np.maximum(_VERTEX_STEP, np.abs(vertices).max(axis=(1, 2)) / 32000)
    quantised = np.rint(vertices / steps[:, None, None]).astype(np.int64)
    vertices_at_rest, _ = anny.rest({"gender": GENDER[name], "age": 0.67})
    weights = anny.weights
    # Cut off behind its first bone each finger leaves a small ring. One around all knuckles is too crooked to close.
    of_fingers = np.array([bone.startswith("finger") and "-1" not in bone for bone in anny.bone_names])
    file = io.BytesIO()
    np.savez_compressed(
        file,
        format_version=np.int64(FORMAT_VERSION),
        parameter_names=np.array(PARAMETERS),
        parameter_ranges=np.array([anny.shape_parameters[key] for key in PARAMETERS]),
        term_basis=term_basis,
        term_vertices=np.diff(quantised, axis=1, prepend=0).astype(np.int32),
        term_vertex_steps=steps,
        term_joints=joints,
        faces=anny.faces.astype(np.uint16),
        bone_names=np.array(anny.bone_names),
        bone_parents=anny.bone_parents.astype(np.int16),
        weight_bones=weights.bones.astype(np.uint8),
        weights=np.rint(weights.weights * 65535.0).astype(np.uint16),
        contact=reachable(vertices_at_rest, anny.faces) & (weights.share_of(of_fingers) <= 0.5),
    )
    replace_file(path, file.getvalue())
    return path


def _shape_terms(anny: AnnyBody, gender: float, term_basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (terms, vertices, 3) and joints (terms, bones, 3) of each shape term, from samples of Anny.

    The samples lie where the parameters bend, at the ends and the middle of their ranges, as many as there are terms.
    """
    places = {0: 0.5, 1: 0.0, 2: 1.0}
    samples = np.array([[places[factor] for factor in row] for row in term_basis.tolist()])
    basis = np.stack([shape_basis(sample - 0.5, term_basis) for sample in samples])
    inverse = np.linalg.inv(basis)
    rests = [
        anny.rest({"gender": gender, "age": 0.67, **dict(zip(PARAMETERS, sample.tolist(), strict=True))})
        for sample in samples
    ]
    vertices = np.einsum("ts,svc->tvc", inverse, np.stack([vertices for vertices, _ in rests]))
    joints = np.einsum("ts,sbc->tbc", inverse, np.stack([joints for _, joints in rests]))
    return vertices, joints


if __name__ == "__main__":
    bake(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
