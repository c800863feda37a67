"""Laws that the network keeps whatever its weights."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from tests.network_scenes import DT, Moment, accelerations, moment, placed, prepared_for, sheet, sheet_of
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from pb4u.garment.garment import Garment
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation import RELEASED_PROPAGATION
from pb4u.network.propagation_control import ConstantDistance
from pb4u.network.registry import NETWORKS
from pb4u.network.update_scaling import PerVertexScaling
from pb4u.paper.network_presets import pb4u_paper
from pb4u.scene.packed import pack

TINY = Pb4uConfiguration(width=16, blocks=3)
RELEASE = replace(TINY, propagation=RELEASED_PROPAGATION)
both_forms = pytest.mark.parametrize("configuration", [TINY, RELEASE], ids=["paper", "release"])


def model_of(configuration: Pb4uConfiguration, dtype: torch.dtype = torch.float64) -> AccelerationModel:
    torch.manual_seed(5)
    return AccelerationModel(configuration.network()).to(dtype)


def difference(a: torch.Tensor, b: torch.Tensor) -> float:
    """Largest difference, relative to the largest value."""
    return float((a - b).detach().abs().max() / b.detach().abs().max())


@both_forms
def test_moving_everything_changes_nothing_in_float64(configuration):
    model, at = model_of(configuration), moment([sheet(8, 9), sheet(7, 6, edge=0.02)])
    here = accelerations(model, at)
    there = accelerations(model, at.shifted(torch.tensor([3.1, -0.7, 12.9], dtype=torch.float64)))
    assert difference(there, here) < 1e-10


def test_moving_everything_10_m_changes_nothing_in_float32_around_an_origin_of_the_step():
    model = model_of(TINY, torch.float32)
    # On a grid of 2^-20 m every position is exact in float32 here and 10 m away alike, so nothing but the network's own
    # arithmetic is compared.
    at = _on_grid(moment([sheet(8, 9)]))
    shift = torch.tensor([10.0, 0.0, -10.0])
    here = accelerations(model, at, dtype=torch.float32, origins=torch.zeros(1, 3))
    there = accelerations(model, at.shifted(shift), dtype=torch.float32, origins=shift[None])
    assert torch.equal(here, there)


def test_float64_positions_10_m_away_lose_nothing_in_a_float32_network():
    model, at = model_of(TINY, torch.float32), moment([sheet(8, 9)])
    shift = torch.tensor([10.0, 0.0, -10.0], dtype=torch.float64)
    here = accelerations(model, at, dtype=torch.float32)
    with_origin = accelerations(model, at.shifted(shift), dtype=torch.float32, origins=shift[None])
    without_origin = accelerations(model, at.shifted(shift), dtype=torch.float32)
    assert difference(with_origin, here) < 1e-6
    assert difference(without_origin, here) > 10 * difference(with_origin, here)


def _on_grid(at: Moment) -> Moment:
    def rounded(values: torch.Tensor) -> torch.Tensor:
        return (values - values.remainder(2.0**-20)).float()

    state = replace(at.state, positions=rounded(at.state.positions), velocities=at.state.velocities.float())
    return replace(at, state=state, collider=placed(at.collider, rounded))


@both_forms
def test_renumbering_vertices_renumbers_the_result(configuration):
    garment = sheet(8, 9)
    model, at = model_of(configuration), moment([garment])
    order = np.random.default_rng(3).permutation(len(garment.vertices))
    place = np.argsort(order)
    faces = np.random.default_rng(4).permutation(place[garment.faces])
    renumbered = Garment("renumbered", garment.vertices[order], faces, garment.material)
    state = replace(at.state, positions=at.state.positions[order], velocities=at.state.velocities[order])
    expected = accelerations(model, at)[torch.as_tensor(order)]
    assert difference(accelerations(model, replace(at, garments=pack([renumbered]), state=state)), expected) < 1e-10


@both_forms
def test_a_pack_of_different_depths_equals_its_garments_one_by_one(configuration):
    garments = [sheet(8, 9), sheet(7, 6, edge=0.03, seed=1), sheet(9, 10, edge=0.01, seed=2), sheet(5, 5, seed=3)]
    model, at = model_of(configuration), moment(garments)
    steps = prepared_for(model, at).steps
    assert len(set(steps)) >= 3
    assert steps[0] != max(steps)
    together = accelerations(model, at)
    for index in range(len(garments)):
        start, stop = at.garments.vertex_offsets[index : index + 2]
        assert difference(together[start:stop], accelerations(model, at.alone(index))) < 1e-12


def test_garments_of_a_pack_do_not_feel_each_other():
    model, at = model_of(TINY), moment([sheet(8, 9), sheet(7, 6, edge=0.03, seed=1)])
    before, count = accelerations(model, at), len(at.garments.garments[0].vertices)
    positions = at.state.positions.clone()
    positions[count:] += 0.01 * torch.randn_like(positions[count:])
    after = accelerations(model, replace(at, state=replace(at.state, positions=positions)))
    assert torch.equal(before[:count], after[:count])
    assert not torch.allclose(before[count:], after[count:])


def test_as_many_steps_as_edges_fit_into_the_same_distance_at_every_resolution():
    control = ConstantDistance(0.225)
    depths = []
    for triangles in (2500, 11000, 18000, 25000, 38000):
        length = sheet_of(triangles).mean_edge_length
        steps = control.steps(length)
        assert control.distance - length < steps * length <= control.distance * (1 + 1e-6)
        depths.append(steps)
    assert depths == sorted(depths)
    assert depths[-1] > 3.5 * depths[0]


@pytest.mark.parametrize(("steps", "blocks"), [(1, 0), (1, 3), (4, 3), (2, 5)])
@both_forms
def test_a_poked_vertex_is_felt_exactly_as_far_as_steps_and_blocks_reach(configuration, steps, blocks):
    garment = sheet(21, 17)
    model = model_of(replace(configuration, blocks=blocks))
    at = moment([garment], body=False)
    centre = 10 * 17 + 8
    velocities = at.state.velocities.clone()
    velocities[centre] += torch.tensor([0.0, 0.5, 0.0], dtype=torch.float64)
    poked = replace(at, state=replace(at.state, velocities=velocities))
    moved = (accelerations(model, at, steps) != accelerations(model, poked, steps)).any(dim=1).numpy()

    edges = garment.topology.edges
    ones = np.ones(len(edges))
    links = coo_matrix((ones, edges.T), shape=(len(garment.vertices),) * 2)
    hops = dijkstra(links, directed=False, unweighted=True, indices=centre)
    reach = steps + blocks
    assert hops.max() > reach
    np.testing.assert_array_equal(moved, hops <= reach)


def test_with_the_same_forces_a_finer_mesh_moves_in_proportion_to_its_edges():
    """Twice the resolution, the same network output: the paper's scaling halves the update."""
    coarse, fine = sheet(7, 7, edge=0.02), sheet(7, 7, edge=0.01)
    scaling = PerVertexScaling(0.015)
    factors = [scaling.factors(model_of(TINY).prepare(pack([g])).builder.static) for g in (coarse, fine)]
    torch.testing.assert_close(factors[1], 0.5 * factors[0])


