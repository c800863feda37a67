"""Contact between cloth elements: its energies, and the law that no step of any kind leaves cloth crossing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from ball_scene import MATERIAL, Ball
from tests.collision.crossing_free_states import Surface, folded, stack
from tests.physics.shapes import DT, nobody, packed, sheet, time_step
from tests.readable_stiffness import times

from pb4u.collision.collision_free import SMALLEST_GAP
from pb4u.environment import Environment
from pb4u.errors import InputError
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.garment import Garment
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.implicit_steps import substep_count
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.cloth_contact import ClothContact, ClothFriction
from pb4u.physics.terms.energy_term import EnergyTerm
from pb4u.physics.terms.pair_stiffness import PairStiffness
from pb4u.physics.time_step import TimeStep, require_finite
from pb4u.scene.packed import PackedGarments
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.state import State
from pb4u.simulation.first_frame import AsPlaced, FirstFrame, OneLongStep, Settled
from pb4u.simulation.penetration_response import ContactResponse
from pb4u.simulation.refinement import ImplicitSteps, SafeguardedRefinement, SolverRefinement
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.step_start import BodyMotionWarmStart
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.simulation.timeline import Timeline

TERMS: tuple[EnergyTerm, ...] = (ClothContact(), ClothFriction())
PAIRED = IncrementalPotential().with_self_contact()


def garments_of(surface: Surface, worlds: tuple[int, ...] | None = None) -> PackedGarments:
    """The parts of a surface as garments."""
    starts = [int(np.flatnonzero(surface.part == part)[0]) for part in range(surface.part.max() + 1)]
    own = [surface.faces[surface.part[surface.faces[:, 0]] == part] - start for part, start in enumerate(starts)]
    parts = [surface.rest[surface.part == part] for part in range(len(starts))]
    made = [Garment("part", vertices, faces, MATERIAL) for vertices, faces in zip(parts, own, strict=True)]
    return packed(*made, worlds=worlds or surface.world)


def touching(seed: int = 0, gap: float = 1e-3) -> tuple[StepPotential, torch.Tensor]:
    """Three sheets that feel one another through a wobble, each sliding its own way; positions at the step's end."""
    surface = stack(3, gap, cells=4)
    garments = garments_of(surface)
    rng = np.random.default_rng(seed)
    noise = 0.15 * gap * rng.standard_normal((2, *surface.before.shape)).clip(-2.0, 2.0)
    slide = 4e-3 * rng.standard_normal((3, 3))[surface.part] * [1.0, 0.0, 1.0]
    state = State(torch.from_numpy(surface.before + noise[0]), torch.zeros(noise[0].shape, dtype=torch.float64), 0)
    return PAIRED.of(time_step(garments, state)), torch.from_numpy(surface.before + noise[1] + slide)


def fixed(step: StepPotential, x: torch.Tensor) -> StepPotential:
    """The potential with the pairs queried once, as a solver iteration sees it."""
    return step.with_cloth(step.potential.self_contact.pairs(step.step.garments, x, None, step.step.state.positions))


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_gradient_is_that_of_central_differences_and_of_autograd(term: EnergyTerm) -> None:
    step, x = touching()
    at = fixed(step, x)
    values, gradient = term.energies_and_gradient(at.step, at.contacts, x)
    assert float(values.min()) > 0.0, "every garment must feel another"
    direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    h = 1e-9
    difference = sum(s * term.energies(at.step, at.contacts, x + s * h * direction).sum() for s in (1, -1)) / (2 * h)
    assert float((gradient * direction).sum()) == pytest.approx(float(difference), rel=1e-5)
    variable = x.clone().requires_grad_(True)
    energies = term.energies(at.step, at.contacts, variable)
    torch.testing.assert_close(energies.detach(), values, rtol=1e-12, atol=1e-18)
    (expected,) = torch.autograd.grad(energies.sum(), variable)
    torch.testing.assert_close(gradient, expected, rtol=1e-10, atol=1e-10 * float(expected.abs().max()))


