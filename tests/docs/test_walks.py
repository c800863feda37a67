"""Each section of the page "From start to end", its commands in their order in one folder, on files made by hand."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.body.characters import write_woman
from tests.body.smpl_files import write_smpl_woman
from tests.docs.test_documented_commands import ROOT, SMALL, Block, blocks, commands, made_small, run
from tests.motion.test_joint_names import renaming
from tests.motion.test_smpl_recordings import write_amass
from tests.pattern.patterns import skirt

from pb4u.body.library import load_body
from pb4u.dataset.jobs_file import read_jobs
from pb4u.garment.library import build_garment
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.obj_file import read_obj, write_obj
from pb4u.io.toml_file import tomllib
from pb4u.pattern.garmentcode import record_of
from pb4u.scene.trajectory import Trajectory

pytestmark = pytest.mark.filterwarnings("ignore::pb4u.errors.InputWarning")
PAGE = "docs/guides/from_start_to_end.md"
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", (ROOT / PAGE).read_text(), re.MULTILINE | re.DOTALL))
MIXAMO = {theirs: ours for ours, theirs in renaming("MakeHuman").items()}

WORN = SMALL | {"--triangles": "1500", "--lead-in": "10"}
"""With fewer triangles and frames before, arms that hang along the trunk tear sleeves."""


def character(folder: Path) -> None:
    """A character with Mixamo's names and centimetres, and a garment for it in centimetres."""
    write_woman(folder / "character.glb", unit=0.01, rename=lambda name: f"mixamorig:{MIXAMO.get(name, name)}")
    woman = load_body("woman")
    shirt = build_garment("tshirt", woman, 1500)
    write_obj(folder / "jacket.obj", PolygonMesh(100.0 * shirt.vertices, tuple(shirt.faces)))


def moved_as_the_character(folder: Path) -> None:
    clip, mended = Trajectory.open(folder / "jacket.npz"), read_obj(folder / "mended.obj")
    assert np.ptp(mended.vertices[:, 1]) < 1.0  # metres
    assert clip.frame_count == 3
    assert np.abs(clip.positions[0].mean(axis=0) - clip.body_positions[0].mean(axis=0)).max() < 0.5
    assert (folder / "jacket.abc").stat().st_size > 10_000


def research(folder: Path) -> None:
    write_smpl_woman(folder / "SMPL_FEMALE.npz")
    write_amass(folder / "amass_clip.npz")


def measured(folder: Path) -> None:
    report = json.loads((folder / "clip.json").read_text())
    assert report["metrics"]["distance_to_reference"]["mean"] < 0.05
    assert Trajectory.open(folder / "clip.npz").body_positions.shape[1] == 13_348


def clips(folder: Path) -> None:
    """Three small clips in the place of fifty: the page's file with shorter lists."""
    for needed in ("pyarrow", "pandas"):
        pytest.importorskip(needed)
    (shown,) = (block for block in blocks("toml") if block.page == PAGE)
    (folder / "shown.toml").write_text(shown.text)
    assert len(read_jobs(folder / "shown.toml")) == 50
    jobs = tomllib.loads(shown.text)
    small = {"triangles": 450, "frames": 3, "lead_in": 1}
    lists = {name: values[: 3 if name == "garment" else 1] for name, values in jobs["product"].items()}
    lines = [f"{name} = {json.dumps(value)}" for name, value in (jobs["fixed"] | small).items()]
    lines += ["[product]", *(f"{name} = {json.dumps(values)}" for name, values in lists.items())]
    (folder / "fifty.toml").write_text("\n".join(["[fixed]", *lines]))


def indexed(folder: Path) -> None:
    import pandas

    index = pandas.read_parquet(folder / "clips" / "index.parquet")
    assert list(index.status) == ["done"] * 3
    assert set(index.garment) == {"tshirt", "dress", "skirt"}
    assert all(Trajectory.open(folder / "clips" / file).frame_count == 3 for file in index.file)


def pattern(folder: Path) -> None:
    (folder / "pattern.json").write_text(json.dumps(record_of(skirt())))


def sewn(folder: Path) -> None:
    clip = Trajectory.open(folder / "walk.npz")
    assert clip.header.rest_uv is not None
    assert len(clip.header.garments[0]["panels"]) == len(skirt().panels)
    assert (folder / "dressed.svg").read_text().count("<path") >= len(skirt().panels)
    assert (folder / "walk.usdc").stat().st_size > 10_000


WALKS: dict[str, tuple[Callable[[Path], None], Callable[[Path], None]]] = {
    "A character of Mixamo or Blender": (character, moved_as_the_character),
    "A body of SMPL and a clip of AMASS": (research, measured),
    "Fifty clips on two workers": (clips, indexed),
    "A sewing pattern": (pattern, sewn),
}


def test_every_section_is_walked() -> None:
    assert list(SECTIONS) == list(WALKS)


SLOW = [title for title in WALKS if title != "A sewing pattern"]


@pytest.mark.parametrize(
    "title", [pytest.param(title, marks=[pytest.mark.slow] if title in SLOW else []) for title in WALKS]
)
def test_a_section_runs_from_top_to_bottom(
    title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    prepare, found = WALKS[title]
    prepare(tmp_path)
    (text,) = re.findall(r"^```sh\n(.*?)^```", SECTIONS[title], re.MULTILINE | re.DOTALL)
    for words in commands(Block(PAGE, "sh", text)):
        small = [*words, "--triangles", "450"] if words[1] == "dress" else made_small(words, "quick-solver", WORN)
        ended = run(small, monkeypatch)
        streams = capsys.readouterr()
        assert ended == 0, f"{' '.join(small)}\n{streams.out}\n{streams.err}"
    found(tmp_path)
