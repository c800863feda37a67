from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.parametrize(
    ("name", "network", "dropped"), [("pb4u", "release_pb4u", "aggr_processor"), ("fine15", "release_mgn", None)]
)
def test_a_released_checkpoint_is_converted_and_says_what_it_is(
    compat: Path, pb4u: Callable[..., Any], tmp_path: Path, name: str, network: str, dropped: str | None
) -> None:
    out = tmp_path / "mine.safetensors"
    ended = pb4u("convert-weights", compat / f"checkpoints/{name}.pth", out, "--json", tmp_path / "told.json")
    assert ended.code == 0, ended.err
    assert f"{network}, " in ended.out
    assert "unknown: ask the author" in ended.out
    assert (dropped is None) or dropped in ended.out
    told = json.loads((tmp_path / "told.json").read_text())
    assert told["network"] == network
    assert told["optimiser_steps"] == 12
    again = pb4u("convert-weights", compat / f"checkpoints/{name}.pth", out, "--licence", "MIT")
    assert "licence MIT" in again.out


def test_what_cannot_be_converted_is_told_in_a_sentence_and_writes_nothing(
    pb4u: Callable[..., Any], tmp_path: Path
) -> None:
    broken, out = tmp_path / "broken.pth", tmp_path / "out.safetensors"
    broken.write_bytes(b"PK\x03\x04 and no more")
    for arguments, told in (
        ((broken, out), "is not a complete file of torch.save"),
        ((tmp_path / "absent.pth", out), "There is no checkpoint"),
        ((broken, tmp_path / "out.pth"), "written as .safetensors"),
        ((broken, tmp_path / "no" / "out.safetensors"), "does not exist"),
    ):
        ended = pb4u("convert-weights", *arguments)
        assert ended.code == 1
        assert told in ended.err
        assert len(ended.err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == [broken]


def test_info_tells_the_licence_of_weights(compat: Path, pb4u: Callable[..., Any]) -> None:
    ended = pb4u("info", "--model", compat / "checkpoints/fine15.pth", "--json", "-")
    assert ended.code == 0, ended.err
    told = json.loads(ended.out)["model"]
    assert (told["network"], told["licence"]) == ("MeshGraphNet", "unknown: ask the author")
    assert json.loads(pb4u("info", "--model", "pb4u-small", "--json", "-").out)["model"]["licence"] == "Apache-2.0"
    assert pb4u("info", "--model", "absent.pth").code == 1
