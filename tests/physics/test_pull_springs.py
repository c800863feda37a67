"""Springs of a hand: their energy, force and stiffness, and the way of the hand over the parts of a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.physics.shapes import packed, sheet, time_step
from tests.readable_stiffness import dense

from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.energy_term import CompiledTerm
from pb4u.physics.terms.pull_springs import PullSprings
from pb4u.physics.terms.stiffness_matrix import StiffnessPattern
from pb4u.physics.time_step import Pull, TimeStep

HELD, STIFFNESS = [7, 2], 30.0
PLACES = torch.tensor([[0.1, 0.7, 0.0], [0.0, 0.8, -0.1]], dtype=torch.float64)


def pulled() -> tuple[TimeStep, StepPotential]:
    garments = packed(sheet(3, 3, 0.3, 0.3))
    only = IncrementalPotential((PullSprings(),))
    step = replace(time_step(garments), pull=Pull(torch.tensor(HELD), PLACES, STIFFNESS))
    return step, only.of(step)


def test_energy_force_and_stiffness_are_those_of_springs() -> None:
    step, potential = pulled()
    x = step.state.positions
    away = x[HELD] - PLACES
    (term,) = potential.potential.terms
    assert isinstance(term, CompiledTerm)
    for each in (term, PullSprings()):
        energies, gradient = each.energies_and_gradient(step, potential.contacts, x)
        assert float(energies) == pytest.approx(0.5 * STIFFNESS * float(away.square().sum()))
        expected = torch.zeros_like(x)
        expected[HELD] = STIFFNESS * away
        torch.testing.assert_close(gradient, expected)
    matrix = dense(potential.stiffness(x, StiffnessPattern(step.garments, potential.elements())).matrix())
    diagonal = np.zeros(len(x))
    diagonal[HELD] = STIFFNESS
    assert np.allclose(matrix, np.diag(diagonal.repeat(3)))


def test_a_step_without_a_hand_has_no_such_term() -> None:
    step, _ = pulled()
    assert IncrementalPotential((PullSprings(),)).of(replace(step, pull=None)).potential.terms == ()


def test_the_hand_goes_evenly_over_the_parts_of_a_step() -> None:
    step, _ = pulled()
    start = step.state.positions[HELD]
    for k in range(4):
        part = step.part(k, 4, step.state).pull
        assert part is not None
        torch.testing.assert_close(part.places, start + (PLACES - start) * (k + 1) / 4)
