"""A step of some vertices of a garment, beside the whole of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tests.physics.shapes import EVALUATION, packed, sheet, time_step, tube

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.solver.newton_solver import Solver
from pb4u.physics.time_step import TimeStep
from pb4u.scene.state import State

POTENTIAL = IncrementalPotential().with_self_contact()


def crumpled() -> tuple[TimeStep, State, torch.Tensor]:
    """A step of two tubes, one within the other, where it may end, and some vertices of the outer one."""
    garments = packed(tube(12, 6, 0.15, 0.3, EVALUATION), tube(12, 6, 0.148, 0.3, EVALUATION), worlds=(0, 0))
    rest = garments.rest_positions
    step = time_step(garments, State(rest, torch.zeros_like(rest), 0))
    noise = torch.randn(rest.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    reached = step.reached(rest + 2e-4 * noise)
    around = (rest[:, 1] > rest[:, 1].mean()) & (garments.vertex_garment == 0)
    assert 0 < int(around.sum()) < len(around)
    return step, reached, around


def test_a_part_has_the_slopes_of_the_whole_where_it_moves() -> None:
    step, reached, around = crumpled()
    part = step.around(around)
    assert len(part.garments.faces) < len(step.garments.faces)
    x = reached.positions
    moved = x + 1e-4 * around[:, None] * torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    of_part, of_whole = (POTENTIAL.of(each).reached(x, moved)[0] for each in (part, step))
    for at in (x, moved):
        slopes = [potential.energies_and_gradient(at)[1][around] for potential in (of_part, of_whole)]
        torch.testing.assert_close(*slopes, rtol=1e-12, atol=1e-14)
    fallen = [float(p.energies(moved).total - p.energies(x).total) for p in (of_part, of_whole)]
    torch.testing.assert_close(fallen[0], fallen[1], rtol=1e-9, atol=1e-15)
    # Cloth that the other garment presses is among it.
    touching = of_part.contacts.cloth
    assert touching is not None
    assert (touching.pairs.corners[:, 0] < step.garments.vertex_offsets[1]).any()
    assert (touching.pairs.corners >= step.garments.vertex_offsets[1]).any()
    assert around[torch.from_numpy(touching.pairs.corners)].any(1).all()


def test_a_solve_of_a_part_moves_nothing_else_and_lowers_the_energy_of_all() -> None:
    step, reached, around = crumpled()
    part, x = step.around(around), reached.positions
    solved = Solver().minimise(POTENTIAL.of(part), x, begun=x)
    assert solved.converged
    assert torch.equal(solved.positions[~around], x[~around])
    whole = POTENTIAL.of(step)
    assert float(whole.energies(solved.positions).total) < float(whole.energies(x).total)
    gradient = whole.reached(x, solved.positions)[0].energies_and_gradient(solved.positions)[1]
    unbalanced = gradient / step.garments.vertex_masses[:, None]
    assert float(unbalanced[around].norm(dim=1).max()) < 1e-2 * float(unbalanced[~around].norm(dim=1).max())


def test_a_part_of_a_part_is_one_of_the_whole() -> None:
    garments = packed(sheet(4, 4))
    upper = garments.rest_positions[:, 1] > garments.rest_positions[:, 1].median()
    part = garments.part(upper)
    corner = upper & (garments.rest_positions[:, 0] > 0.0)
    again = part.part(corner)
    assert again.whole is garments
    assert part.surface_tree is garments.surface_tree
    assert torch.equal(again.pinned, ~corner)


def test_pins_on_springs_are_pulled_to_their_own_places_in_a_part() -> None:
    step, reached, around = crumpled()
    pins = reached.positions + 0.1
    assert replace(step, pin_positions=pins).around(around).pin_positions is pins


def test_a_part_in_which_nothing_can_move_stays() -> None:
    garments = packed(sheet(4, 4).with_pins(np.ones(25, dtype=bool)))
    step = time_step(garments)
    reached = step.reached(garments.rest_positions)
    part = step.around(torch.ones(garments.vertex_count, dtype=torch.bool))
    solved = Solver().minimise(IncrementalPotential().of(part), reached.positions, begun=reached.positions)
    assert torch.equal(solved.positions, reached.positions)
