"""Jobs files: what they describe, and one sentence on each that describes nothing usable."""

from __future__ import annotations

from pathlib import Path

import pytest

from pb4u.dataset.jobs_file import read_jobs
from pb4u.errors import InputError
from pb4u.measures.run_job import RunJob
from pb4u.run import Run, WornGarment


def jobs(folder: Path, text: str, name: str = "jobs.toml", most: int = 1000) -> tuple[Run, ...]:
    (folder / name).write_text(text)
    return read_jobs(folder / name, most)


def test_a_product_is_every_combination_and_lists_follow(tmp_path: Path) -> None:
    runs = jobs(
        tmp_path,
        """
        [fixed]
        frames = 8
        model = "solver"
        [product]
        garment = ["tshirt", ["tanktop", "cardigan"]]
        motion = ["walk", "recordings/07_02.amc"]
        seed = { first = 3, count = 2 }
        [[clips]]
        garment = "skirt"
        frames = 9
        body_shape = { height = 0.7 }
        """,
    )
    assert len(runs) == 9
    named = [tuple(each.name for each in run.garments) for run in runs]
    assert named == [("tshirt",)] * 4 + [("tanktop", "cardigan")] * 4 + [("skirt",)]
    assert [run.seed for run in runs[:3]] == [3, 4, 3]
    assert [run.motion for run in runs[:3]] == ["walk", "walk", tmp_path / "recordings/07_02.amc"]
    assert {run.model for run in runs} == {"solver"}
    assert (runs[-1].frames, runs[-1].body_shape) == (9, {"height": 0.7})


def test_files_of_before_mean_what_they_meant(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text("[scene]\nframes = 5\n")
    plain, opened, chosen = jobs(
        tmp_path, '[[clips]]\n[[clips]]\nscene = "scene.toml"\n[[clips]]\nfriction_law = "coulomb"\n'
    )
    assert (Run().friction_law, Run.open(tmp_path / "scene.toml").friction_law) == ("auto", "paper")
    assert [run.friction_law for run in (plain, opened, chosen)] == ["paper", "paper", "coulomb"]
    assert {(run.time_integration, run.air) for run in (plain, opened, chosen)} == {("implicit-euler", "off")}


def test_lists_within_lists_are_one_for_each_garment(tmp_path: Path) -> None:
    (run,) = jobs(
        tmp_path,
        '[[clips]]\ngarment = ["tanktop", "cardigan"]\nmaterial = ["silk", "wool"]\ntriangles = 500\npins = "none"\n',
    )
    assert run.garments == (
        WornGarment("tanktop", "silk", "none", 500), WornGarment("cardigan", "wool", "none", 500)
    )  # fmt: skip
    (pinned,) = jobs(tmp_path, '[[clips]]\ngarment = ["tanktop", "cardigan"]\npins = [0, 1, 2]\n')
    assert [each.pins for each in pinned.garments] == [(0, 1, 2)] * 2


def test_a_scene_file_is_a_beginning_that_entries_change(tmp_path: Path) -> None:
    scene = '[scene]\nframes = 5\nbody = "man"\nbody_shape = { height = 0.2 }\n[[garments]]\ngarment = "skirt"\n'
    (tmp_path / "outfit.toml").write_text(scene)
    same, other = jobs(tmp_path, '[fixed]\nscene = "outfit.toml"\n[product]\nbody = ["man", "woman"]\n')
    assert same.garments == other.garments == (WornGarment("skirt"),)
    assert (same.body_shape, other.body_shape) == ({}, {})
    (kept,) = jobs(tmp_path, '[[clips]]\nscene = "outfit.toml"\nmaterial = "silk"\n')
    assert (kept.frames, kept.body_shape) == (5, {"height": 0.2})
    assert kept.garments == (WornGarment("skirt", "silk"),)


MILLION = "[product]\n" + "".join(
    f"{name} = {list(range(1, 101))}\n" for name in ("seed", "triangles", "frames")
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[fixed]\ngarmet = 'tshirt'\n", r"\[fixed\] has no entry 'garmet'; did you mean garment"),
        ("[product]\nmotions = ['walk']\n", r"\[product\] has no entry 'motions'; did you mean motion"),
        ("[[clips]]\ncolour = 'red'\n", r"\[\[clips\]\] has no entry 'colour'"),
        ("[products]\nseed = [1]\n", "no section 'products'; did you mean product"),
        ("[product]\nmotion = 'walk'\n", r"motion in \[product\] must be a list"),
        ("[fixed]\nseed = 1\n[product]\nseed = [1, 2]\n", r"seed is in both \[fixed\] and \[product\]"),
        ("[product]\nseed = { first = 0 }\n", "seeds must be a list, or"),
        (MILLION, r"describes 1,000,000 clips; a data set has at most 1,000; .* raise --most-clips"),
        ("[product]\nseed = { first = 0, count = 1000000000000 }\n", "describes 1,000,000,000,000 clips"),
        ("", "describes no clip"),
        ("[product]\nseed = []\n", "describes no clip"),
        ("[[clips]]\nframes = 0\n", r"clip 1 \(frames = 0\): frames must be a whole number, 1 or more"),
        ("[product]\ngarment = ['dress']\nseed = [0, 'x']\n", r"clip 2 \(garment = dress, seed = x\): seed must"),
        ("[[clips]]\ngarment = ['dress', 'skirt']\ntriangles = [1, 2, 3]\n", "triangles has 3 values for 2 garments"),
        ("[[clips]]\nscene = 'absent.toml'\n", "There is no scene file .*absent.toml"),
        ("[[clips]\n", "cannot be read as TOML, which a jobs file is"),
        ("clips = 3\n", "each clip must be a section of its own"),
        ("format_version = 2\n", "of format version 2"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        jobs(tmp_path, text)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.toml"):
        read_jobs(tmp_path / "jobs.json")
    with pytest.raises(InputError, match="There is no jobs file"):
        read_jobs(tmp_path / "jobs.toml")
    with pytest.raises(InputError, match=r"\[\[clips\]\]"):
        read_jobs(tmp_path / "jobs.csv")


def test_a_file_without_a_rest_shape_means_moulded(tmp_path: Path) -> None:
    one, other = jobs(tmp_path, '[[clips]]\ngarment = "skirt"\n[[clips]]\nrest_shape = "flat"\ngrain = [0, 1, 0]\n')
    assert (one.rest_shape, other.rest_shape) == ("moulded", "flat")
    assert other.garments[0].grain == (0.0, 1.0, 0.0)


def test_fabrics_of_parts_are_entries_and_labels_of_a_clip(tmp_path: Path) -> None:
    two, one = jobs(
        tmp_path,
        """
        [fixed]
        garment = "skirt"
        layers = { hem = 3 }
        [[clips]]
        material = { body = "silk", hem = "denim" }
        [[clips]]
        material = "wool"
        elastic = { waist = 0.9 }
        """,
    )
    assert [run.garments[0].materials for run in (two, one)] == [{"body": "silk", "hem": "denim"}, {"body": "wool"}]
    told = [RunJob(run).labels for run in (two, one)]
    assert [each["material"] for each in told] == ["body:silk,hem:denim", "wool"]
    assert [each["layers"] for each in told] == [[{"hem": 3}]] * 2
    assert [each["elastic"] for each in told] == [[{}], [{"waist": 0.9}]]
