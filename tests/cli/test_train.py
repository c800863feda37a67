"""`pb4u train` and `pb4u assets pack`: what they write, and what they refuse in one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.training.ball_data import TINY, ball_data

from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.registry import NETWORKS
from pb4u.simulation.checkpoint import TrainingRecord, load_checkpoint, save_checkpoint
from pb4u.training.configuration import training_to_json, with_settings
from pb4u.training.packed_data import load_training_data, save_training_data
from pb4u.training.run_folder import RunFolder
from pb4u.training.session import _licence

Call = Callable[..., Any]
QUICK = (
    "--set", "network.width=4", "--set", "statistics_windows=2", "--set", "validation_frames=2", "--device", "cpu",
)  # fmt: skip


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pack") / "pack.npz"
    save_training_data(ball_data((8,)), path)
    return path


def test_a_training_leaves_weights_a_curve_and_a_way_to_go_on(pb4u: Call, pack: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    ended = pb4u("train", "--pack", pack, "--preset", "smoke", "--steps", 6, "--out", run, *QUICK, "--json", "-")
    assert ended.code == 0, ended.err
    result = json.loads(ended.out)
    assert (result["ending"], result["steps"]) == ("finished", 6)
    assert Path(result["weights"]).is_file()
    names = {p.name for p in run.iterdir() if p.name != ".lock"}
    assert names == {
        "configuration.json", "data.npz", "metrics.jsonl", "last.safetensors", "best.safetensors",
        "final.safetensors", "curve.png",
    }  # fmt: skip
    assert json.loads((run / "configuration.json").read_text())["training"]["network"]["width"] == 4
    further = pb4u("train", "--resume", run, "--steps", 8, "--device", "cpu")
    assert further.code == 0, further.err
    assert "Trained 8 steps." in further.out


@pytest.mark.slow
def test_a_flat_training_goes_on_with_a_larger_budget(pb4u: Call, pack: Path, tmp_path: Path) -> None:
    run, flat = tmp_path / "run", ("--set", "curriculum.learning_rate=1e-12", "--set", "patience=1")
    begun = ("--pack", pack, "--preset", "smoke", "--steps", 60, "--out", run, *QUICK, *flat)
    ended = json.loads(pb4u("train", *begun, "--set", "validate_every=2", "--json", "-").out)
    assert ended["ending"] == "flat"
    assert "with more --steps or --minutes goes on" in ended["sentence"]
    further = json.loads(pb4u("train", "--resume", run, "--steps", 90, "--device", "cpu", "--json", "-").out)
    assert further["steps"] > ended["steps"]


def test_a_training_begins_with_given_weights_and_says_so(pb4u: Call, pack: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert pb4u("train", "--pack", pack, "--preset", "smoke", "--steps", 6, "--out", first, *QUICK).code == 0
    start = first / "final.safetensors"
    made = load_checkpoint(start)
    save_checkpoint(start, made.model, made.configuration, made.record, "CC-BY-4.0")
    begun = ("--pack", pack, "--preset", "smoke", "--weights", start, "--out", second, "--device", "cpu")
    ended = pb4u("train", *begun, "--steps", 2, "--set", "curriculum.learning_rate=1e-12")
    assert ended.code == 0, ended.err
    before, after = load_checkpoint(start), load_checkpoint(second / "final.safetensors")
    # The network is that of the weights, narrower than the preset's, and its statistics are not gathered again.
    assert after.configuration == before.configuration
    for (name, a), b in zip(before.model.state_dict().items(), after.model.state_dict().values(), strict=True):
        assert torch.allclose(a, b, rtol=0.0, atol=1e-9), name
    assert after.licence == "unknown: ask whoever trained it; it started from weights under CC-BY-4.0"
    assert after.record.optimiser_steps == 8
    assert after.record.details["before"]["optimiser_steps"] == 6
    # What it began with is needed no more.
    start.unlink()
    further = pb4u("train", "--resume", second, "--steps", 3, "--device", "cpu")
    assert further.code == 0, further.err
    assert load_checkpoint(second / "final.safetensors").record.optimiser_steps == 9


@pytest.mark.slow
def test_weights_of_ones_own_data_have_no_licence_of_ours_and_say_what_they_learnt(
    pb4u: Call, pack: Path, tmp_path: Path
) -> None:
    own, ours = tmp_path / "own", tmp_path / "ours"
    for run, given in ((own, ("--pack", pack)), (ours, ())):
        ended = pb4u("train", *given, "--preset", "smoke", "--steps", 2, "--out", run, *QUICK)
        assert ended.code == 0, ended.err
    trained = load_checkpoint(own / "final.safetensors")
    assert trained.licence == "unknown: ask whoever trained it"
    assert trained.record.details["garments"] == ["sheet"]
    assert trained.record.details["motions"] == ["slide-0.3", "slide-0.4", "slide-0.6"]
    assert load_checkpoint(ours / "final.safetensors").licence == "Apache-2.0"
    assert "unknown: ask whoever trained it" in pb4u("info", "--model", own / "final.safetensors").out


@pytest.mark.parametrize(
    ("data", "garment", "begun", "licence"),
    [
        ("built in", "tshirt", None, "Apache-2.0"),
        ("built in", "tshirt", "CC-BY-4.0", "CC-BY-4.0"),
        ("built in", "my_shirt.obj", "Apache-2.0", "unknown: ask whoever trained it"),
        ("given", "tshirt", "unknown: ask the author", "unknown: ask the author"),
    ],
)
def test_the_licence_is_of_the_weights_begun_with_unless_own_data_are_learnt(
    data: str, garment: str, begun: str | None, licence: str
) -> None:
    record = {"data": data, "origin": None if begun is None else {"licence": begun}}
    assert _licence(record, with_settings(TINY, [f"data.garments={garment}"])) == licence


def test_weights_go_on_under_another_law_of_k_and_scaling(pb4u: Call, pack: Path, tmp_path: Path) -> None:
    start, run = tmp_path / "start.safetensors", tmp_path / "run"
    configuration, wanted = (
        replace(NETWORKS[name], width=4) for name in ("literal_small", "literal_small_without_both")
    )
    record = TrainingRecord(1.0 / 30.0, (0.045, 0.045), (5, 5))
    save_checkpoint(start, AccelerationModel(configuration.network()), configuration, record)
    begun = ("--pack", pack, "--preset", "smoke", "--weights", start, "--out", run, "--device", "cpu", "--steps", 2)
    laws = ("--set", "network=literal_small_without_both", "--set", "network.width=4")
    ended = pb4u("train", *begun, *laws, "--set", "most_propagation_steps=0", *QUICK[2:6])
    assert ended.code == 0, ended.err
    assert load_checkpoint(run / "final.safetensors").configuration == wanted


def test_of_a_training_s_folder_the_best_weights_are_the_model(
    pb4u: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = RunFolder.create("run", {})
    run.save_state({"weight": torch.zeros(2)}, {})
    for best in (False, True):
        if best:
            run.best.touch()
        advice = "give run/best.safetensors" if best else "give a .safetensors file of weights"
        for model, what in (("run", "a folder"), ("run/last.safetensors", "the saved state of a training")):
            ended = pb4u("simulate", "--model", model, "--out", "a.npz")
            assert ended.code == 1
            assert ended.err == f"pb4u: {model} is {what}, not a model; {advice}.\n"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "Give --out FOLDER"),
        (("--out", "run", "--resume", "run"), "Give --out FOLDER"),
        (("--out", "run", "--preset", "smal"), "did you mean small"),
        (("--out", "run", "--set", "batc=2"), "did you mean batch"),
        (("--out", "run", "--pack", "absent.npz"), "There is no training pack"),
        (("--out", "run", "--minutes", "0"), "must be above 0"),
        (("--out", "run", "--weights", "pb4u-smal"), "There is no model file pb4u-smal"),
        (("--out", "run", "--weights", "pb4u-small", "--set", "network.width=4"), "bring their own network"),
        (("--out", "run", "--weights", "pb4u-small", "--set", "network=hood_small"), "bring their own network"),
        (("--out", "run", "--weights", "pb4u-small", "--preset", "wide"), "add --set network.conjugate=True"),
        (("--resume", "."), "is not a folder of a training"),
        (("--out", "run", "--device", "tpu", "--pack", "pack.npz"), "auto, cpu or cuda"),
    ],
)
def test_what_cannot_be_trained_is_refused_in_one_sentence(
    pb4u: Call, pack: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], sentence: str
) -> None:
    monkeypatch.chdir(pack.parent)
    ended = pb4u("train", *arguments)
    assert ended.code == 1
    assert sentence in ended.err
    assert ended.err.strip().count("\n") == 0
    assert not (pack.parent / "run").exists()


def test_a_resumed_training_takes_no_new_preset(pb4u: Call, tmp_path: Path) -> None:
    ended = pb4u("train", "--resume", tmp_path, "--preset", "smoke")
    assert ended.code == 1
    assert "leave out --preset" in ended.err


def test_a_pack_of_built_in_assets_can_be_trained_on(pb4u: Call, tmp_path: Path) -> None:
    pack = tmp_path / "pack.npz"
    ended = pb4u("assets", "pack", pack, "--preset", "smoke", "--json", tmp_path / "r.json")
    assert ended.code == 0, ended.err
    told = json.loads((tmp_path / "r.json").read_text())
    assert (told["garments"], told["clips"], told["bytes"]) == (1, 2, pack.stat().st_size)
    assert "1 bodies, 1 garments, 2 clips" in ended.out
    data = load_training_data(pack)
    assert {clip.split for clip in data.clips} == {"train", "validation"}
    trained = pb4u("train", "--pack", pack, "--preset", "smoke", "--steps", 2, "--out", tmp_path / "run", *QUICK)
    assert trained.code == 0, trained.err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("pack.zip",), "is written as .npz"),
        (("absent/pack.npz",), "does not exist"),
        (("pack.npz", "--json", "absent/r.json"), "does not exist"),
        (("pack.npz", "--set", "data.bodies=nobody"), "not 'nobody'"),
        (("pack.npz", "--preset", "smoke", "--set", "data.motions=fly"), "no built-in motion 'fly'"),
        (("pack.npz", "--preset", "smoke", "--recordings", "."), "nor a CMU recording"),
    ],
)
def test_packs_that_cannot_be_made_are_refused(
    pb4u: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], sentence: str
) -> None:
    monkeypatch.chdir(tmp_path)
    ended = pb4u("assets", "pack", *arguments)
    assert ended.code == 1
    assert sentence in ended.err
    assert not (tmp_path / "pack.npz").exists()


@pytest.mark.slow
def test_a_folder_without_its_data_makes_it_again(pb4u: Call, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert pb4u("train", "--preset", "smoke", "--steps", "2", "--out", run).code == 0
    data = run / "data.npz"
    before = load_training_data(data)
    data.unlink()
    assert pb4u("train", "--resume", run, "--steps", "3").code == 0
    again = load_training_data(data)
    for old, new in zip(before.clips, again.clips, strict=True):
        assert np.array_equal(old.poses.rotations, new.poses.rotations)
    for old, new in zip(before.outfits, again.outfits, strict=True):
        assert np.allclose(old.garment.vertices, new.garment.vertices, atol=1e-6)


def test_a_folder_that_lost_data_given_to_it_says_so(pb4u: Call, tmp_path: Path) -> None:
    (tmp_path / "configuration.json").write_text(
        json.dumps(
            {
                "format_version": 1,
                "budget": {"steps": 2, "minutes": None},
                "training": training_to_json(TINY),
                "data": "given",
            }
        )
    )
    ended = pb4u("train", "--resume", tmp_path)
    assert ended.code == 1
    assert "has lost its data" in ended.err
