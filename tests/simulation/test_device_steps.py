"""Steps on an accelerator without one: nothing waits for the host, and a processor computes the same either way."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from tests.network_scenes import accelerations, moment, sheet
from tests.simulation.ball_scene import Ball, ball_scene
from torch.fx.experimental.proxy_tensor import make_fx

from pb4u.collision.capacities import Capacities
from pb4u.errors import InputError
from pb4u.garment.dressing import AttachedPlacement
from pb4u.geometry.triangle_mesh import vertex_normals
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.registry import NETWORKS
from pb4u.physics.contact.contact_set import ContactPlanes
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.simulation.checkpoint import from_pretrained
from pb4u.simulation.device_steps import states_after
from pb4u.simulation.models import load_simulator
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.pass_search import eigenvectors, search_of
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod, Taken, predictions
from pb4u.simulation.step_graph import Outputs
from pb4u.simulation.step_start import start_of
from pb4u.simulation.stepwise_simulator import NetworkSimulator
from pb4u.simulation.timeline import Timeline
from pb4u.training.distribution import workers

ROOT = Path(__file__).parents[2]
SIX = IncrementalPotential()


def method_of(model: AccelerationModel, timeline: Timeline) -> StepMethod:
    network = model.network
    dtype = next(model.parameters()).dtype
    prepared = model.prepare(timeline.garments, dtype=dtype)
    c = network.configuration
    passes = NetworkPass(model, prepared, StepFeatures(prepared, SIX), c.passes, further=min(c.further_passes, 2))
    return StepMethod(start_of(network, SIX), passes, search=search_of(network, SIX))


def on_host(model: AccelerationModel, steps: int) -> list[torch.Tensor]:
    timeline = Timeline.of(ball_scene(frames=steps + 2, cells=7))
    method, taken = method_of(model, timeline), Taken(timeline.skinned_state(1))
    made = []
    for _ in range(steps):
        *_, taken = predictions(timeline.step_from(taken.state), method, taken.last_move)
        made.append(taken.state.positions.detach())
    return made


@pytest.fixture
def in_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on an accelerator: eigenvectors in closed form, and contact normals that do not hang on which face is named.

    Where two faces are equally near, rounding decides; their normals differ, and so friction would.
    """
    monkeypatch.setattr("torch.linalg.eigh", eigenvectors)
    monkeypatch.setattr(ContactPlanes, "transported_normals", lambda self, pose: self.normals)


def on_device(
    model: AccelerationModel, steps: int, capacities: Capacities, replays: bool = False, device: str = "cpu"
) -> list[torch.Tensor]:
    timeline = Timeline.of(ball_scene(frames=steps + 2, cells=7)).to(torch.device(device), capacities)
    states = states_after(timeline, method_of(model, timeline), Taken(timeline.skinned_state(1)), steps + 2, replays)
    return [state.positions for state in states]


def take_torch_layers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the layers and the normals that a card takes, which launches no compiled ones."""
    monkeypatch.setattr("pb4u.network.graph.builder.feature_normals", vertex_normals)
    for user in ("interaction_block", "mlp", "propagation"):
        monkeypatch.setattr(f"pb4u.network.{user}.are_compiled", lambda *given: False)


@pytest.mark.parametrize(("dtype", "near", "steps"), [(torch.float64, 1e-8, 18), (torch.float32, 1e-5, 20)])
def test_both_ways_lead_to_the_same_states(
    monkeypatch: pytest.MonkeyPatch, dtype: torch.dtype, near: float, steps: int, in_tensors: None
) -> None:
    if dtype == torch.float32:
        # Cloth that buckles triples another rounding of the layers in each step.
        take_torch_layers(monkeypatch)
    # From 1e-16 in the first step, rounding of sums in another order doubles or triples in each.
    model = from_pretrained("pb4u-wide").model.to(dtype)
    expected = on_host(model, steps)
    found = on_device(model, steps, Capacities())
    assert len(found) == steps
    assert float((expected[-1] - expected[0]).abs().max()) > 5e-3
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=near)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize(("dtype", "near"), [(torch.float64, 1e-8), (torch.float32, 1e-3)])
@pytest.mark.parametrize("replays", [False, True])
def test_a_card_leads_to_the_same_states(
    monkeypatch: pytest.MonkeyPatch, dtype: torch.dtype, near: float, replays: bool, in_tensors: None
) -> None:
    take_torch_layers(monkeypatch)
    model = from_pretrained("pb4u-wide").model.to(dtype)
    expected = on_host(model, 12)
    found = on_device(model.to("cuda"), 12, Capacities(), replays, "cuda")
    assert len(found) == 12
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=near)


def test_a_step_with_too_little_room_is_taken_again(in_tensors: None) -> None:
    model = from_pretrained("pb4u-wide").model.double()
    capacities = Capacities()
    capacities.sizes = {"faces": 10, "world edges": 3, "body nodes": 2, "passes": 2}
    found = on_device(model, 4, capacities)
    assert capacities.sizes["faces"] > 100
    for one, other in zip(found, on_host(model, 4), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-8)


def traced(compute: Callable[..., Outputs], inputs: list[torch.Tensor], pool: object) -> Callable[[], Outputs]:
    """As a card captures it: the operations as they are launched, whatever the host decided between them."""
    graph = make_fx(compute)(*inputs)
    return torch.no_grad()(lambda: graph(*inputs))


@pytest.mark.parametrize("spoilt", [False, True])
def test_steps_are_replayed_where_their_shapes_stay(
    spoilt: bool, in_tensors: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replay has no Python: all that changes between steps must be among its inputs."""
    graphs = []

    def noted(compute: Callable[..., Outputs], inputs: list[torch.Tensor], pool: object) -> Callable[[], Outputs]:
        replay = traced(compute, inputs, pool)
        graphs.append(0)

        def counted() -> Outputs:
            graphs[-1] += 1
            positions, *others = replay()
            return (positions + 1e-3 * spoilt, *others)

        return counted

    torch.manual_seed(0)
    searched = replace(NETWORKS["pb4u_small_conjugate"], passes=1, further_passes=0, warm_start_shares=())
    small = replace(NETWORKS["literal"] if spoilt else searched, width=8, blocks=1)
    model = AccelerationModel(small.network()).double()
    monkeypatch.setattr("pb4u.simulation.step_graph.captured", noted)
    take_torch_layers(monkeypatch)
    plain, replayed = (on_device(model, 7, Capacities(), replays) for replays in (False, True))
    for one, other in zip(plain, replayed, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-12)
    # Of seven steps the first begins without a move, two more are plain, one is compared, three are replayed.
    assert graphs == ([1] if spoilt else [4])


