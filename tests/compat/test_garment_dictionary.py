"""Garments dictionaries and templates of the released code."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse

from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.compat.garment_dictionary import read_dictionary_garment
from pb4u.errors import InputError
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.material import MATERIALS
from pb4u.io.restricted_pickle import load_pickle
from pb4u.run import Run, WornGarment
from pb4u.scene.assembly import build_scene


def garment_fields(rows: int = 5, columns: int = 4, bones: int = 24) -> dict[str, Any]:
    """A small sheet as the released code writes a garment."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    vertices = np.stack([0.05 * i, -0.02 * i * j, 0.05 * j], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (i * columns + j)[:-1, :-1].reshape(-1)
    lower, upper = (corner, corner + 1, corner + columns), (corner + 1, corner + columns + 1, corner + columns)
    faces = np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)])
    count, rng = len(vertices), np.random.default_rng(1)
    weights = rng.random((count, bones)).astype(np.float32)
    types = np.zeros((count, 1), dtype=np.int64)
    types[:columns] = 3
    return {
        "rest_pos": vertices,
        "faces": faces,
        "node_type": types,
        "lbs": {
            "v": vertices,
            "f": faces.astype(np.int32),
            "shapedirs": 0.01 * rng.normal(size=(count, 3, 10)).astype(np.float32),
            "posedirs": 0.001 * rng.normal(size=(9 * (bones - 1), 3 * count)).astype(np.float32),
            "lbs_weights": weights / weights.sum(axis=1, keepdims=True),
        },
        "center": [np.int64(5), np.int64(9)],
        "coarse_edges": {
            np.int64(5): {0: np.array([[0, 2], [4, 6]]), 1: np.array([[0, 6]]), 2: np.zeros(0)},
            np.int64(9): {0: np.array([[1, 3]]), 1: np.zeros(0), 2: np.zeros(0)},
        },
    }


def written(path: Path, content: Any) -> Path:
    path.write_bytes(pickle.dumps(content))
    return path


def read(text: str | Path) -> Any:
    entry = DictionaryEntry.parse(text)
    assert entry is not None
    return read_dictionary_garment(entry, MATERIALS["default"])


def test_a_garment_brings_pins_coarse_levels_and_skinning(tmp_path: Path) -> None:
    fields = garment_fields()
    path = written(tmp_path / "all.pkl", {"sheet": fields, "other": garment_fields(3, 3)})
    garment = read(f"{path}:sheet")
    assert garment.name == "sheet"
    np.testing.assert_array_equal(garment.vertices, fields["rest_pos"])
    assert garment.pinned.sum() == 4
    assert [edges.tolist() for edges in garment.coarse_edges] == [[[0, 2], [4, 6]], [[0, 6]], []]
    assert read(f"{path}:sheet@9").coarse_edges[0].tolist() == [[1, 3]]
    own, lbs = garment.skinning, fields["lbs"]
    # The released offsets are pose features x (3 vertices); ours are (vertices, 3, pose features).
    np.testing.assert_allclose(own.pose_directions[7, 2], lbs["posedirs"][:, 3 * 7 + 2])
    row = np.zeros(24)
    row[own.weights.bones[3]] = own.weights.weights[3]
    np.testing.assert_allclose(row, lbs["lbs_weights"][3], atol=1e-6)


def test_other_forms_of_garments_are_read(tmp_path: Path) -> None:
    fields = garment_fields()
    alone = written(tmp_path / "mine.pkl", {**fields, "garment_id": fields["node_type"], "gender": "female"})
    assert read(alone).name == "mine"
    template = {"vertices": fields["rest_pos"], "faces": fields["faces"], "center": [1], "coarse_edges": {}}
    loaded = read(written(tmp_path / "template.pkl", template))
    assert loaded.skinning is None
    assert not loaded.pinned.any()
    levels = {"sheet": {"level1": garment_fields(3, 3), "level2": garment_fields(4, 4)}}
    many = written(tmp_path / "levels.pkl", levels)
    assert len(read(f"{many}:sheet").vertices) == 9
    assert len(read(f"{many}:sheet/level2").vertices) == 16


def _changed(fields: dict[str, Any], **changes: Any) -> dict[str, Any]:
    made = {**fields, "lbs": dict(fields["lbs"])}
    for name, value in changes.items():
        part, _, key = name.rpartition("__")
        (made[part] if part else made)[key] = value
    return made


