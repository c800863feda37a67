"""Recordings, characters and targets of other programs that cannot be used: one plain sentence, and nothing written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
import torch
from tests.body.characters import rewritten, write_doll


class Code:
    """What a pickle runs when it is loaded."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('code of the file was run')",))


def gvhmr(path: Path, content: Any) -> Path:
    torch.save({"smpl_params_global": content}, path)
    return path


def poses(last: float) -> dict[str, torch.Tensor]:
    places = torch.zeros(5, 3)
    places[4] = last
    return {"global_orient": torch.zeros(5, 3), "body_pose": torch.zeros(5, 63), "transl": places}


def wham(path: Path, people: Any) -> Path:
    joblib.dump(people, path)
    return path


def doll(path: Path, change: Callable[[dict[str, Any]], object] = lambda document: None) -> Path:
    return rewritten(write_doll(path), path, change)


def written(path: Path) -> Path:
    path.touch()
    return path


def without_skin(document: dict[str, Any]) -> None:
    for node in document["nodes"]:
        node.pop("skin", None)


def flat(document: dict[str, Any]) -> None:
    document["nodes"][0]["scale"] = [1.0, 0.0, 1.0]


CASES: dict[str, tuple[Callable[[Path], list[object]], str]] = {
    "a .pt that would run code": (
        lambda at: ["--motion", gvhmr(at / "a.pt", Code())],
        'a.pt: it asks for "exec"; only plain data is read, and nothing in the file was run',
    ),
    "a .pt with a frame that is not finite": (
        lambda at: ["--motion", gvhmr(at / "a.pt", poses(float("nan")))],
        "frame 4 holds values that are not finite",
    ),
    "WHAM's file of nobody": (lambda at: ["--motion", wham(at / "w.pkl", {})], "w.pkl holds nobody"),
    "WHAM's file with a frame that is not finite": (
        lambda at: [
            "--motion",
            wham(at / "w.pkl", {0: {"pose_world": np.full((4, 72), np.nan), "trans_world": np.zeros((4, 3))}}),
        ],
        "frame 0 holds values that are not finite",
    ),
    "a clip that is not in the file": (
        lambda at: ["--body", doll(at / "d.glb"), "--clip", "run"],
        'd.glb has no clip "run"; it has slide',
    ),
    "a glTF without skin": (
        lambda at: ["--body", doll(at / "d.glb", without_skin)],
        "d.glb has no skin: no mesh in it is bound to bones",
    ),
    "a glTF flattened by a scale": (
        lambda at: ["--body", doll(at / "d.glb", flat)],
        "a bone is flattened by the scale of a node",
    ),
    "a glTF compressed by Draco": (
        lambda at: [
            "--body",
            doll(at / "d.glb", lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"])),
        ],
        "d.glb is compressed by Draco, which pb4u does not read",
    ),
    "a texture that is missing": (lambda at: ["--texture", at / "print.png"], "There is no image"),
    "an Alembic file without rights": (lambda at: ["--out", at / "locked/run.abc"], "locked cannot be written to"),
    "an Alembic file over a protected one": (
        lambda at: ["--out", written(at / "protected.abc")],
        "protected.abc is write-protected",
    ),
    "an Alembic file in a folder that is missing": (lambda at: ["--out", at / "no/run.abc"], "no does not exist; make"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_used_is_refused_in_one_sentence(
    pb4u: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    arguments, sentence = CASES[case]
    flags = arguments(tmp_path)
    # Root, as which tests may run, has rights everywhere.
    (tmp_path / "locked").mkdir()
    closed = ("locked", "protected.abc")
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK or Path(path).name not in closed)
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path / "there")
    ended = pb4u("simulate", "--frames", 1, "--lead-in", 0, "--model", "skinning", *flags)
    assert ended.code == 1
    assert sentence in ended.err
    assert ended.err.startswith("pb4u: ")
    assert ended.err.count("\n") == 1
    assert not list((tmp_path / "there").iterdir())
