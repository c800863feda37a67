"""SMPL, SMPL-H and SMPL-X, from model files that the user has licensed and downloaded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pb4u.body.body_model import BodyModel
from pb4u.body.skeleton import hand_bones
from pb4u.body.skinning import strongest_influences
from pb4u.errors import InputError
from pb4u.io.array_archive import read_arrays
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import Layout, read_members, require_places, stored_numbers

BETA_RANGE = (-10.0, 0.0, 10.0)
"""Lowest, default and highest shape coefficient, in standard deviations; others are refused."""
_LAYOUT: Layout = {
    "v_template": ("fiu", ("vertices", 3)),
    "kintree_table": ("fiu", (2, "joints")),
    "shapedirs": ("fiu", ("vertices", 3, None)),
    "posedirs": ("fiu", ("vertices", 3, "pose features")),
    "J_regressor": ("fiu", ("joints", "vertices")),
    "weights": ("fiu", ("vertices", "joints")),
    "f": ("iu", ("faces", 3)),
}
_BODY_JOINTS = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
_FINGERS = tuple(
    f"{side}_{finger}{segment}"
    for side in ("left", "right")
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for segment in (1, 2, 3)
)
JOINT_NAMES: Mapping[str, tuple[str, ...]] = {
    "smpl": (*_BODY_JOINTS, "left_hand", "right_hand"),
    "smplh": (*_BODY_JOINTS, *_FINGERS),
    "smplx": (*_BODY_JOINTS, "jaw", "left_eye_smplhf", "right_eye_smplhf", *_FINGERS),
}
# Bones that move one vertex at most, which bounds the cost of skinning; the others' shares go to these.
_MAX_INFLUENCES = 8
_OMITTED_TYPE = 2
"""Type of a body vertex left out of contact in the released code."""
_LARGEST = 1e4
"""Numbers of a model, which are metres or shares, beyond which they are damaged."""
# A SMPL-X file appends 10 or 100 expression directions to its 10 or 300 of shape.
_SMPLX_EXPRESSIONS = {20: 10, 400: 100}


class SmplBody(BodyModel):
    """SMPL (Loper et al. 2015), SMPL-H (Romero et al. 2017) or SMPL-X (Pavlakos et al. 2019), by its number of joints.

    At rest it stands in the T-pose of its file, feet on y = 0; that is the pose that garments are fitted to.
    Its shape parameters are beta0, beta1, ..; expressions are left at zero.

    Args:
        path: the .npz or .pkl; a .pkl is read without running any code in it.

    Raises:
        InputError: the file is not such a model.
    """

    def __init__(self, path: str | Path) -> None:
        path = Path(path)

        def refuse(what: str) -> InputError:
            return InputError(f"{path}: not an SMPL, SMPL-H or SMPL-X model, {what}; download the model again.")

        content = load_pickle(path) if path.suffix.lower() == ".pkl" else read_arrays(path, _LAYOUT)
        arrays, counts = read_members(content, _LAYOUT, refuse)
        joints = counts["joints"]
        families = [family for family, names in JOINT_NAMES.items() if len(names) == joints]
        if not families:
            raise InputError(f"{path} has {joints} joints; SMPL has 24, SMPL-H 52 and SMPL-X 55.")
        if not counts["vertices"] or counts["pose features"] != 9 * (joints - 1):
            raise refuse(f"it has {counts['vertices']} vertices and {counts['pose features']} pose features")
        require_places(arrays, {"f": "vertices"}, counts, refuse)
        self.name, self.family = path.stem, families[0]
        self.bone_names, self.bone_parents = JOINT_NAMES[self.family], _parents(path, arrays["kintree_table"][0])
        self._template = _finite(path, "v_template", arrays["v_template"])
        directions = _finite(path, "shapedirs", arrays["shapedirs"])
        count = directions.shape[2]
        self._directions = directions[:, :, : count - (self.family == "smplx") * _SMPLX_EXPRESSIONS.get(count, 0)]
        self._regressor = arrays["J_regressor"]
        if hasattr(self._regressor, "tocsr"):
            self._regressor = self._regressor.tocsr().astype(np.float64)
            _finite(path, "J_regressor", self._regressor.data)
        else:
            self._regressor = _finite(path, "J_regressor", self._regressor)
        self.pose_offsets = _finite(path, "posedirs", arrays["posedirs"]).astype(np.float32)
        weights = _finite(path, "weights", arrays["weights"])
        if (weights < 0).any() or (weights.sum(axis=1) < 1e-6).any():
            raise InputError(f'{path}: "weights" has negative or empty rows; download the model again.')
        self.weights = strongest_influences(np.broadcast_to(np.arange(joints), weights.shape), weights, _MAX_INFLUENCES)
        self.faces = arrays["f"].astype(np.int64)
        self.contact = self.weights.share_of(hand_bones(self.bone_names, self.bone_parents)) <= 0.5

    @property
    def shape_parameters(self) -> Mapping[str, tuple[float, float, float]]:
        return {f"beta{k}": BETA_RANGE for k in range(self._directions.shape[2])}

    def rest(self, parameters: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        vertices = self._template + self._directions @ np.array(list(parameters.values()))
        return vertices, np.asarray(self._regressor @ vertices)


def _finite(path: Path, key: str, values: np.ndarray) -> np.ndarray:
    numbers = values.astype(np.float64, copy=False)
    if not (np.abs(numbers) <= _LARGEST).all():
        raise InputError(
            f'{path}: "{key}" holds numbers that are not finite, or beyond {_LARGEST:g}; download the model again.'
        )
    return numbers


def _parents(path: Path, row: np.ndarray) -> np.ndarray:
    """(joints,) int64, -1 for the root, which the files write as -1 or 2^32 - 1."""
    parents = np.asarray(row, dtype=np.float64).astype(np.int64)
    parents[0] = -1
    if (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, len(parents))).any():
        raise InputError(f'{path}: in "kintree_table" a joint comes before its parent; download the model again.')
    return parents


def read_contact(path: Path, vertices: int) -> np.ndarray:
    """Flags (vertices,) bool of the body vertices that may be touched, from a file of those left out.

    Args:
        path: `smpl_aux.pkl` of the released code, {"vertex_type": 1, or 2 where left out}, or indices as text.
        vertices: number of vertices of the body.

    Raises:
        InputError: the file has neither format, or is for another body.
    """
    if not path.is_file():
        raise InputError(f"There is no file {path} of body vertices to leave out.")
    contact = np.ones(vertices, dtype=bool)
    if path.suffix.lower() != ".pkl":
        try:
            omitted = np.array(
                [int(word) for word in path.read_text(encoding="utf-8").replace(",", " ").split()], dtype=np.int64
            )
        except (OSError, ValueError, OverflowError):
            raise InputError(f"{path} is not a list of vertex numbers; write one a line.") from None
        if len(omitted) and not 0 <= omitted.min() <= omitted.max() < vertices:
            raise InputError(f"{path} names vertices that the body does not have; it has {vertices:,}.")
        contact[omitted] = False
        return contact
    content = load_pickle(path)
    values = content.get("vertex_type", ()) if isinstance(content, Mapping) else ()
    types = stored_numbers(values, path, "vertex_type")
    if types.dtype.kind not in "iu" or types.size != vertices:
        raise InputError(
            f'{path} should hold "vertex_type", a number for each of the {vertices:,} vertices of the body.'
        )
    return types.reshape(-1) != _OMITTED_TYPE
