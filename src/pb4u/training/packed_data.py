"""Training data in memory and as one file: bodies, garments and poses. Vertices are posed on the training machine."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence, Skeleton
from pb4u.body.skinning import SkinningWeights
from pb4u.errors import InputError, on_disk
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.io.array_archive import read_arrays
from pb4u.io.atomic_file import replace_file
from pb4u.io.reading_limits import parse_json, refusing

FORMAT_VERSION = 1
_STEPS = 32767.0


@dataclass(frozen=True, eq=False)
class Outfit:
    """A garment at one resolution, cut for one body.

    Args:
        garment: rest shape.
        weights: its skinning weights.
        body: index of the body.
    """

    garment: Garment
    weights: SkinningWeights
    body: int


@dataclass(frozen=True, eq=False)
class PosedClip:
    """Poses of one body over a clip of motion.

    Args:
        name: name of the motion, with its seed.
        split: "train" or "validation".
        body: index of the body.
        poses: poses rounded by `rounded_poses`, so that a pack stores them exactly.
    """

    name: str
    split: str
    body: int
    poses: PoseSequence


@dataclass(frozen=True, eq=False)
class TrainingData:
    """All data from which training samples are made.

    Args:
        bodies: bodies at rest.
        outfits: garments that they wear.
        clips: poses of the bodies.

    Raises:
        InputError: a body has no garment or no motion, or where a body's poses correct its surface.
    """

    bodies: tuple[ShapedBody, ...]
    outfits: tuple[Outfit, ...]
    clips: tuple[PosedClip, ...]

    def __post_init__(self) -> None:
        for index, body in enumerate(self.bodies):
            if body.pose_offsets is not None:
                raise InputError(f"{body.name} has corrective shapes; train on bodies without them.")
            wears = any(outfit.body == index for outfit in self.outfits)
            if not wears or not any(clip.body == index and clip.split == "train" for clip in self.clips):
                raise InputError(f"Body {index} ({body.name}) has no garment or no motion to train on.")

    @property
    def edge_lengths(self) -> tuple[float, float]:
        """Finest and coarsest mean rest edge length [m]."""
        lengths = [outfit.garment.mean_edge_length for outfit in self.outfits]
        return min(lengths), max(lengths)


def rounded_poses(poses: PoseSequence) -> PoseSequence:
    """Poses as a pack stores them, 16 bits for each number of a rotation: within 0.003 degrees, and float32 roots.

    Floating-point halves would be ten times coarser, enough to shake a hand by a third of a millimetre.

    Args:
        poses: the poses.
    """
    return PoseSequence(
        _fixed_point(poses.rotations) / _STEPS, poses.root_positions.astype(np.float32).astype(np.float64), poses.fps
    )


def _fixed_point(rotations: np.ndarray) -> np.ndarray:
    return np.rint(rotations * _STEPS).astype(np.int16)


def save_training_data(data: TrainingData, path: Path | str) -> None:
    """Write training data as a compressed .npz without pickles; it appears whole or not at all.

    Args:
        data: bodies, outfits and clips.
        path: path of the file.

    Raises:
        InputError: the folder cannot be written.
    """
    path = Path(path)
    header: dict[str, Any] = {"format_version": FORMAT_VERSION, "bodies": [], "outfits": [], "clips": []}
    arrays: dict[str, np.ndarray] = {}
    for i, body in enumerate(data.bodies):
        like = next(j for j, other in enumerate(data.bodies) if j == i or _same_skin(other, body))
        header["bodies"].append(
            {
                "name": body.name,
                "family": body.family,
                "shape": dict(body.shape),
                "lift": body.lift,
                "bones": list(body.skeleton.names),
                "skin_of": like,
            }
        )
        arrays |= {f"body{i}.vertices": body.vertices, f"body{i}.joints": body.skeleton.joints}
        if like == i:
            arrays |= {
                f"body{i}.parents": body.skeleton.parents.astype(np.int16),
                f"body{i}.faces": body.faces.astype(np.int32),
                f"body{i}.contact": body.contact,
                **_weight_arrays(f"body{i}", body.weights),
            }
    for i, outfit in enumerate(data.outfits):
        garment = outfit.garment
        header["outfits"].append(
            {
                "name": garment.name,
                "body": outfit.body,
                "loose": garment.loose,
                "material": asdict(garment.material),
                "coarse_levels": len(garment.coarse_edges),
            }
        )
        arrays |= {
            f"outfit{i}.vertices": garment.vertices,
            f"outfit{i}.faces": garment.faces.astype(np.int32),
            f"outfit{i}.pinned": garment.pinned,
            **{f"outfit{i}.coarse{level}": edges for level, edges in enumerate(garment.coarse_edges)},
            **_weight_arrays(f"outfit{i}", outfit.weights),
        }
    for i, clip in enumerate(data.clips):
        header["clips"].append({"name": clip.name, "split": clip.split, "body": clip.body, "fps": clip.poses.fps})
        arrays[f"clip{i}.rotations"] = _fixed_point(clip.poses.rotations)
        arrays[f"clip{i}.roots"] = clip.poses.root_positions.astype(np.float32)
    arrays["header"] = np.array(json.dumps(header))
    _write(path, arrays)


def _same_skin(a: ShapedBody, b: ShapedBody) -> bool:
    pairs = (
        (a.faces, b.faces),
        (a.contact, b.contact),
        (a.weights.bones, b.weights.bones),
        (a.weights.weights, b.weights.weights),
        (a.skeleton.parents, b.skeleton.parents),
    )
    return all(np.array_equal(x, y) for x, y in pairs)


def _weight_arrays(prefix: str, weights: SkinningWeights) -> dict[str, np.ndarray]:
    return {f"{prefix}.bones": weights.bones.astype(np.int16), f"{prefix}.weights": weights.weights}


def _write(path: Path, arrays: dict[str, np.ndarray]) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    with on_disk(f"Cannot write {path}"):
        replace_file(path, content.getvalue())


def load_training_data(path: Path | str) -> TrainingData:
    """Training data in a file that `save_training_data` wrote.

    Args:
        path: path of the .npz.

    Raises:
        InputError: the file is absent, cut short, of a newer format or no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no training pack {path}; write one with `pb4u assets pack`.")
    with refusing(path, "is not a complete training pack; write it again with `pb4u assets pack`"):
        arrays = read_arrays(path)
        header = parse_json(str(arrays["header"]))
        if header["format_version"] > FORMAT_VERSION:
            raise InputError(f"{path} is a training pack of a newer format; upgrade pb4u or write the pack again.")
        bodies: list[ShapedBody] = []
        for i, record in enumerate(header["bodies"]):
            bodies.append(_body(i, record, arrays, bodies))
        return TrainingData(tuple(bodies), tuple(_outfits(header, arrays)), tuple(_clips(header, arrays)))


