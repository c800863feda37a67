"""Checkpoints rebuild their model, and refuse what they cannot stand for."""

from __future__ import annotations

import json
import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from tests.network_scenes import DT, moment, sheet

from pb4u.errors import InputError, InputWarning
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.features import Feature, FeatureLayout
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation_control import FixedSteps
from pb4u.network.registry import NETWORKS
from pb4u.network.update_scaling import NoScaling
from pb4u.scene.packed import pack
from pb4u.simulation.checkpoint import (
    TrainingRecord,
    built_in_models,
    from_pretrained,
    load_checkpoint,
    save_checkpoint,
    weights_name,
)
from pb4u.simulation.network_configuration import configuration_from_json, configuration_to_json

TINY = Pb4uConfiguration(width=8, blocks=1)
RECORD = TrainingRecord(DT, (0.012, 0.016), (1, 30), 1234, {"preset": "pb4u_small", "seed": 3})


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "tiny.safetensors"
    save_checkpoint(path, AccelerationModel(TINY.network()), TINY, RECORD, "CC0-1.0")
    return path


def rewrite(path: Path, change: dict[str, str | None]) -> None:
    """The same file with entries of its header replaced, or taken out where None."""
    with safe_open(path, "pt") as file:
        metadata = dict(file.metadata())
    tensors = load_file(path)
    metadata.update({key: value for key, value in change.items() if value is not None})
    save_file(tensors, path, {key: value for key, value in metadata.items() if change.get(key, "") is not None})


def test_a_checkpoint_rebuilds_the_same_model(tmp_path):
    torch.manual_seed(1)
    configuration = replace(TINY, control=FixedSteps(3), scaling=NoScaling())
    model = AccelerationModel(configuration.network())
    at = moment([sheet(6, 7)], dtype=torch.float32)
    prepared = model.prepare(at.garments)
    model.gather_statistics(prepared.graph(at.state, at.collider, DT), 1e-3 * torch.randn(42, 3))
    model.freeze_statistics()
    save_checkpoint(tmp_path / "a.safetensors", model, configuration, RECORD, "CC0-1.0")
    loaded = from_pretrained(tmp_path / "a.safetensors")
    assert (loaded.configuration, loaded.record, loaded.licence, loaded.name) == (configuration, RECORD, "CC0-1.0", "a")
    again = loaded.model.prepare(at.garments)
    expected = model(prepared.graph(at.state, at.collider, DT), prepared)
    assert torch.equal(loaded.model(again.graph(at.state, at.collider, DT), again), expected)
    assert bool(loaded.model.node_normaliser.frozen)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.safetensors"]


def test_every_configuration_survives_json():
    extra = (Feature("potential_gradient", 3, "m", True, 1e-3, "gradient of the incremental potential"),)
    for configuration in (*NETWORKS.values(), replace(NETWORKS["pb4u_small"], layout=FeatureLayout(extra=extra))):
        text = json.dumps(configuration_to_json(configuration))
        assert configuration_from_json(json.loads(text)) == configuration


@pytest.mark.parametrize("kept", [0, 4, 200, -1])
def test_a_cut_file_is_refused(saved, kept):
    content = saved.read_bytes()
    saved.write_bytes(content[:kept])
    with pytest.raises(InputError, match="not a complete safetensors file"):
        load_checkpoint(saved)


def test_a_pickle_is_refused_and_not_run(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    (tmp_path / "weights.pt").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(InputError, match="pickle formats"):
        from_pretrained(tmp_path / "weights.pt")
    assert not (tmp_path / "ran").exists()


def test_foreign_weights_are_refused(tmp_path):
    save_file({"weight": torch.zeros(3)}, tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="not those of a pb4u network"):
        load_checkpoint(tmp_path / "other.safetensors")


def test_a_newer_format_is_refused(saved):
    rewrite(saved, {"pb4u_format_version": "2"})
    with pytest.raises(InputError, match=r"format 2 .* upgrade pb4u"):
        load_checkpoint(saved)


def test_another_feature_layout_is_refused(saved):
    narrower = replace(TINY, layout=FeatureLayout(mesh_edge=("direction", "rest_direction", "length_ratio")))
    rewrite(saved, {"configuration": json.dumps(configuration_to_json(narrower))})
    with pytest.raises(InputError, match=r"another feature layout .* 11\) and should be \(8, 7\)|\(11,\) and should"):
        load_checkpoint(saved)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"velocity"', '"telepathy"', "no node feature 'telepathy'"),
        ('"ConstantDistance"', '"__import__"', "unknown type '__import__'"),
        ('"blocks"', '"storeys"', "unknown fields: storeys"),
    ],
)
def test_an_unknown_configuration_is_refused(saved, old, new, expected):
    text = json.dumps(configuration_to_json(TINY))
    assert old in text
    rewrite(saved, {"configuration": text.replace(old, new)})
    with pytest.raises(InputError, match=expected):
        load_checkpoint(saved)