@pytest.mark.parametrize(
    ("content", "entry", "told"),
    [
        ({"a": garment_fields(), "b": garment_fields()}, "", "several garments"),
        ({"a": garment_fields(), "b": garment_fields()}, ":c", "There are: a, b"),
        ({"a": {"v": np.zeros(3)}}, ":a", 'lacks "faces"'),
        ([1, 2], "", "holds no garments"),
        ({"weights": 1.0}, "", "holds no garments"),
        (_changed(garment_fields(), rest_pos=np.zeros((20, 2))), "", r"not \(vertices = 20, 3\)"),
        (_changed(garment_fields(), rest_pos=np.full((20, 3), np.nan)), "", "other than finite numbers"),
        (_changed(garment_fields(), faces=np.array([[0, 1, 99]])), "", "has indices beyond its 20 vertices"),
        (_changed(garment_fields(), faces=np.array([[0, 1, -2]])), "", "has indices beyond its 20 vertices"),
        (_changed(garment_fields(), faces=np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])), "", "three or more faces"),
        (_changed(garment_fields(), node_type=np.zeros((7, 1), dtype=int)), "", "node_type"),
        (_changed(garment_fields(), lbs__v=np.zeros((7, 3))), "", "has the shape|skinning does not fit"),
        (_changed(garment_fields(), lbs__lbs_weights=np.zeros((20, 24))), "", "empty rows"),
        (_changed(garment_fields(), lbs__posedirs=np.zeros((207, 59))), "", "pose features|coordinates"),
        (_changed(garment_fields(), coarse_edges={1: {0: np.array([[0, 77]])}}), "", "outside of its 20"),
        (_changed(garment_fields(), coarse_edges={1: {0: np.array([[0, 7]]), 2: np.zeros(0)}}), "", "without a gap"),
        ({"a": garment_fields()}, ":a@4", "around 5, 9"),
    ],
)  # fmt: skip
def test_a_garment_that_does_not_fit_itself_is_refused(tmp_path: Path, content: Any, entry: str, told: str) -> None:
    path = written(tmp_path / "odd.pkl", content)
    with pytest.raises(InputError, match=told):
        read(f"{path}{entry}")


def test_a_dictionary_that_asks_for_code_is_refused_and_did_not_run(tmp_path: Path) -> None:
    class Touches:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.system, (f"touch {tmp_path / 'proof'}",)

    path = written(tmp_path / "odd.pkl", {"a": {**garment_fields(), "extra": Touches()}})
    with pytest.raises(InputError, match="nothing in the file was run"):
        read(f"{path}:a")
    assert not (tmp_path / "proof").exists()
    with pytest.raises(InputError, match="no garment file"):
        read(tmp_path / "absent.pkl")


def test_every_array_of_every_released_pickle_is_read(compat: Path) -> None:
    expected = json.loads((compat / "expected.json").read_text())
    for file, leaves in expected.items():
        found = dict(_leaves("", load_pickle(compat / file)))
        checked = 0
        for name, told in leaves.items():
            value = found[name.removesuffix(" (dense)")]
            if "sha256" not in told:
                continue
            array = np.ascontiguousarray(value.toarray() if scipy.sparse.issparse(value) else value)
            assert list(array.shape) == told["shape"], (file, name)
            assert str(array.dtype) == told["dtype"], (file, name)
            assert hashlib.sha256(array.tobytes()).hexdigest() == told["sha256"], (file, name)
            checked += 1
        assert checked, file


def _leaves(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(f"{prefix}/{key}", item)
    else:
        yield prefix, value


def test_skinning_is_carried_over_to_other_vertices(tmp_path: Path) -> None:
    own = read(written(tmp_path / "mine.pkl", garment_fields())).skinning
    faces = garment_fields()["faces"]
    # At a corner it is that vertex's, half way between two the mean of both.
    moved = own.at(faces[:2], np.array([[0.0, 1.0, 0.0], [0.5, 0.5, 0.0]]))
    a, b = faces[1][:2]
    np.testing.assert_allclose(moved.vertices[0], own.vertices[faces[0][1]])
    np.testing.assert_allclose(moved.pose_directions[1], 0.5 * (own.pose_directions[a] + own.pose_directions[b]))
    dense = np.zeros((2, 24))
    for row, bones, weights in zip(dense, moved.weights.bones, moved.weights.weights, strict=True):
        row[bones] = weights
    lbs = garment_fields()["lbs"]["lbs_weights"]
    np.testing.assert_allclose(dense[1], 0.5 * (lbs[a] + lbs[b]), atol=1e-6)


@pytest.mark.parametrize(
    ("garment", "pinned"), [("garments_dict.pkl:dress", False), ("garments_dict_skirt.pkl:skirt", True)]
)
def test_a_garment_of_a_dictionary_is_worn_at_any_triangle_count(compat: Path, garment: str, pinned: bool) -> None:
    files = compat / "files"

    def scene(triangles: int | None) -> Any:
        worn = WornGarment(f"{files}/{garment}", triangles=triangles)
        return build_scene(
            Run((worn,), body=files / "SMPL_FEMALE.pkl", motion=files / "recording.pkl", as_recorded=True, lead_in=0)
        ).garments[0]

    given, finer = scene(None), scene(4000)
    assert finer.garment.triangle_count == pytest.approx(4000, rel=0.1)
    assert finer.garment.mean_edge_length < given.garment.mean_edge_length
    assert finer.garment.coarse_edges == ()
    assert bool(finer.garment.pinned.any()) == pinned
    # In every frame the finer one lies on the given one, as far as its rounder shape allows.
    for frame in (0, 7):
        coarse, fine = (worn.placement.positions(frame, frame + 1)[0].numpy() for worn in (given, finer))
        surface = TriangleSurface(given.garment.faces, len(coarse)).at(coarse)
        away = np.linalg.norm(surface.nearest(fine).positions.numpy() - fine, axis=1)
        assert np.median(away) < 1e-3
        assert away.max() < 1e-2
