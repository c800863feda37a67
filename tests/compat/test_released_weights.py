"""Released checkpoints as networks of ours: against what the released code computed, and against damage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from golden_scenes import MESH, NODE, RELATIVE_MESH, WORLD, GoldenEdges, GoldenScene, columns, predicted
from tests.simulation.released_files import made_checkpoint

from pb4u.compat.released_methods import METHODS
from pb4u.compat.released_weights import UNKNOWN_LICENCE, read_released
from pb4u.errors import InputError
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.simulation.checkpoint import Checkpoint, load_checkpoint
from pb4u.simulation.network_pass import NetworkPass, StepFeatures

GOLDEN = {
    "pb4u": ("checkpoints/pb4u.pth", "pb4u_dress", "pb4u_skirt"),
    "pb4u_128_wide": ("weights/pb4u_128_wide.safetensors", "pb4u_128_wide_dress"),
    "hood": ("checkpoints/hood.pth", "hood_dress", "hood_skirt"),
    "hood_cvpr": ("checkpoints/hood_cvpr.pth", "hood_cvpr_dress", "hood_cvpr_skirt"),
    "fine15": ("checkpoints/fine15.pth", "fine15_dress", "fine15_skirt"),
}
SCENES = [(name, scene) for name, (_, *scenes) in GOLDEN.items() for scene in scenes]


@pytest.mark.parametrize(("name", "scene"), SCENES)
def test_every_step_of_the_released_code_is_met(compat: Path, name: str, scene: str) -> None:
    released = read_released(compat / GOLDEN[name][0])
    exact, single = released.checkpoint(torch.float64), released.checkpoint()
    for golden in GoldenScene.cases(compat / f"golden/{scene}.npz"):
        for number in golden.steps:
            _, acceleration, after = predicted(exact, golden.time_step(number))
            assert np.abs(acceleration.numpy() - golden.value(number, "pred_acceleration")).max() < 1e-9
            assert np.abs(after.positions.numpy() - golden.value(number, "pred_pos")).max() < 1e-9
            _, _, after = predicted(single, golden.time_step(number, torch.float32))
            assert np.abs(after.positions.numpy() - golden.value(number, "pred_pos")).max() < 1e-6


@pytest.mark.parametrize(("name", "scene"), SCENES)
def test_every_feature_of_the_released_code_is_met(compat: Path, name: str, scene: str) -> None:
    checkpoint = read_released(compat / GOLDEN[name][0]).checkpoint(torch.float64)
    golden = GoldenScene(compat / f"golden/{scene}.npz", 0)
    seen = [number for number in golden.steps if golden.has(number, "node_features")]
    assert seen
    for number in seen:
        graph, _, _ = predicted(checkpoint, golden.time_step(number))
        normalised = checkpoint.model.normalised(graph)
        given = golden.value(number, "node_features")
        order = {key: width for key, width in NODE.items() if key != "level" or given.shape[1] == sum(NODE.values())}
        theirs = _split(given, order)
        for column, values in columns(normalised, checkpoint, "node"):
            _assert_close(values, theirs[column], column)
        _compare_mesh_edges(checkpoint, normalised, golden, number)
        _compare_world_edges(normalised, golden, number)


@pytest.mark.parametrize(("case", "number"), [(0, 1), (1, 0)])
def test_contourcraft_with_the_edges_that_its_code_found_is_met(compat: Path, case: int, number: int) -> None:
    released = read_released(compat / "checkpoints/contourcraft.pth")
    golden = GoldenScene(compat / "golden/contourcraft_outfit.npz", case)
    for dtype, bound in ((torch.float64, 1e-9), (torch.float32, 1e-6)):
        model, step = released.checkpoint(dtype).model, golden.time_step(number, dtype)
        prepared = model.prepare(step.garments, dtype=dtype)
        prepared = replace(prepared, builder=replace(prepared.builder, finder=GoldenEdges(golden, number)))
        network = NetworkPass(model, prepared, StepFeatures(prepared, IncrementalPotential()))
        nothing = torch.zeros_like(step.state.positions)
        acceleration = network.correction(step, nothing)
        assert np.abs(acceleration.numpy() - golden.value(number, "pred_acceleration")).max() < bound
        edges = network.graph(step, nothing).edges["body_to_garment"]
        on_cloth, on_body = golden.value(number, "body_edge_index")
        np.testing.assert_array_equal(edges.receivers.index, on_cloth)
        np.testing.assert_array_equal(golden.value(number, "body_index")[edges.senders.index], on_body)


def _compare_mesh_edges(checkpoint: Checkpoint, graph: Any, golden: GoldenScene, number: int) -> None:
    given = golden.value(number, "mesh_edge_features")
    order = MESH if given.shape[1] == sum(MESH.values()) else RELATIVE_MESH
    assert tuple(order) == checkpoint.model.network.configuration.layout.mesh_edge
    edges, count = graph.edges["mesh"], len(golden.garment.vertices)
    ours = (edges.senders.index * count + edges.receivers.index).numpy()
    senders, receivers = golden.data["scene/mesh_edge_index"].astype(np.int64)
    row = np.argsort(ours)[np.searchsorted(np.sort(ours), senders * count + receivers)]
    _assert_close(edges.features[row], given, "mesh")


def _compare_world_edges(graph: Any, golden: GoldenScene, number: int) -> None:
    given, index = golden.value(number, "world_features"), golden.value(number, "world_edge_index")
    edges, kept = graph.edges["body_to_garment"], golden.value(number, "body_index")
    np.testing.assert_array_equal(edges.receivers.index, index[0])
    np.testing.assert_array_equal(kept[edges.senders.index], index[1])
    # Offsets have the other sign here: those to the receiver from the sender, there to the sender from the receiver.
    sign = torch.tensor([-1.0 if name.startswith("relative") else 1.0 for name in WORLD], dtype=torch.float64)
    sign = sign.repeat_interleave(torch.tensor(list(WORLD.values())))
    back = graph.edges["garment_to_body"]
    to_body = back.features[torch.argsort(back.senders.index, stable=True)]
    _assert_close(torch.cat([to_body, edges.features]) * sign, given, "world")


def _split(values: np.ndarray, widths: dict[str, int]) -> dict[str, np.ndarray]:
    parts = np.split(values, np.cumsum(list(widths.values()))[:-1], axis=1)
    return dict(zip(widths, parts, strict=True))


def _assert_close(ours: torch.Tensor, theirs: np.ndarray, what: str) -> None:
    # Both are of the order of 1; the golden ones are rounded to single precision.
    scale = max(1.0, float(np.abs(theirs).max()))
    assert np.abs(ours.detach().numpy() - theirs).max() < 1e-7 * scale, what


@pytest.mark.parametrize("name", ["pb4u", "fine15", "hood", "hood_cvpr", "contourcraft"])
def test_a_converted_file_gives_the_same_network_to_the_bit(compat: Path, name: str, tmp_path: Path) -> None:
    released = read_released(compat / f"checkpoints/{name}.pth", licence="MIT")
    released.save(tmp_path / "ours.safetensors")
    for dtype in (torch.float32, torch.float64):
        direct = released.checkpoint(dtype).model.state_dict()
        loaded = load_checkpoint(tmp_path / "ours.safetensors", dtype=dtype)
        assert loaded.licence == "MIT"
        for key, value in loaded.model.state_dict().items():
            assert value.dtype == direct[key].dtype, key
            assert torch.equal(value, direct[key]), key
    assert released.record.optimiser_steps == (6 if name == "contourcraft" else 12)
    assert read_released(compat / f"checkpoints/{name}.pth").licence == UNKNOWN_LICENCE


def test_size_rules_and_ranges_come_from_the_file(tmp_path: Path) -> None:
    torch.save(made_checkpoint(), tmp_path / "mine.pth")
    released = read_released(tmp_path / "mine.pth")
    configuration: Any = released.configuration
    assert (released.name, released.preset) == ("mine", "release_mgn")
    assert (configuration.width, configuration.blocks, configuration.world_edges.radius) == (8, 2, 0.02)
    assert configuration.layout.material_range.lame_mu == (100.0, 200.0)
    assert released.record.dt == 0.02
    torch.save(made_checkpoint()["training_module"], tmp_path / "bare.pth")
    assert read_released(tmp_path / "bare.pth").preset == "release_mgn"
    assert read_released(tmp_path / "bare.pth", "release_mgn").configuration.world_edges.radius == 0.03


def _without(content: dict[str, Any], part: str) -> dict[str, Any]:
    weights = content["training_module"]
    return {**content, "training_module": {key: value for key, value in weights.items() if part not in key}}


def _with(content: dict[str, Any], **weights: torch.Tensor) -> dict[str, Any]:
    named = {key.replace("__", "."): value for key, value in weights.items()}
    return {**content, "training_module": {**content["training_module"], **named}}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ([1, 2], "not the dictionary"),
        ({"state_dict": {"layer.weight": torch.zeros(2)}}, "not a checkpoint of"),
        ({"training_module": {}}, "not a checkpoint of"),
        (_without(made_checkpoint(), "decoder"), "lacks model._learned_model.decoder"),
        (_without(made_checkpoint(), "_node_normalizer"), "lacks model._node_normalizer"),
        (_without(made_checkpoint(), "processor_steps.0"), "lacks a block"),
        (_with(made_checkpoint(), model__extra_embedding__weight=torch.zeros(2)), "does not have"),
        (_with(made_checkpoint(), model__nodetype_embedding__weight=torch.full((9, 9), torch.nan)), "not finite"),
        (
            _with(made_checkpoint(), model___learned_model__node_encoder__0__layers__0__weight=torch.zeros(8, 21)),
            "21 columns",
        ),
        (
            _with(made_checkpoint(), model___learned_model__decoder__layers__2__weight=torch.zeros(8, 9)),
            "another feature layout or size",
        ),
        ({**made_checkpoint(), "config": {"model": {"transformer": {}}}}, "no known method"),
        ({**made_checkpoint(), "config": {"model": {"baselines": {"message_passing_steps": 5}}}}, "settings say 5"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_one_of_theirs_is_refused(tmp_path: Path, content: Any, told: str) -> None:
    torch.save(content, tmp_path / "odd.pth")
    with pytest.raises(InputError, match=told):
        read_released(tmp_path / "odd.pth").checkpoint()


def test_a_method_of_another_name_is_refused(tmp_path: Path) -> None:
    torch.save(made_checkpoint(), tmp_path / "mine.pth")
    with pytest.raises(InputError, match="release_pb4u"):
        read_released(tmp_path / "mine.pth", "hod")
    with pytest.raises(InputError, match="reads 11"):
        read_released(tmp_path / "mine.pth", "release_pb4u")
    with pytest.raises(InputError, match="There is no checkpoint"):
        read_released(tmp_path / "none.pth")
    assert set(METHODS) >= {"release_pb4u", "release_mgn"}
