"""Training data of the user's own garment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.motion.test_smpl_recordings import write_vto

from pb4u.body.library import load_body
from pb4u.errors import InputError, InputWarning
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import write_obj
from pb4u.training.collection import collect
from pb4u.training.configuration import DataSelection


@pytest.fixture(scope="module")
def shirt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("own") / "shirt.obj"
    garment = build_garment("tshirt", load_body("man"), 700)  # type: ignore[arg-type]
    write_obj(file, PolygonMesh(garment.vertices, tuple(garment.faces)))
    return file


def selection(*garments: str, bodies: tuple[str, ...] = ("man", "woman")) -> DataSelection:
    return DataSelection(garments, (600,), bodies, shapes=2, motions=("walk",), clips=1, clip_frames=8)


def test_a_garment_of_a_file_is_worn_by_the_body_that_it_was_made_for(shirt: Path) -> None:
    data = collect(selection("skirt", str(shirt)))
    assert [(outfit.garment.name, outfit.body) for outfit in data.outfits] == [("skirt", 0), ("shirt", 0), ("skirt", 1)]
    assert np.isclose(data.outfits[1].garment.triangle_count, 600, rtol=0.1)


def test_with_files_alone_the_first_body_is_the_only_one(shirt: Path) -> None:
    data = collect(selection(str(shirt)))
    assert len(data.bodies) == len(data.outfits) == 1


def test_a_file_that_is_missing_is_refused() -> None:
    with pytest.raises(InputError, match=r"none\.obj"):
        collect(selection("none.obj"))


def test_vto_recordings_are_trained_on_and_every_tenth_validates(tmp_path: Path) -> None:
    for number in range(10):
        write_vto(tmp_path / f"clip{number}.pkl")
    data = collect(replace(selection("skirt", bodies=("man",)), motions=(), shapes=1), tmp_path)
    splits = [(clip.name, clip.split) for clip in data.clips if clip.body == 0]
    assert splits[0] == ("clip0", "train")
    assert len(splits) == 10
    assert [name for name, split in splits if split == "validation"] == ["clip9"]


@pytest.mark.parametrize(("count", "held_out"), [(1, []), (2, ["clip1"]), (9, ["clip8"])])
def test_of_few_recordings_one_is_held_out(count: int, held_out: list[str], tmp_path: Path) -> None:
    for number in range(count):
        write_vto(tmp_path / f"clip{number}.pkl")
    data = collect(replace(selection("skirt", bodies=("man",)), motions=(), shapes=1), tmp_path)
    assert [clip.name for clip in data.clips if clip.split == "validation"] == held_out


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.pkl, \.npz, \.bvh"):
        collect(selection("skirt"), tmp_path)


def test_files_without_poses_stay_out(tmp_path: Path) -> None:
    write_vto(tmp_path / "clip.pkl")
    np.savez(tmp_path / "shape.npz", betas=np.zeros(16), gender=np.array("female"))
    with pytest.warns(InputWarning, match="1 file holds no poses"):
        data = collect(replace(selection("skirt", bodies=("man",)), motions=(), shapes=1), tmp_path)
    assert {clip.name for clip in data.clips} == {"clip"}
