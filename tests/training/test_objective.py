"""What a garment's loss counts beside those of others."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.training.ball_data import TINY, ball_data
from tests.training.listening import Listener, made

from pb4u.errors import InputError
from pb4u.physics.incremental_potential import Energies
from pb4u.physics.terms.collision import REFERENCE_AREA
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments
from pb4u.training.objective import (
    JouleWeight,
    ProgressWeight,
    RelativeWeight,
    comparable_total,
    loss_weight,
    mean_energies,
    step_energies,
)
from pb4u.training.wardrobe import Wardrobe

pytestmark = pytest.mark.usefixtures("one_thread")


def two_garments() -> PackedGarments:
    wardrobe = Wardrobe(ball_data(), "cpu")
    material = wardrobe.data.outfits[0].garment.material
    return wardrobe.packed([0, 0], [material, replace(material, density=2 * material.density)])


def energies(stretch: tuple[float, float], gravity: tuple[float, float] = (-3.0, 5.0)) -> Energies:
    return Energies({"stretch": torch.tensor(stretch), "gravity": torch.tensor(gravity)})


def test_joules_count_alike() -> None:
    assert torch.equal(JouleWeight().of(energies((0.1, 9.0)), two_garments(), None), torch.ones(2))


def test_relative_weights_are_of_the_logarithm_of_the_energy_without_gravity() -> None:
    garments = two_garments()
    weigh = RelativeWeight(lift=0.0)
    assert weigh.of(energies((0.1, 50.0)), garments, None).tolist() == pytest.approx([10.0, 0.02])
    stretch = torch.tensor([0.3, 2.0], requires_grad=True)
    of = Energies({"stretch": stretch, "gravity": torch.tensor([1.0, -4.0])})
    (weighed,) = torch.autograd.grad((weigh.of(of, garments, None) * of.per_garment).sum(), stretch)
    (logarithms,) = torch.autograd.grad(stretch.log().sum(), stretch)
    torch.testing.assert_close(weighed, logarithms)


def test_cloth_at_rest_counts_no_more_than_cloth_that_hangs() -> None:
    garments = two_garments()
    at_rest = RelativeWeight(lift=2e-3).of(energies((0.0, 0.0)), garments, None)
    mass = float(garments.vertex_masses[garments.vertex_garment == 0].sum())
    assert float(at_rest[0]) == pytest.approx(1.0 / (9.81 * mass * 2e-3), rel=1e-3)
    assert float(at_rest[1]) == pytest.approx(0.5 * float(at_rest[0]), rel=1e-5)


def test_progress_weights_are_of_the_logarithm_of_what_a_pass_freed() -> None:
    garments = two_garments()
    freed = torch.tensor([0.25, 4.0])[garments.garment_world]
    weights = ProgressWeight(lift=0.0).of(energies((9.0, 9.0)), garments, freed)
    assert weights.tolist() == pytest.approx((1.0 / freed[garments.garment_world]).tolist())
    none_freed = ProgressWeight(lift=1e-4).of(energies((9.0, 9.0)), garments, torch.tensor([0.0, -1.0]))
    assert bool(torch.isfinite(none_freed).all())
    with pytest.raises(InputError, match="conjugate"):
        ProgressWeight().of(energies((9.0, 9.0)), garments, None)


def test_what_is_inside_the_skin_costs_more_and_what_rests_on_it_does_not() -> None:
    trainer = made(TINY, 1)
    course = trainer.begin(0, 2)
    step, garments = course.next_step(), course.window.timeline.garments
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
    trainers = [made(replace(TINY, loss_weight=name, seed=3), 1, None, Listener()) for name in ("joule", "relative")]
    gradients = []
    for trainer in trainers:
        trainer.gather_statistics()
        trainer.train_round()
        gradients.append(trainer.model.network.decoder.last.bias.grad)
    assert not torch.allclose(*gradients)
    # One garment, one step: its direction is the same before it is clipped.
    torch.testing.assert_close(*(gradient / gradient.norm() for gradient in gradients), rtol=1e-3, atol=1e-5)


def test_an_unknown_weight_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="joule"):
        loss_weight("jowl")
    with pytest.raises(InputError, match="relative"):
        replace(TINY, loss_weight="jowl")
