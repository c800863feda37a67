"""SMPL, SMPL-H and SMPL-X, from model files that the user has licensed and downloaded."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.body.body_model import BodyModel, ShapedBody, complete_parameters
from pb4u.body.skeleton import Skeleton
from pb4u.body.skinning import SkinningWeights, strongest_influences
from pb4u.errors import InputError
from pb4u.restricted_pickle import load_pickle

BETA_RANGE = (-10.0, 0.0, 10.0)
_MEMBERS = ("v_template", "shapedirs", "posedirs", "J_regressor", "kintree_table", "weights", "f")
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
_HAND_JOINTS = {"left_wrist", "right_wrist", "left_hand", "right_hand", *_FINGERS}
_MAX_INFLUENCES = 8
# A SMPL-X file appends 10 or 100 expression directions to its 10 or 300 of shape.
_SMPLX_EXPRESSIONS = {20: 10, 400: 100}


@dataclass(frozen=True, eq=False)
class _Members:
    """The arrays of a model file, checked against each other: V vertices, J joints, B betas, P pose features."""

    template: np.ndarray
    shape_directions: np.ndarray
    pose_offsets: np.ndarray
    joint_regressor: Any
    parents: np.ndarray
    weights: np.ndarray
    faces: np.ndarray


class SmplBody(BodyModel):
    """SMPL (Loper et al. 2015), SMPL-H (Romero et al. 2017) or SMPL-X (Pavlakos et al. 2019), told by its joints.

    At rest it stands in the T-pose of its file, feet on y = 0; that is the pose that garments are fitted to.
    Its shape parameters are beta0, beta1, ..; expressions are left at zero.

    Raises InputError when the file is not such a model; a .pkl is read without running anything in it.
    """

    def __init__(self, path: str | Path) -> None:
        self.name = Path(path).stem
        self._members = _read(Path(path))
        joints = len(self._members.parents)
        self.family = next(family for family, names in JOINT_NAMES.items() if len(names) == joints)
        self.faces = self._members.faces
        self.weights = strongest_influences(
            np.broadcast_to(np.arange(joints), self._members.weights.shape), self._members.weights, _MAX_INFLUENCES
        )
        self.contact = ~self._hands(self.weights)

    @property
    def shape_parameters(self) -> Mapping[str, tuple[float, float, float]]:
        return {f"beta{k}": BETA_RANGE for k in range(self._members.shape_directions.shape[2])}

    def shaped(self, **parameters: float) -> ShapedBody:
        """The body with these betas. Raises InputError on an unknown name or a value out of range."""
        complete = complete_parameters(self.name, self.shape_parameters, parameters)
        members = self._members
        vertices = members.template + members.shape_directions @ np.array(list(complete.values()))
        joints = np.asarray(members.joint_regressor @ vertices)
        lift = np.array([0.0, -vertices[:, 1].min(), 0.0])
        return ShapedBody(
            name=self.name,
            family=self.family,
            vertices=vertices + lift,
            faces=self.faces,
            skeleton=Skeleton(JOINT_NAMES[self.family], members.parents, joints + lift),
            weights=self.weights,
            contact=self.contact,
            shape=complete,
            pose_offsets=members.pose_offsets,
            lift=float(lift[1]),
        )

    def _hands(self, weights: SkinningWeights) -> np.ndarray:
        of_hand = np.array([name in _HAND_JOINTS for name in JOINT_NAMES[self.family]])
        return np.where(of_hand[weights.bones], weights.weights, 0.0).sum(axis=1) > 0.5


def _read(path: Path) -> _Members:
    raw = _load(path)
    arrays = {key: raw[key] if hasattr(raw[key], "tocsr") else np.asarray(raw[key]) for key in _MEMBERS}
    vertices, joints = (arrays["v_template"].shape or (0,))[0], (arrays["kintree_table"].shape or (0,))[-1]
    if joints not in [len(names) for names in JOINT_NAMES.values()]:
        raise InputError(f"{path} has {joints} joints; SMPL has 24, SMPL-H 52 and SMPL-X 55.")
    expected: dict[str, tuple[int | None, ...]] = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, None),
        "posedirs": (vertices, 3, 9 * (joints - 1)),
        "J_regressor": (joints, vertices),
        "kintree_table": (2, joints),
        "weights": (vertices, joints),
        "f": (None, 3),
    }
    for key, shape in expected.items():
        found = tuple(arrays[key].shape)
        if len(found) != len(shape) or any(n is not None and n != m for n, m in zip(shape, found, strict=True)):
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise InputError(f'{path}: "{key}" has shape {found}; with {vertices} vertices it needs ({wanted}).')
    numbers = {key: _finite(path, key, arrays[key]) for key in ("v_template", "shapedirs", "posedirs", "weights")}
    directions = numbers["shapedirs"]
    if joints == len(JOINT_NAMES["smplx"]):
        directions = directions[:, :, : directions.shape[2] - _SMPLX_EXPRESSIONS.get(directions.shape[2], 0)]
    return _Members(
        template=numbers["v_template"],
        shape_directions=directions,
        pose_offsets=numbers["posedirs"].astype(np.float32),
        joint_regressor=_regressor(path, arrays["J_regressor"]),
        parents=_parents(path, arrays["kintree_table"][0]),
        weights=_weights(path, numbers["weights"]),
        faces=_faces(path, arrays["f"], vertices),
    )


def _load(path: Path) -> Mapping[str, Any]:
    if path.suffix.lower() == ".pkl":
        raw = load_pickle(path)
        if not isinstance(raw, dict):
            raise InputError(f"{path} holds a {type(raw).__name__}, not the members of an SMPL model.")
        members = raw
    else:
        try:
            with np.load(path, allow_pickle=False) as archive:
                members = {key: archive[key] for key in _MEMBERS if key in archive.files}
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise InputError(f"{path}: not a readable .npz of plain arrays ({error}).") from error
    if missing := [key for key in _MEMBERS if key not in members]:
        raise InputError(f"{path}: not an SMPL, SMPL-H or SMPL-X model, it lacks {', '.join(missing)}.")
    return members


def _finite(path: Path, key: str, values: np.ndarray) -> np.ndarray:
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f'{path}: "{key}" does not hold plain numbers.') from None
    if not np.isfinite(numbers).all():
        raise InputError(f'{path}: "{key}" holds numbers that are not finite; download the model again.')
    return numbers


def _regressor(path: Path, regressor: Any) -> Any:
    """The regressor (joints, vertices), sparse where the file has it so."""
    if hasattr(regressor, "tocsr"):
        sparse = regressor.tocsr().astype(np.float64)
        _finite(path, "J_regressor", sparse.data)
        return sparse
    return _finite(path, "J_regressor", np.asarray(regressor))


def _parents(path: Path, row: np.ndarray) -> np.ndarray:
    """(joints,) int64, -1 for the root, which the files write as -1 or 2^32 - 1."""
    parents = np.asarray(row, dtype=np.float64).astype(np.int64)
    parents[0] = -1
    if (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, len(parents))).any():
        raise InputError(f'{path}: in "kintree_table" a joint comes before its parent; download the model again.')
    return parents


def _weights(path: Path, weights: np.ndarray) -> np.ndarray:
    if (weights < 0).any() or (weights.sum(axis=1) < 1e-6).any():
        raise InputError(f'{path}: "weights" has negative or empty rows; download the model again.')
    return weights


def _faces(path: Path, faces: np.ndarray, vertices: int) -> np.ndarray:
    if faces.dtype.kind not in "iu" or not len(faces) or faces.min() < 0 or faces.max() >= vertices:
        raise InputError(f'{path}: "f" must hold vertex numbers from 0 to {vertices - 1}.')
    return faces.astype(np.int64)