@pytest.mark.parametrize("rows", [1, 2])
def test_the_closed_form_has_the_eigenvectors_of_the_library(rows: int) -> None:
    drawn = torch.randn(200, rows, rows, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    matrices = torch.cat([drawn + drawn.mT, torch.eye(rows, dtype=torch.float64)[None], torch.zeros_like(drawn[:1])])
    values, vectors = eigenvectors(matrices)
    torch.testing.assert_close(values.sort(dim=1).values, torch.linalg.eigvalsh(matrices), rtol=0, atol=1e-13)
    torch.testing.assert_close(vectors * values[:, None] @ vectors.mT, matrices, rtol=0, atol=1e-13)


def test_what_a_card_cannot_do_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """No card, a driver too old, no products in bfloat16: in simulation, and the first two in training."""
    with pytest.raises(InputError, match="'cuda:1'"):
        load_simulator("pb4u-small", device="cuda:1")
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr("torch.version.cuda", None)
    with pytest.raises(InputError, match="--device cpu"):
        load_simulator("pb4u-small", device="cuda")
    with pytest.raises(InputError, match="--device cpu"), workers("cuda"):
        pass
    monkeypatch.setattr("torch.version.cuda", "13.0")
    with pytest.raises(InputError, match=r"CUDA 13\.0"):
        load_simulator("pb4u-small", device="cuda")
    with pytest.raises(InputError, match="update the driver"), workers("cuda"):
        pass
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.is_bf16_supported", lambda including_emulation: False)
    with pytest.raises(InputError, match="bfloat16"):
        load_simulator("pb4u-small", device="cuda", precision="bfloat16")


def worlds(shift: float = 0.0) -> list[Scene]:
    """Scenes of other cloth, motion and length, one of them elsewhere."""
    scenes = [ball_scene(frames=4, cells=7), ball_scene(frames=3, cells=5, speed=2.0), ball_scene(frames=4, cells=4)]
    body, garment = scenes[2].colliders[0], scenes[2].garments[0].garment
    assert isinstance(body, Ball)
    body.rest_vertices = body.rest_vertices + [shift, 0.0, 0.0]
    garment = replace(garment, vertices=garment.vertices + [shift, 0.0, 0.0])
    scenes[2] = replace(scenes[2], garments=(DressedGarment(garment, AttachedPlacement(garment, body)),))
    return scenes


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize(("dtype", "near", "shift"), [(torch.float64, 1e-8, 3.0), (torch.float32, 1e-5, 400.0)])
def test_a_scene_of_a_pack_is_the_scene_alone(
    dtype: torch.dtype, near: float, shift: float, fixed: bool, in_tensors: None
) -> None:
    """Starts, lengths, further passes and origins are those of each world."""
    model, passes = from_pretrained("pb4u-wide").model.to(dtype), []

    def rolled(scenes: list[Scene]) -> list[torch.Tensor]:
        timeline, frames = Timeline.of_worlds(scenes), max(scene.total_frames for scene in scenes)
        timeline = timeline.to(torch.device("cpu"), Capacities()) if fixed else timeline
        method, taken = method_of(model, timeline), Taken(timeline.skinned_state(1))
        if fixed:
            return [state.positions for state in states_after(timeline, method, taken, frames)]
        states = []
        for _ in range(2, frames):
            made = list(predictions(timeline.step_from(taken.state), method, taken.last_move))
            passes.append(len(made))
            taken = made[-1]
            states.append(taken.state.positions.detach())
        return states

    scenes = worlds(shift)
    together, offsets = rolled(scenes), Timeline.of_worlds(scenes).garments.world_offsets
    for scene, (start, stop) in zip(scenes, pairwise(offsets), strict=True):
        alone = rolled([scene])
        assert float((alone[-1] - alone[0]).abs().max()) > 5e-3
        for one, other in zip(alone, together, strict=False):
            torch.testing.assert_close(other[start:stop], one, rtol=0, atol=near)
    assert fixed or len(set(passes)) > 1, "scenes that take different numbers of passes"


COUNT = """
from dataclasses import replace
from accelerator import NETWORKS, count
from tests.simulation.ball_scene import ball_scene
NETWORKS["bare"] = replace(NETWORKS["literal"], width=8, blocks=1)
counted, _ = count("bare", ball_scene(cells=4))
pack, _ = count("bare", ball_scene(cells=4), ball_scene(cells=3, speed=1.0))
print(sum(counted.launches.values()), sum(pack.launches.values()), dict(counted.transfers + pack.transfers))
"""


def test_a_step_on_a_card_copies_nothing() -> None:
    """In a process of its own, on fake CUDA tensors: reading a value back there is an error, and copies are counted."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "benchmarks"), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", COUNT],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    launches, of_pack, transfers = done.stdout.split(" ", 2)
    assert 100 < int(launches) < 1000
    assert int(launches) <= int(of_pack) < 1.2 * int(launches)
    assert transfers.strip() == "{}", "copies between processor and card in a step"


def test_a_step_with_start_search_and_features_copies_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same on tensors without values, "meta", for one scene and for several in a pack."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    accelerator = import_module("accelerator")
    small = replace(NETWORKS["pb4u_small_conjugate"], passes=1, further_passes=1, width=8, blocks=1)
    monkeypatch.setitem(NETWORKS, "whole", small)
    for scenes in ([ball_scene(cells=4)], worlds()):
        counted, _ = accelerator.count("whole", *scenes, card=torch.device("meta"))
        assert sum(counted.launches.values()) > 1000
        assert not counted.transfers


def test_garments_of_different_k_step_side_by_side() -> None:
    """Where shapes may not change, a garment rests after its last propagation step instead of leaving."""
    torch.manual_seed(0)
    model = AccelerationModel(replace(NETWORKS["literal"], width=8, blocks=1).network()).double()
    at = moment([sheet(8, 8), sheet(6, 6, edge=0.02)])
    expected = accelerations(model, at, (4, 2))
    bodies = at.collider.colliders.to(torch.device("cpu"), Capacities())
    poses = (at.collider.previous, at.collider.now, at.collider.following)
    padded = replace(at, collider=type(at.collider)(*(bodies.pose(pose.positions) for pose in poses)))
    found = accelerations(model, padded, (4, 2))
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-10)
    # Compiled passes would read rows that are only room as edges.
    parts = [torch.autograd.grad(made.square().sum(), list(model.parameters())) for made in (found, expected)]
    for one, other in zip(*parts, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-8, atol=1e-12)


def test_of_two_cards_each_process_takes_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    monkeypatch.setattr("torch.cuda.set_device", taken.append)
    with workers("auto") as alone:
        assert alone.device == torch.device("cuda:0")
    monkeypatch.setenv("LOCAL_RANK", "1")
    with workers("cuda") as second:
        assert second.device == torch.device("cuda:1")
    assert taken == [torch.device("cuda:0"), torch.device("cuda:1")]
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(InputError, match=r"2 cards .*process 3"), workers("cuda"):
        pass


def test_a_scene_that_a_card_has_no_room_for_is_refused_before_its_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator, scene = NetworkSimulator(from_pretrained("pb4u-small")), ball_scene()
    monkeypatch.setattr(NetworkSimulator, "on_card", True)
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda device: (10**9, 10**11))
    timeline = simulator.timeline(scene)
    assert timeline.colliders.capacities is not None
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda device: (5 * 10**5, 10**11))
    refused = r"has 0\.0 GB free, but the scene takes about .* garments of ([\d,]+) triangles in total would fit"
    with pytest.raises(InputError, match=refused) as error:
        next(simulator.rollout(scene, RunRecord()))
    named = int(re.search(refused, str(error.value)).group(1).replace(",", ""))  # type: ignore[union-attr]
    assert 0 < named < len(timeline.garments.faces)