MEASURED_STEP = """
import sys
from dataclasses import replace
sys.path.insert(0, sys.argv[1])
import torch
torch.set_num_threads(1)
from tests.network_scenes import DT, moment, sheet_of
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.paper.network_presets import pb4u_paper
at = moment([sheet_of(38000)], dtype=torch.float32)
model = AccelerationModel(replace(pb4u_paper, blocks=2).network())
small = moment([sheet_of(200)], dtype=torch.float32)
def step(at, steps=None):
    prepared = model.prepare(at.garments, steps)
    with torch.inference_mode():
        return model(prepared.graph(at.state, at.collider, DT), prepared)
def peak():
    # Not getrusage: its peak is inherited from the process that started this one.
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
step(small)
before = peak()
result = step(at, 2)
assert bool(torch.isfinite(result).all())
print(peak() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="peak memory is read in kilobytes as Linux counts it")
def test_a_step_of_the_paper_size_network_at_38_000_triangles_takes_less_than_1_gib():
    """Two propagation steps instead of 28 and two blocks instead of 15: each frees what it took, more need no more."""
    root = Path(__file__).resolve().parents[2]
    run = subprocess.run(
        [sys.executable, "-c", MEASURED_STEP, str(root)], capture_output=True, text=True, check=False, timeout=300
    )
    assert run.returncode == 0, run.stderr
    assert 0 < int(run.stdout) * 1024 < 2**30


class LiveBytes(TorchDispatchMode):
    """Counts the bytes of tensors made while it is active and still alive, and the most there ever were."""

    def __init__(self) -> None:
        super().__init__()
        self.now, self.peak = 0, 0
        self._owners: dict[int, int] = {}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        for tensor in tree_leaves(result):
            if isinstance(tensor, torch.Tensor) and tensor.untyped_storage().nbytes():
                memory = tensor.untyped_storage()
                self._count(memory.data_ptr(), memory.nbytes(), 1)
                weakref.finalize(tensor, self._count, memory.data_ptr(), memory.nbytes(), -1)
        self.peak = max(self.peak, self.now)
        return result

    def _count(self, address: int, size: int, change: int) -> None:
        """A tensor more or less that shares the memory at an address."""
        before = self._owners.get(address, 0)
        self._owners[address] = before + change
        self.now += size * ((before + change > 0) - (before > 0))


def peak_bytes(model: AccelerationModel, at: Moment, steps: int) -> int:
    prepared = model.prepare(at.garments, steps)
    graph = prepared.graph(at.state, at.collider, DT)
    # Arrays of numpy, which compiled layers take, are not among the tensors.
    tracemalloc.start()
    with LiveBytes() as counted:
        model(graph, prepared)
    arrays = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return counted.peak + arrays


def test_memory_while_predicting_does_not_grow_with_the_propagation_steps_and_while_learning_it_does():
    model = AccelerationModel(replace(pb4u_paper, width=32, blocks=1).network())
    at = moment([sheet_of(2000)], dtype=torch.float32)
    latents = 4 * 32 * prepared_for(model, at).builder.static.edges["mesh"].senders.index.shape[0]
    with torch.no_grad():
        # The first time kernels are loaded.
        _, few, many = (peak_bytes(model, at, steps) for steps in (2, 2, 40))
    assert few > latents
    # Any array kept of each step would be six times the latents.
    assert many - few < 0.1 * latents
    assert peak_bytes(model, at, 40) - peak_bytes(model, at, 2) > 38 * latents


def test_an_ablation_differs_from_the_paper_in_the_replaced_part_only():
    changed = {
        "without_propagation_control": {"control"},
        "without_update_scaling": {"scaling"},
        "without_both": {"control", "scaling"},
        "pb4u_small": {"width", "blocks"},
    }
    for name, parts in changed.items():
        other = NETWORKS[name]
        assert {part for part in vars(other) if getattr(other, part) != getattr(pb4u_paper, part)} == parts
