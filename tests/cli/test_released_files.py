"""From the files of the released code to what it computed, by the command line alone."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pb4u.body.sequence_files import load_vertex_sequence
from pb4u.body.smpl import read_contact
from pb4u.compat.garment_dictionary import read_dictionary_garment
from pb4u.compat.recording_as_released import read_smpl_sequence
from pb4u.compat.released_weights import read_released
from pb4u.compat.result_pickle import read_result
from pb4u.errors import InputError
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.material import MATERIALS

RUNS = [
    ("pb4u", "garments_dict.pkl:dress", "release"),
    ("pb4u", "garments_dict_skirt.pkl:skirt", "release"),
    ("hood", "garments_dict.pkl:dress@73", "hood"),
    ("hood", "garments_dict_skirt.pkl:skirt@388", "hood"),
    ("hood_cvpr", "garments_dict.pkl:dress@125", "mgn"),
    ("hood_cvpr", "garments_dict_skirt.pkl:skirt@122", "mgn"),
    ("fine15", "garments_dict.pkl:dress", "mgn"),
    ("fine15", "garments_dict_skirt.pkl:skirt", "mgn"),
]


def arguments(compat: Path, garment: str) -> list[object]:
    files = compat / "files"
    return [
        "simulate", "--garment", f"{files}/{garment}", "--body", files / "SMPL_FEMALE.pkl",
        "--omitted", files / "smpl_aux.pkl", "--motion", files / "recording.pkl", "--as-recorded", "--arms-away", 20,
        "--lead-in", 0, "--refine", 0, "--contact", "off", "--self-contact", "off",
        "--precision", "float32",
    ]  # fmt: skip


@pytest.mark.parametrize(("name", "garment", "start"), RUNS)
def test_the_released_rollout_is_met(
    compat: Path, pb4u: Callable[..., Any], tmp_path: Path, name: str, garment: str, start: str
) -> None:
    scene = f"{name}_{garment.partition(':')[2].partition('@')[0]}"
    golden = np.load(compat / f"golden/{scene}.npz")
    model = compat / f"checkpoints/{name}.pth"
    ended = pb4u(*arguments(compat, garment), "--model", model, "--start", start, "--out", tmp_path / "run.npz")
    # The golden weights are random and tear the cloth, which the run says; it is written all the same.
    assert (tmp_path / "run.npz").exists(), ended.err
    with np.load(tmp_path / "run.npz") as run:
        positions, metadata = run["positions"], str(run["metadata"])
    assert "unknown: ask the author" in metadata
    assert len(positions) == 8
    for step in range(4):
        expected = golden[f"case0/step{step}/pred_pos"]
        assert np.abs(positions[step + 2] - expected).max() < 3e-6, step


def test_the_released_contourcraft_is_met_but_for_where_the_scene_stands(
    compat: Path, pb4u: Callable[..., Any], tmp_path: Path
) -> None:
    """It turns the posed body where the others turn the pose: everything stands aside by the same in every frame."""
    golden = np.load(compat / "golden/contourcraft_outfit.npz")
    files = arguments(compat, "contourcraft_outfit.pkl")
    model = compat / "checkpoints/contourcraft.pth"
    ended = pb4u(*files, "--model", model, "--start", "contourcraft", "--out", tmp_path / "run.npz")
    assert (tmp_path / "run.npz").exists(), ended.err
    with np.load(tmp_path / "run.npz") as run:
        positions, body = run["positions"].astype(float), run["body_positions"].astype(float)
    aside = (golden["scene/body_frames"] - body).mean(axis=1)
    assert np.ptp(aside, axis=0).max() < 1e-6
    for step in range(3):
        expected = golden[f"case0/step{step}/pred_pos"]
        assert np.abs(positions[step + 2] + aside[0] - expected).max() < 3e-6, step


def test_a_garment_too_coarse_for_the_body_is_played_as_released_with_a_warning(
    compat: Path, pb4u: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The migration command of `docs/coming_from.md` is refused for no dictionary."""
    monkeypatch.setattr("pb4u.garment.coarseness.MOST_DEGREES", 36.0)
    files = compat / "files"
    command = [
        "simulate", "--garment", f"{files}/garments_dict.pkl:dress", "--body", files / "SMPL_FEMALE.pkl",
        "--omitted", files / "smpl_aux.pkl", "--motion", files / "recording.pkl",
        "--model", compat / "checkpoints/pb4u.pth", "--frames", 2, "--out", tmp_path / "dress.pkl",
    ]  # fmt: skip
    refused = pb4u(*command)
    assert "too few to stay around the body" in refused.err
    assert not (tmp_path / "dress.pkl").exists()
    played = pb4u(*command, "--as-released", "pb4u")
    assert "warning: dress: Its 683 triangles are too few to stay around the body" in played.err
    assert (tmp_path / "dress.pkl").exists()


