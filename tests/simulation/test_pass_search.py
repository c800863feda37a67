"""How far a step goes along a pass."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from ball_scene import ball_scene, sheet
from tests.physics.shapes import nobody
from torch import Tensor

from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.features import ADVANCE, DESCENT, FeatureLayout
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.descent import JacobiDescent
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.packed import pack
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import TrainingRecord, load_checkpoint, save_checkpoint
from pb4u.simulation.models import load_simulator
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.pass_search import PassSearch, conjugate_move, search_of
from pb4u.simulation.step import StepMethod, Taken, predictions
from pb4u.simulation.stepwise_simulator import NetworkSimulator
from pb4u.simulation.timeline import Timeline

SIX = IncrementalPotential()
SEARCH = partial(conjugate_move, SIX)
CONJUGATE = Pb4uConfiguration(
    width=8, blocks=1, layout=FeatureLayout(extra=(DESCENT, ADVANCE)), passes=2, conjugate=True
)


def sheets(*cells: int, pinned: bool = False) -> TimeStep:
    """Crumpled sheets in free fall, each in a world of its own."""
    garments = [replace(sheet(count), pinned=np.arange((count + 1) ** 2) < 3 * pinned) for count in cells]
    packed = pack(garments, torch.float64, worlds=range(len(cells)))
    crumpled = packed.rest_positions.clone()
    for garment in range(len(cells)):
        mine = packed.vertex_garment == garment
        generator = torch.Generator().manual_seed(cells[garment])
        crumpled[mine] += 1e-3 * torch.randn(crumpled[mine].shape, generator=generator, dtype=torch.float64)
    state = State(crumpled, torch.zeros_like(crumpled), 0)
    return TimeStep(packed, state, nobody(), 1 / 30, Environment(ground=None), crumpled + 0.002)


class JacobiPass:
    """Descends each vertex on its own, by `share` of what that would ask for."""

    further = 0

    def __init__(self, passes: int, share: float = 1.0) -> None:
        self.passes, self.share, self.potential = passes, share, IncrementalPotential()

    def correction(self, step: TimeStep, accelerations: Tensor) -> Tensor:
        x = integrate(step, accelerations).positions
        return self.share * JacobiDescent(step.garments, step.dt).at(self.potential.of(step), x)


def energies_after(step: TimeStep, method: StepMethod, last_move: Tensor | None = None) -> list[float]:
    potential, made = IncrementalPotential().of(step), predictions(step, method, last_move)
    return [float(potential.energies(each.state.positions).total) for each in made]


def test_whole_passes_are_what_the_network_predicts() -> None:
    at, network = sheets(10), JacobiPass(1)
    zero = torch.zeros_like(at.state.positions)
    *_, made = predictions(at, StepMethod(network=network))
    assert torch.equal(made.state.positions, integrate(at, network.correction(at, zero)).positions)
    assert made.last_move is None


@pytest.mark.parametrize("share", [0.2, 3.0, -1.0])
def test_the_length_of_a_pass_does_not_matter(share: float) -> None:
    at = sheets(10)
    start, one = energies_after(at, StepMethod(network=JacobiPass(1), search=SEARCH))
    _, other = energies_after(at, StepMethod(network=JacobiPass(1, share), search=SEARCH))
    assert one < start
    assert other == pytest.approx(one, abs=0.02 * (start - one))


def test_passes_are_joined_into_a_conjugate_gradient() -> None:
    at = sheets(10)
    lowest = energies_after(at, StepMethod(network=JacobiPass(100), search=SEARCH))[-1]
    whole = energies_after(at, StepMethod(network=JacobiPass(20, 0.5)))
    joined = energies_after(at, StepMethod(network=JacobiPass(20, 0.5), search=SEARCH))
    assert joined == sorted(joined, reverse=True), "no pass adds energy"
    assert joined[-1] - lowest < 0.1 * (whole[-1] - lowest)


def test_the_last_move_serves_the_next_step() -> None:
    at, method = sheets(10), StepMethod(network=JacobiPass(1), search=SEARCH)
    *_, made = predictions(at, method)
    assert energies_after(at, method, made.last_move)[-1] < energies_after(at, method)[-1]


def weight(step: TimeStep) -> float:
    """Weight [N] of the garments of a step."""
    return 9.81 * float(step.garments.vertex_masses.sum())


def freeing(*heights: float) -> PassSearch:
    """Takes passes whole, and says that they lower the energy of a step by some heights [m]."""
    each = iter(heights)
    return lambda step, _, correction, last: (correction, correction.new_tensor([next(each) * weight(step)]))


@pytest.mark.parametrize(
    ("heights", "taken"),
    [((1.0, 1e-4), 2), ((0.0, 1.0, 1e-4), 3), ((0.0, 1.0, 1.0, 1e-3), 4), ((1.0, 1.0, 1.0, 1.0, 1.0), 5)],
)
def test_further_passes_are_made_while_much_is_freed(heights: tuple[float, ...], taken: int) -> None:
    network = JacobiPass(2, 0.1)
    network.further = 3
    _, *passes = predictions(sheets(5), StepMethod(network=network, search=freeing(*heights)))
    assert len(passes) == taken


def test_a_pass_tells_by_how_much_it_lowered_the_energy() -> None:
    at = sheets(10)
    start, after = energies_after(at, method := StepMethod(network=JacobiPass(1), search=SEARCH))
    *_, made = predictions(at, method)
    assert float(made.decrease) == pytest.approx(start - after, rel=1e-3)


def test_whole_passes_tell_nothing_that_further_ones_could_be_asked_by() -> None:
    with pytest.raises(InputError, match="conjugate"):
        replace(CONJUGATE, conjugate=False, further_passes=2)


def test_who_names_a_number_of_passes_gets_it(tmp_path: Path) -> None:
    network = replace(CONJUGATE, further_passes=3)
    path = tmp_path / "a.safetensors"
    save_checkpoint(
        path, AccelerationModel(network.network()), network, TrainingRecord(1 / 30, (0.02, 0.03), (1, 9), 5)
    )
    for asked, passes, further in (({"refine": 0}, 2, 3), ({"refine": 0, "passes": 4}, 4, 0), ({}, 1, 0)):
        simulator = load_simulator(path, device="cpu", **asked)
        assert isinstance(simulator, NetworkSimulator)
        assert (simulator.passes, simulator.further) == (passes, further)


def test_every_world_has_lengths_of_its_own() -> None:
    both, method = sheets(10, 7), StepMethod(network=JacobiPass(2))
    *_, together = predictions(both, replace(method, search=SEARCH))
    for world, cells in enumerate((10, 7)):
        *_, alone = predictions(sheets(cells), replace(method, search=SEARCH))
        mine = both.garments.vertex_world == world
        torch.testing.assert_close(together.state.positions[mine], alone.state.positions, rtol=0, atol=1e-9)


def test_pinned_vertices_take_their_places() -> None:
    at = sheets(10, pinned=True)
    *_, after = predictions(at, StepMethod(network=JacobiPass(2), search=SEARCH))
    pinned = at.garments.pinned
    assert pinned.any()
    assert torch.equal(after.state.positions[pinned], at.pin_positions[pinned])


def test_cloth_on_a_body_gains_no_energy_by_a_pass() -> None:
    timeline = Timeline.of(ball_scene())
    rest, method = timeline.skinned(0), StepMethod(network=JacobiPass(2), search=SEARCH)
    made = Taken(State(rest, torch.zeros_like(rest), 0))
    for _ in range(4):
        at, last = timeline.step_from(made.state), made.last_move
        energies = energies_after(at, method, last)
        # Chosen with the body's tangent planes; twice-looked-up contacts may differ in the last digits.
        assert all(after <= before + 1e-6 for before, after in pairwise(energies))
        *_, made = predictions(at, method, last)


def test_what_is_not_finite_is_left_to_whoever_looks_for_it() -> None:
    at = sheets(10)
    correction = torch.full_like(at.state.positions, torch.nan)
    move, _ = SEARCH(at, torch.zeros_like(correction), correction, None)
    assert torch.isnan(move).all()


def test_lengths_carry_no_gradient_and_directions_do() -> None:
    timeline = Timeline.of(ball_scene())
    at = timeline.step_from(State(timeline.skinned(0), torch.zeros_like(timeline.skinned(0)), 0))
    torch.manual_seed(0)
    model = AccelerationModel(CONJUGATE.network())
    prepared = model.prepare(pack(at.garments.garments, torch.float32))
    network = NetworkPass(model, prepared, StepFeatures(prepared, SIX), 2, mode=nullcontext)
    *_, last = predictions(at, StepMethod(network=network, search=search_of(model.network, SIX)))
    energy = IncrementalPotential().of(at).energies(last.state.positions).total
    bias, weight = model.network.decoder.last.bias, model.network.decoder.last.weight
    gradient = torch.autograd.grad(energy, (bias, weight))
    assert any(float(part.abs().max()) > 0 for part in gradient)
    # At the best length the energy does not change with it, which scaling the decoder would do.
    along = sum(float((part * values.detach()).sum()) for part, values in zip(gradient, (bias, weight), strict=True))
    size = sum(
        float((part * values.detach()).abs().sum()) for part, values in zip(gradient, (bias, weight), strict=True)
    )
    assert abs(along) < 0.05 * size


def test_a_checkpoint_keeps_whether_its_passes_are_joined(tmp_path: Path) -> None:
    model = AccelerationModel(CONJUGATE.network())
    save_checkpoint(tmp_path / "a.safetensors", model, CONJUGATE, TrainingRecord(1 / 30, (0.02, 0.03), (1, 9), 5))
    read = load_checkpoint(tmp_path / "a.safetensors")
    assert read.configuration == CONJUGATE
    search = search_of(read.model.network, SIX)
    assert isinstance(search, partial)
    assert search.func is conjugate_move
    assert search_of(replace(CONJUGATE, conjugate=False).network(), SIX) is None
    assert np.isfinite(read.record.dt)
