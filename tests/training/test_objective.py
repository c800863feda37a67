"""What a garment's loss counts beside those of others."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.training.ball_data import TINY, ball_data
from tests.training.listening import Listener, made

from pb4u.environment import STANDARD_GRAVITY
from pb4u.errors import InputError
from pb4u.physics.step_potential import Energies
from pb4u.physics.terms.collision import REFERENCE_AREA
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments
from pb4u.training.objective import (
    comparable_total,
    mean_energies,
    progress_weights,
    step_energies,
)
from pb4u.training.wardrobe import Wardrobe

pytestmark = pytest.mark.usefixtures("one_thread")


def two_garments() -> PackedGarments:
    wardrobe = Wardrobe(ball_data(), "cpu")
    material = wardrobe.data.outfits[0].garment.material
    return wardrobe.packed([0, 0], [material, replace(material, density=2 * material.density)])


def test_progress_weights_are_of_the_logarithm_of_what_a_pass_freed() -> None:
    garments = two_garments()
    freed = torch.tensor([0.25, 4.0])[garments.garment_world]
    weights = progress_weights(garments, freed)
    lift = 1e-4 * STANDARD_GRAVITY * garments.garment_masses
    assert weights.tolist() == pytest.approx((1.0 / (freed[garments.garment_world] + lift)).tolist())
    none_freed = progress_weights(garments, torch.tensor([0.0, -1.0]))
    assert bool(torch.isfinite(none_freed).all())
    with pytest.raises(InputError, match="conjugate"):
        progress_weights(garments, None)


def test_what_is_inside_the_skin_costs_more_and_what_rests_on_it_does_not() -> None:
    trainer = made(TINY, 1)
    rollout = trainer.begin(0, 2)
    step, garments = rollout.next_step(), rollout.window.timeline.garments
    planes = step.contacts.now
    assert planes is not None

    def terms(distance: float) -> tuple[dict[str, float], dict[str, float]]:
        at = planes.points + distance * planes.normals
        with_it, without = step_energies(step, at, 5e3, 1e5), step_energies(step, at, 5e3)
        return with_it.floats(), without.floats()

    resting, plain = terms(1e-3)
    assert resting.pop("inside") == 0.0 < resting["collision"]
    assert resting == pytest.approx(plain)
    inside, plain = terms(-4e-3)
    depth, areas = 4e-3, float(garments.vertex_areas[planes.touchable].sum())
    assert inside["inside"] == pytest.approx(1e5 * areas / REFERENCE_AREA * depth**3, rel=0.05)
    assert {name: inside[name] for name in plain if name != "total"} == pytest.approx(
        {name: value for name, value in plain.items() if name != "total"}
    )
    means = mean_energies(step_energies(step, planes.points - 4e-3 * planes.normals, 2e4, 1e5))
    assert comparable_total({name: float(value) for name, value in means.items()}, 2e4) == pytest.approx(
        plain["total"], rel=1e-4
    )


def test_a_training_adds_what_is_inside_where_its_configuration_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def noted(step: TimeStep, positions: torch.Tensor, weight: float, inside: float) -> Energies:
        asked.append(inside)
        return step_energies(step, positions, weight, inside)

    monkeypatch.setattr("pb4u.training.trainer.step_energies", noted)
    made(replace(TINY, inside_weight=2e4), 1, None, Listener()).train_round()
    assert set(asked) == {2e4}


def test_a_training_takes_the_weight_of_its_configuration() -> None:
    network = replace(TINY.network, conjugate=True)
    trainers = [
        made(replace(TINY, network=network, loss_weight=name, seed=3), 1, None, Listener())
        for name in ("joule", "progress")
    ]
    gradients = []
    for trainer in trainers:
        trainer.gather_statistics()
        trainer.train_round()
        gradients.append(trainer.model.network.decoder.last.bias.grad)
    assert not torch.allclose(*gradients)
    # One garment, one step: its direction is the same before it is clipped.
    torch.testing.assert_close(*(gradient / gradient.norm() for gradient in gradients), rtol=1e-3, atol=1e-5)


def test_an_unknown_weight_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="joule, progress"):
        replace(TINY, loss_weight="jowl")