@pytest.mark.parametrize("key", ["configuration", "training_record"])
@pytest.mark.parametrize("value", [None, "{", "[]", '{"dt": -1}'])
def test_a_damaged_header_is_refused(saved, key, value):
    rewrite(saved, {key: value})
    with pytest.raises(InputError, match=str(saved)):
        load_checkpoint(saved)


def test_diverged_weights_are_refused(saved):
    tensors = load_file(saved)
    with safe_open(saved, "pt") as file:
        metadata = file.metadata()
    tensors["network.decoder.last.bias"][1] = float("nan")
    save_file(tensors, saved, metadata)
    with pytest.raises(InputError, match=r"network\.decoder\.last\.bias"):
        load_checkpoint(saved)


def test_a_missing_model_is_refused_with_the_names_there_are():
    with pytest.raises(InputError, match="built in:"):
        from_pretrained("no_such_model")


def test_every_built_in_model_loads():
    for name in built_in_models():
        assert from_pretrained(name).name == name


@pytest.mark.parametrize("steps", [0, -3, 10_000])
def test_a_senseless_number_of_propagation_steps_is_refused(saved, steps):
    with pytest.raises(InputError, match=f"between 1 and 500, not {steps}"):
        load_checkpoint(saved).prepare(pack([sheet(5, 5)]), propagation_steps=steps)


def test_a_resolution_never_seen_is_warned_of_with_what_to_expect(saved):
    checkpoint = load_checkpoint(saved)
    fine, coarse = sheet(9, 9, edge=0.006), sheet(9, 9, edge=0.04)
    with pytest.warns(InputWarning, match=r"12\.0 to 16\.0 mm"):
        checkpoint.prepare(pack([fine]), propagation_steps=20)
    with pytest.warns(InputWarning, match=r"coarser .*`--triangles \d+`"):
        checkpoint.prepare(pack([coarse]))


def test_propagation_steps_never_seen_are_warned_of(saved):
    with pytest.warns(InputWarning, match=r"40 .*1 to 30"):
        load_checkpoint(saved).prepare(pack([sheet(9, 9, edge=0.012)]), propagation_steps=40)


def test_a_resolution_seen_is_not_warned_of(saved):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_checkpoint(saved).prepare(pack([sheet(9, 9, edge=0.012)]))


def test_a_failed_write_leaves_the_old_file_and_nothing_else(saved, monkeypatch):
    before = saved.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match="No space left"):
        save_checkpoint(saved, AccelerationModel(TINY.network()), TINY, RECORD)
    assert saved.read_bytes() == before
    assert [entry.name for entry in saved.parent.iterdir()] == [saved.name]
    monkeypatch.undo()
    with pytest.raises(InputError, match="Cannot write"):
        save_checkpoint(saved.parent / "absent" / "a.safetensors", AccelerationModel(TINY.network()), TINY, RECORD)


def test_the_file_reads_without_this_package(saved):
    with safe_open(saved, "np") as file:
        header = file.metadata()
        assert json.loads(header["training_record"])["dt"] == pytest.approx(DT)
        assert header["licence"] == "CC0-1.0"
        assert all(np.isfinite(file.get_tensor(key)).all() for key in file.keys())  # noqa: SIM118


@pytest.mark.parametrize(("file", "name"), [("mine/best.safetensors", "mine-best"), ("mine/wool.safetensors", "wool")])
def test_weights_of_a_training_are_called_after_its_folder(file: str, name: str) -> None:
    assert weights_name(Path(file)) == name