def _body(i: int, record: dict[str, Any], arrays: dict[str, np.ndarray], before: list[ShapedBody]) -> ShapedBody:
    like = None if record["skin_of"] == i else before[record["skin_of"]]
    parents = like.skeleton.parents if like else arrays[f"body{i}.parents"].astype(np.int64)
    return ShapedBody(
        name=record["name"],
        family=record["family"],
        vertices=arrays[f"body{i}.vertices"],
        faces=like.faces if like else arrays[f"body{i}.faces"].astype(np.int64),
        skeleton=Skeleton(tuple(record["bones"]), parents, arrays[f"body{i}.joints"]),
        weights=like.weights if like else _weights(f"body{i}", arrays),
        contact=like.contact if like else arrays[f"body{i}.contact"],
        shape=record["shape"],
        lift=record["lift"],
    )


def _weights(prefix: str, arrays: dict[str, np.ndarray]) -> SkinningWeights:
    return SkinningWeights(arrays[f"{prefix}.bones"].astype(np.int64), arrays[f"{prefix}.weights"])


def _outfits(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Iterator[Outfit]:
    for i, record in enumerate(header["outfits"]):
        garment = Garment(
            record["name"],
            arrays[f"outfit{i}.vertices"],
            arrays[f"outfit{i}.faces"].astype(np.int64),
            Material.of(record["material"]),
            arrays[f"outfit{i}.pinned"],
            loose=record["loose"],
            coarse_edges=tuple(arrays[f"outfit{i}.coarse{n}"] for n in range(record.get("coarse_levels", 0))),
        )
        yield Outfit(garment, _weights(f"outfit{i}", arrays), int(record["body"]))


def _clips(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Iterator[PosedClip]:
    for i, record in enumerate(header["clips"]):
        rotations = arrays[f"clip{i}.rotations"] / _STEPS
        roots = arrays[f"clip{i}.roots"].astype(np.float64)
        yield PosedClip(
            record["name"], record["split"], int(record["body"]), PoseSequence(rotations, roots, record["fps"])
        )