def test_what_cloth_does_to_cloth_sums_to_nothing() -> None:
    step, x = touching()
    at = fixed(step, x)
    for term in TERMS:
        gradient = term.energies_and_gradient(at.step, at.contacts, x)[1]
        size = float(gradient.abs().sum())
        assert size > 0.0
        assert float(gradient.sum(0).abs().max()) < 1e-12 * size


@pytest.mark.parametrize("degrees", [0.0, 0.3, 1.0, 1.7])
def test_nearly_parallel_edges_push_softly_and_by_their_gradient(degrees: float) -> None:
    """Two edges alone, one over the other: no force where they are parallel, and one without jumps beside it."""
    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, -0.8, 0.0]])
    turn = np.radians(degrees)
    over = np.full((3, 3), [0.5, 0.8, 0.0])
    over[0] = [0.5 - 0.4 * np.cos(turn), 1e-3, -0.4 * np.sin(turn)]
    over[1] = [0.5 + 0.4 * np.cos(turn), 1e-3, 0.4 * np.sin(turn)]
    face = np.array([[0, 1, 2]])
    garments = packed(Garment("low", corner, face, MATERIAL), Garment("high", over, face, MATERIAL), worlds=(0, 0))
    x = garments.rest_positions
    at = fixed(PAIRED.of(time_step(garments)), x)
    cloth = at.contacts.cloth
    assert cloth is not None
    both = (np.sort(cloth.pairs.corners, axis=1) == [0, 1, 3, 4]).all(axis=1)
    assert both.sum() == 1
    at = at.with_cloth(replace(cloth, areas=np.where(both, cloth.areas, 0.0)))
    values, gradient = TERMS[0].energies_and_gradient(at.step, at.contacts, x)
    assert (float(values.sum()) > 1e-9) is (degrees > 0.0)
    for seed in range(3):
        direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        h = 1e-8
        plus, minus = (TERMS[0].energies(at.step, at.contacts, x + s * h * direction).sum() for s in (1, -1))
        slope = float((gradient * direction).sum())
        assert slope == pytest.approx(float(plus - minus) / (2 * h), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_a_garment_owns_half_of_what_it_shares(term: EnergyTerm) -> None:
    step, x = touching(gap=1.6e-3)
    at = fixed(step, x)
    variable = x.clone().requires_grad_(True)
    energies = term.energies(at.step, at.contacts, variable)
    whole = term.energies_and_gradient(at.step, at.contacts, x)[1]
    parts = [torch.autograd.grad(value, variable, retain_graph=True)[0] for value in energies]
    torch.testing.assert_close(sum(parts), whole, rtol=1e-9, atol=1e-10 * float(whole.abs().max()))
    # The lowest sheet shares all of its pairs with the middle one, half for each: alone they hold the same.
    garments = at.step.garments
    lower = garments_of(stack(2, 1.6e-3, cells=4))
    rows = garments.vertex_offsets[2]
    alone = PAIRED.of(time_step(lower, State(at.step.state.positions[:rows], torch.zeros(rows, 3).double(), 0)))
    alone = fixed(alone, x[:rows])
    first, second = term.energies(alone.step, alone.contacts, x[:rows]).tolist()
    assert first == pytest.approx(second, rel=1e-12)
    assert float(energies[0].detach()) == pytest.approx(first, rel=1e-12)
    assert float(energies[1].detach()) > first


def rows_of(term: EnergyTerm, at: StepPotential, x: torch.Tensor) -> PairStiffness:
    stiffness = term.pair_stiffness(at.step, at.contacts, x)
    assert stiffness is not None
    assert len(stiffness)
    return stiffness


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_pair_stiffness_is_one_matrix_however_it_is_asked(term: EnergyTerm) -> None:
    step, x = touching(1)
    at = fixed(step, x)
    stiffness = rows_of(term, at, x)
    root = stiffness.root(len(x)).toarray()
    whole = root.T @ root
    assert np.linalg.eigvalsh(whole).min() > -1e-12 * whole.max()
    vector = np.random.default_rng(2).normal(size=(len(x), 3))
    product = times(stiffness, vector)
    np.testing.assert_allclose(product.reshape(-1), whole @ vector.reshape(-1), atol=1e-11 * np.abs(product).max())
    blocks = np.zeros((len(x), 3, 3))
    stiffness.add_diagonal(blocks)
    own = whole.reshape(len(x), 3, len(x), 3)[np.arange(len(x)), :, np.arange(len(x))]
    np.testing.assert_allclose(blocks, own, atol=1e-12 * own.max())
    free = np.random.default_rng(3).random(len(x)) < 0.5
    held = np.repeat(free, 3)
    root = PairStiffness.summed([stiffness], free).root(len(x)).toarray()
    np.testing.assert_allclose(root.T @ root, whole * held * held[:, None], atol=1e-12 * whole.max())


def test_pair_stiffness_is_the_derivative_of_the_force_along_the_normal() -> None:
    """What the turning of the normal adds is left out, so sheets that stay parallel are moved."""
    surface = stack(2, 1e-3, cells=4)
    garments = garments_of(surface)
    x = torch.from_numpy(surface.before)
    at = fixed(PAIRED.of(time_step(garments, State(x, torch.zeros_like(x), 0))), x)
    lift = torch.zeros_like(x)
    lift[surface.part == 1, 1] = 1.0
    h = 1e-8
    plus, minus = (TERMS[0].energies_and_gradient(at.step, at.contacts, x + s * h * lift)[1] for s in (1, -1))
    product = times(rows_of(TERMS[0], at, x), lift.numpy())
    assert np.abs(product).max() > 1.0
    expected = ((plus - minus) / (2 * h)).numpy()
    np.testing.assert_allclose(product, expected, atol=1e-5 * np.abs(expected).max())


def test_friction_stiffness_is_the_derivative_of_its_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pb4u.physics.terms.cloth_contact.SOFTENING", 1.0)
    step, x = touching(4)
    at = fixed(step, x)
    # Slips of the smoothing's length, where the law bends.
    x = step.step.state.positions + 1e-3 * (x - step.step.state.positions)
    direction = torch.randn(x.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    h = 1e-9
    plus, minus = (TERMS[1].energies_and_gradient(at.step, at.contacts, x + s * h * direction)[1] for s in (1, -1))
    product = times(rows_of(TERMS[1], at, x), direction.numpy())
    expected = ((plus - minus) / (2 * h)).numpy()
    np.testing.assert_allclose(product, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("height", [1.5e-4, 6e-4, 1.2e-3, 2.5e-3])
def test_a_vertex_over_a_face(height: float) -> None:
    """The barrier in closed form: one corner of a face over the middle of another, far larger, one."""
    large = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [3.0, 0.0, 0.0]])
    small = np.array([[0.9, height, 0.9], [0.9, height + 0.1, 0.95], [0.95, height + 0.1, 0.9]])
    face = np.array([[0, 1, 2]])
    garments = packed(Garment("large", large, face, MATERIAL), Garment("small", small, face, MATERIAL), worlds=(0, 0))
    x = garments.rest_positions
    step = PAIRED.of(time_step(garments))
    areas = garments.vertex_areas
    area = 0.25 * float(torch.stack([areas[3], areas[0], areas[1], areas[2]]).mean())
    room = 2e-3 - SMALLEST_GAP
    s = (height - SMALLEST_GAP) / room
    expected = -1e3 * area * room * (1.0 - s) ** 2 * np.log(s) if s < 1.0 else 0.0
    values = step.energies(x).terms["self_contact"].tolist()
    assert values == pytest.approx([0.5 * expected] * 2, rel=1e-9)


def test_worlds_do_not_feel_each_other() -> None:
    surface = stack(2, 1e-3, cells=4)
    x = torch.from_numpy(surface.before)
    for worlds, felt in (((0, 0), True), ((0, 1), False)):
        garments = garments_of(surface, worlds)
        energies = PAIRED.of(time_step(garments, State(x, torch.zeros_like(x), 0))).energies(x)
        assert bool((energies.terms["self_contact"] > 0).all()) is felt
        passed = x + torch.from_numpy((surface.part == 0)[:, None] * np.array([0.0, 0.02, 0.0]))
        free, _ = PAIRED.self_contact.collision_free_move(garments, x, passed)
        assert (free is passed) is not felt


def test_what_is_held_gives_way_to_nothing() -> None:
    surface = stack(2, 1e-3, cells=4)
    x, garments = torch.from_numpy(surface.before), garments_of(surface, (0, 0))
    upper = torch.from_numpy(surface.part == 1)
    wanted = x + ~upper[:, None] * torch.tensor([0.0, 0.02, 0.0], dtype=x.dtype)
    pushed, _ = PAIRED.self_contact.collision_free_move(garments, x, wanted)
    held, _ = PAIRED.self_contact.collision_free_move(garments, x, wanted, held=upper)
    assert bool((pushed[upper, 1] > x[upper, 1] + 1e-3).all())
    assert torch.equal(held[upper], x[upper])
    assert surface.crossing(held.numpy()) == 0
    assert float(held[~upper, 1].max()) < 0.01


def slid(coefficient: float, degrees: float, steps: int = 9) -> tuple[float, float, int]:
    """Way [m] and speed [m/s] of a sheet down a pinned one that is tilted after it has come to rest on it.

    And the number of steps that the solver left unsolved. The edges of both run alike, where distances have kinks.
    """
    lower, upper = flat(12, 3, 0.9, 0.24), flat(3, 3, 0.15, 0.15)
    # Of two cloths, the smoother one decides.
    upper = upper.with_material(replace(upper.material, friction=coefficient))
    lower = lower.with_material(replace(lower.material, friction=0.8))
    garments = packed(lower.with_pins(np.ones(len(lower.vertices), dtype=bool)), upper, worlds=(0, 0))
    start = garments.rest_positions + torch.tensor([[0.05, 1.7e-3, 0.03]]) * ~garments.pinned[:, None]
    solver, state, unsolved = Solver(), State(start, torch.zeros_like(start), 0), 0
    settling, free = 5, ~garments.pinned
    for k in range(settling + steps):
        angle = np.radians(degrees) if k >= settling else 0.0
        down = Environment((9.81 * np.sin(angle), -9.81 * np.cos(angle), 0.0), ground=None)
        if k == settling:
            state = State(state.positions, torch.zeros_like(start), state.frame)
            settled = state.positions
        step = TimeStep(garments, state, nobody(), DT, down, start)
        solution = solver.minimise(PAIRED.of(step), step.with_pins(state.positions + DT * state.velocities))
        state, unsolved = step.reached(solution.positions), unsolved + (not solution.converged)
    return float((state.positions - settled)[free, 0].mean()), float(state.velocities[free, 0].mean()), unsolved


def flat(columns: int, rows: int, width: float, depth: float) -> Garment:
    """A lying sheet, facing up."""
    made = sheet(columns, rows, width, depth)
    return replace(made, vertices=made.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [0.0, 0.0, depth])


@pytest.mark.parametrize("coefficient", [0.2, 0.5])
def test_a_sheet_slides_where_the_slope_is_steeper_than_its_friction(coefficient: float) -> None:
    critical, seconds = np.degrees(np.arctan(coefficient)), 9 * DT
    way, speed, unsolved = slid(coefficient, critical - 4.0)
    # Friction is softened below a millimetre a second: what holds creeps at about that.
    assert 0.0 < way < 1.5e-3
    assert speed < 5e-3
    assert unsolved == 0
    way, speed, unsolved = slid(coefficient, critical + 4.0)
    angle = np.radians(critical + 4.0)
    expected = 9.81 * (np.sin(angle) - coefficient * np.cos(angle)) * seconds
    assert speed == pytest.approx(expected, rel=0.15)
    assert way > 0.4 * expected * seconds
    assert unsolved == 0
    assert expected < 0.35 * 9.81 * np.sin(angle) * seconds


def test_a_sheet_without_friction_slides_as_on_ice() -> None:
    way, speed, unsolved = slid(0.0, 20.0)
    assert speed == pytest.approx(9.81 * np.sin(np.radians(20.0)) * 9 * DT, rel=2e-3)
    assert way > 0.1
    assert unsolved == 0


class Careless:
    """A network that sends cloth anywhere: corrections of the size of a limb, others every frame."""

    passes, further = 1, 0

    def __init__(self, size: float = 0.05) -> None:
        self._size = size

    def correction(self, step: TimeStep, accelerations: torch.Tensor) -> torch.Tensor:
        generator = torch.Generator().manual_seed(step.state.frame)
        return self._size * torch.randn(accelerations.shape, generator=generator, dtype=accelerations.dtype)


class OneMethod(StepwiseSimulator):
    """A simulator of given parts."""

    name = "one method"

    def __init__(self, first_frame: FirstFrame, method: StepMethod) -> None:
        self.first_frame, self._method = first_frame, method

    def timeline(self, *scenes: Scene) -> Timeline:
        return Timeline.of_worlds(scenes)

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        return self._method


def dropped(surface: Surface, frames: int, speed: float, pins: bool = False) -> tuple[Scene, Surface]:
    """The parts of a surface over a ball that moves sideways; its first part hangs by a corner where `pins` says so."""
    body = Ball(frames, speed=speed)
    worn = []
    centre = surface.before.mean(axis=0)
    for part, garment in enumerate(garments_of(surface).garments):
        rows = surface.part == part
        start = surface.before[rows] - centre + [0.0, 0.72, 0.0]
        if pins and part == 0:
            garment = garment.with_pins(np.arange(rows.sum()) < 3)
        # The pins are led into the middle of the rest and out again.
        path = np.sin(np.linspace(0.0, np.pi, frames))[:, None, None] * np.array([0.06, 0.05, -0.08])
        worn.append(DressedGarment(garment, PrescribedPlacement(start + path * pins)))
    placed = replace(surface, before=surface.before - centre + [0.0, 0.72, 0.0])
    return Scene(tuple(worn), (body,), frames), placed


SCENES = {
    "folded": (folded(4, 2e-3, cells=3), 0.3, False),
    "stack": (stack(3, 1e-3, cells=4), 0.3, False),
    "body that leaps": (stack(2, 1e-3, cells=4), 12.0, False),
    "pins": (stack(2, 1.5e-3, cells=4), 0.0, True),
}


Parts = tuple[BodyMotionWarmStart | None, Any, SolverRefinement | None, ContactResponse | None, FirstFrame]


def methods(potential: IncrementalPotential) -> dict[str, Parts]:
    """Methods of every kind with the contact of `potential`."""
    return {
        "solver": (None, None, ImplicitSteps(potential), ContactResponse(), AsPlaced()),
        "solver, two iterations": (
            None, None, ImplicitSteps(potential, 2), None, AsPlaced(),
        ),
        "network alone": (
            BodyMotionWarmStart(potential, (0.5, 1.0)), Careless(), None, ContactResponse(),
            OneLongStep(),
        ),
        "network and one": (
            BodyMotionWarmStart(potential, (0.5, 1.0)), Careless(), SolverRefinement(potential, 1), ContactResponse(),
            Settled(),
        ),
        "network and five": (
            BodyMotionWarmStart(potential, (0.5, 1.0)), Careless(),
            SafeguardedRefinement(potential, 5), ContactResponse(), AsPlaced(),
        ),
        "quick solver": (
            BodyMotionWarmStart(potential, (0.5, 1.0)), None,
            SafeguardedRefinement(potential, 5), ContactResponse(), AsPlaced(),
        ),
    }  # fmt: skip


METHODS = methods(PAIRED)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", METHODS)
def test_no_step_of_any_kind_leaves_cloth_crossing(scene: str, method: str) -> None:
    surface, speed, pins = SCENES[scene]
    frames = 4
    placed, states = dropped(surface, frames, speed, pins)
    start, network, refinement, contact, first = METHODS[method]
    taken = StepMethod(start, network, refinement, contact, PAIRED)
    assert states.crossing(states.before) == 0
    record = RunRecord()
    timeline = Timeline.of(placed)
    simulator = OneMethod(first, taken)
    state, seen = require_finite(first.start(timeline, taken).state), 0
    for written in simulator.rollout(placed, record):
        for x in (state.positions.numpy(), written.positions.numpy()):
            assert states.crossing(x) == 0
            distances, before = states.all_pairs.nearest(x)[0], states.all_pairs.nearest(states.before)[0]
            kept = np.minimum(5e-5, 0.5 * np.minimum(before, 0.25 * states.all_pairs.rest_distance))
            assert (distances >= kept).all()
        state, seen = written, seen + 1
    assert record.failed_at is None
    assert seen == frames
    moved = np.abs(state.positions.numpy() - states.before).max()
    assert moved > 5e-3, "a law that holds because nothing moves says nothing"


def crossed(surface: Surface) -> Scene:
    """Two sheets over a ball, the middle of the upper one dented through the lower one."""
    scene = dropped(surface, 3, 0.0)[0]
    lower, upper = (worn.garment for worn in scene.garments)
    starts = [worn.placement.frames for worn in scene.garments if isinstance(worn.placement, PrescribedPlacement)]
    away = np.linalg.norm(starts[1][0] - starts[1][0].mean(axis=0), axis=1)
    dented = starts[1] - (away < 0.3 * away.max())[:, None] * np.array([0.0, 0.01, 0.0])
    worn = DressedGarment(lower, PrescribedPlacement(starts[0])), DressedGarment(upper, PrescribedPlacement(dented))
    return replace(scene, garments=worn)


@pytest.mark.parametrize("method", METHODS)
def test_cloth_that_starts_crossing_is_free_from_its_first_frame(method: str) -> None:
    surface = stack(2, 1e-3, cells=4)
    scene = crossed(surface)
    start, network, refinement, contact, first = METHODS[method]
    simulator = OneMethod(first, StepMethod(start, network, refinement, contact, PAIRED))
    assert surface.crossing(Timeline.of(scene).skinned_state(0).positions.numpy()) > 3
    states = list(simulator.rollout(scene, RunRecord()))
    assert [surface.crossing(state.positions.numpy()) for state in states] == [0, 0, 0]


@pytest.mark.parametrize("method", METHODS)
def test_cloth_that_cannot_be_parted_is_refused_before_anything_moves(method: str) -> None:
    scene = crossed(stack(2, 1e-3, cells=4))
    held = [
        replace(worn, garment=worn.garment.with_pins(np.ones(len(worn.garment.vertices), dtype=bool)))
        for worn in scene.garments
    ]
    start, network, refinement, contact, first = METHODS[method]
    simulator = OneMethod(first, StepMethod(start, network, refinement, contact, PAIRED))
    with pytest.raises(InputError, match=r"part and part \(2\) cross in \d+ pairs"):
        next(simulator.rollout(replace(scene, garments=tuple(held)), RunRecord()))


def test_the_scene_that_leaps_is_cut_into_parts() -> None:
    """Else the law above would not have seen what lies between the parts of a step."""
    surface, speed, _ = SCENES["body that leaps"]
    timeline = Timeline.of(dropped(surface, 4, speed)[0])
    assert substep_count(timeline.step_from(timeline.skinned_state(0))) > 1


def test_cloth_that_touches_none_has_the_energies_that_it_had_without() -> None:
    """A sheet draped over a ball: its contact with itself is looked for in every step and never found."""
    scene, _ = dropped(stack(1, 0.0, cells=6), 6, 0.3)
    states = []
    for potential in (IncrementalPotential(), PAIRED):
        method = StepMethod(refinement=ImplicitSteps(potential), potential=potential)
        states.append(list(OneMethod(AsPlaced(), method).rollout(scene, RunRecord()))[-1].positions)
    garments = Timeline.of(scene).garments
    energies = [IncrementalPotential().of(time_step(garments, State(x, torch.zeros_like(x), 0))) for x in states]
    without, kept = (step.energies(x).floats() for step, x in zip(energies, states, strict=True))
    for name in ("stretch", "bending"):
        assert without[name] > 1e-6
        assert kept[name] == pytest.approx(without[name], rel=0.05)
    torch.testing.assert_close(states[1], states[0], atol=1e-4, rtol=0.0)
