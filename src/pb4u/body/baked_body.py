"""The built-in bodies, read from a small file of the package that needs no Anny."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from pb4u.body.body_model import BodyModel
from pb4u.body.built_in import BUILT_IN
from pb4u.body.skinning import SkinningWeights
from pb4u.errors import InputError
from pb4u.io.array_archive import read_arrays
from pb4u.io.stored_numbers import Layout, read_members, require_places

FORMAT_VERSION = 1
_LAYOUT: Layout = {
    "format_version": ("iu", ()),
    "parameter_names": ("U", ("parameters",)),
    "parameter_ranges": ("f", ("parameters", 3)),
    "term_basis": ("iu", ("terms", "parameters")),
    "term_vertices": ("iu", ("terms", "vertices", 3)),
    "term_vertex_steps": ("f", ("terms",)),
    "term_joints": ("f", ("terms", "bones", 3)),
    "faces": ("iu", ("faces", 3)),
    "bone_names": ("U", ("bones",)),
    "bone_parents": ("i", ("bones",)),
    "weight_bones": ("iu", ("vertices", "influences")),
    "weights": ("fiu", ("vertices", "influences")),
    "contact": ("b", ("vertices",)),
}
_POINTS_AT = {"faces": "vertices", "weight_bones": "bones"}


def shape_basis(offsets: np.ndarray, term_basis: np.ndarray) -> np.ndarray:
    """Coefficients of the shape terms of a body.

    Anny is linear in each parameter on either side of its default, so each parameter contributes a factor 1, d or
    max(d, 0): products of these span its shapes exactly.

    Args:
        offsets: (parameters,) d, how far each parameter is from its default [1].
        term_basis: (terms, parameters) in {0, 1, 2}, which factor each parameter contributes to each term.

    Returns:
        (terms,) float64 [1].
    """
    factors = np.stack([np.ones_like(offsets), offsets, np.maximum(offsets, 0.0)])
    return np.prod(factors[term_basis, np.arange(len(offsets))], axis=1)


def _require_consistent(members: Mapping[str, np.ndarray], path: Path) -> None:
    def refuse(what: str) -> InputError:
        return InputError(f"{path}: not a baked body, {what}; bake it again.")

    counts = read_members(members, _LAYOUT, refuse)[1]
    require_places(members, _POINTS_AT, counts, refuse)
    if members["format_version"] != FORMAT_VERSION:
        raise refuse(f"it is of format {int(members['format_version'])} and not {FORMAT_VERSION}")
    for count in ("vertices", "faces", "bones", "influences"):
        if not counts[count]:
            raise refuse(f"it has no {count}")
    for name in ("parameter_ranges", "term_vertex_steps", "term_joints", "weights"):
        if not np.isfinite(members[name]).all():
            raise refuse(f"{name} is not finite")
    basis, ranges, parents = members["term_basis"], members["parameter_ranges"], members["bone_parents"]
    if basis.size and not 0 <= basis.min() <= basis.max() <= 2:
        raise refuse("term_basis holds something other than 0, 1 and 2")
    if not (np.diff(ranges, axis=1) >= 0).all() or len(set(members["parameter_names"].tolist())) < len(ranges):
        raise refuse("its parameters have no range, or no names of their own")
    if parents[0] != -1 or (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, len(parents))).any():
        raise refuse("a bone comes before its parent")
    if (members["weights"] < 0).any() or not (members["weights"].sum(axis=1) > 0).all():
        raise refuse("weights has negative or empty rows")


class BakedBody(BodyModel):
    """A body with a few shape parameters, read from a file that `tools/bake_bodies.py` wrote.

    Args:
        path: the .npz.

    Raises:
        InputError: it is not a file of a baked body.
    """

    family = "anny"

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        self.name = path.stem
        members = read_arrays(path, _LAYOUT)
        _require_consistent(members, path)
        self._names = tuple(members["parameter_names"].tolist())
        self._ranges = members["parameter_ranges"]
        self._term_basis = members["term_basis"].astype(np.int64)
        # Differences along the vertex order were stored: neighbours move alike, which compresses better.
        self._term_vertices = np.cumsum(members["term_vertices"].astype(np.int32), axis=1)
        self._term_vertex_steps = members["term_vertex_steps"]
        self._term_joints = members["term_joints"]
        self.faces = members["faces"].astype(np.int64)
        self.bone_names = tuple(members["bone_names"].tolist())
        self.bone_parents = members["bone_parents"].astype(np.int64)
        weights = members["weights"].astype(np.float64)
        self.weights = SkinningWeights(
            members["weight_bones"].astype(np.int64),
            (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        )
        self.contact = members["contact"].astype(bool)

    @staticmethod
    @lru_cache(maxsize=len(BUILT_IN))
    def built_in(name: str) -> BakedBody:
        """The body of the package called `name`, one of `BUILT_IN`.

        Args:
            name: one of `BUILT_IN`.
        """
        with as_file(files("pb4u.body").joinpath("data", f"{name}.npz")) as path:
            return BakedBody(path)

    @property
    def shape_parameters(self) -> Mapping[str, tuple[float, float, float]]:
        return {name: tuple(row) for name, row in zip(self._names, self._ranges.tolist(), strict=True)}

    def rest(self, parameters: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        offsets = np.array(list(parameters.values())) - self._ranges[:, 1]
        coefficients = shape_basis(offsets, self._term_basis)
        used = np.flatnonzero(coefficients)
        scale = (coefficients * self._term_vertex_steps)[used]
        vertices = np.einsum("t,tvc->vc", scale, self._term_vertices[used])
        return vertices, np.einsum("t,tbc->bc", coefficients, self._term_joints)