READERS: dict[str, Callable[[Path], object]] = {
    "garment": lambda path: read_dictionary_garment(DictionaryEntry(path, None, None), MATERIALS["default"]),
    "recording": read_smpl_sequence,
    "result": read_result,
    "mesh sequence": load_vertex_sequence,
    "omitted vertices": lambda path: read_contact(path, 10),
}


class Calls:
    """Pickles into a call of `function` with `arguments`."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.function, self.arguments = function, arguments

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return self.function, self.arguments


@pytest.mark.parametrize("kind", [*READERS, "checkpoint"])
def test_no_file_is_read_by_running_it(tmp_path: Path, kind: str) -> None:
    proof = tmp_path / "proof"
    attacks = {
        "system": Calls(os.system, f"touch {proof}"),
        "eval": Calls(eval, f"open({str(proof)!r}, 'w').close()"),
        "save": Calls(np.save, str(proof), np.zeros(1)),
        "import": Calls(__import__, "os"),
    }
    for attack in attacks.values():
        for content in (attack, {"faces": attack, "verts": attack, "pred": attack, "training_module": attack}):
            path = tmp_path / ("odd.pth" if kind == "checkpoint" else "odd.pkl")
            if kind == "checkpoint":
                torch.save(content, path)
            else:
                path.write_bytes(pickle.dumps(content))
            with pytest.raises(InputError, match="nothing in the file was run"):
                (read_released if kind == "checkpoint" else READERS[kind])(path)
            assert not list(tmp_path.glob("proof*"))


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        (["--garment", "{files}/garments_dict.pkl"], "several garments"),
        (["--garment", "{files}/garments_dict.pkl:coat"], "There are: cape, dress"),
        (["--garment", "{files}/absent.pkl:coat"], "no garment file"),
        (["--garment", "{files}/garments_dict.pkl:dress@5"], "no coarse levels around 5"),
        (["--motion", "{files}/garments_dict.pkl"], "has no body_pose"),
        (["--body", "woman"], "of the SMPL family"),
        (["--omitted", "{files}/recording.pkl"], "vertex_type"),
        (["--model", "{files}/recording.pkl"], "not a complete safetensors file"),
        (["--crop", "5:90"], "not inside the recording"),
    ],
)
def test_a_run_that_cannot_be_is_refused_in_a_sentence(
    compat: Path, pb4u: Callable[..., Any], tmp_path: Path, flags: list[str], told: str
) -> None:
    given = [flag.format(files=compat / "files") for flag in flags]
    told_twice = [*arguments(compat, "garments_dict.pkl:dress"), "--model", "pb4u-small", "--out", tmp_path / "run.npz"]
    if given[0] in told_twice:
        told_twice[told_twice.index(given[0]) + 1] = given[1]
    else:
        told_twice += given
    ended = pb4u(*told_twice)
    assert ended.code == 1
    assert told in ended.err
    assert list(tmp_path.iterdir()) == []
