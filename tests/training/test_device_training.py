"""A step of training on an accelerator without one: the processor neither reads nor copies, and learns the same."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
import torch
from tests.training.ball_data import TINY, ball_data
from tests.training.listening import ALONE, Listener

from pb4u.collision.capacities import Capacities
from pb4u.errors import InputError
from pb4u.paper.network_presets import pb4u_small_conjugate
from pb4u.physics.contact.contact_set import ContactPlanes
from pb4u.physics.step_potential import Energies
from pb4u.physics.time_step import TimeStep
from pb4u.training.budget import Budget
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.distribution import Workers
from pb4u.training.objective import step_energies
from pb4u.training.trainer import Trainer

CONJUGATE = replace(
    TINY,
    network=replace(pb4u_small_conjugate, width=8, blocks=1, passes=1, further_passes=1),
    statistics_windows=1,
    batch=2,
    loss_weight="progress",
)


def trainer_of(
    configuration: TrainingConfiguration = CONJUGATE, on_card: bool = True, steps: int = 40, workers: Workers = ALONE
) -> Trainer:
    trainer = Trainer(configuration, Budget(steps), ball_data((4, 5)), workers, None, Listener())
    if on_card:
        trainer.capacities = trainer.loader.wardrobe.capacities = Capacities()
    return trainer


def weights(trainer: Trainer) -> torch.Tensor:
    return torch.cat([parameter.detach().reshape(-1) for parameter in trainer.model.parameters()])


@pytest.fixture
def in_tensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """No compiled kernels, as on an accelerator."""
    for user in ("interaction_block", "mlp", "propagation"):
        monkeypatch.setattr(f"pb4u.network.{user}.are_compiled", lambda *given: False)
    monkeypatch.setattr(TimeStep, "is_on_a_processor", False)


def test_a_step_of_training_neither_reads_back_nor_copies(in_tensors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forward, backward and optimiser on tensors without values, on which reading one back is an error."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    accelerator = import_module("accelerator")
    trainer = trainer_of()
    trainer.gather_statistics()
    rollout = trainer.begin(1, 4)
    assert trainer.advance(rollout)
    trainer.look_at_outcomes()
    moved, window = accelerator.faked((trainer, rollout), torch.device("meta"))
    for _ in range(2):
        # Constants are made by the first.
        with accelerator.Counted() as counted:
            assert moved.advance(window)
    assert sum(counted.launches.values()) > 1000
    assert counted.launches["_fused_adam"] == 2
    assert not counted.transfers


def test_a_card_learns_what_a_processor_learns(in_tensors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to rounding, with contact normals that do not hang on which of two equally near faces is named."""
    monkeypatch.setattr(ContactPlanes, "transported_normals", lambda self, pose: self.normals)
    one, other = trainer_of(on_card=False), trainer_of()
    for trainer in (one, other):
        trainer.gather_statistics()
    begun = weights(one)
    torch.testing.assert_close(weights(other), begun, rtol=0, atol=0)
    for trainer in (one, other):
        rollout = trainer.begin(1, 2)
        for _ in range(2):
            assert trainer.advance(rollout)
    assert other.counters.step >= one.counters.step
    assert other.look_at_outcomes()
    # Passes that were not worth their time are no steps.
    assert other.counters.step == one.counters.step
    assert float((weights(one) - begun).abs().max()) > 1e-3
    torch.testing.assert_close(weights(other), weights(one), rtol=0, atol=2e-5)


@pytest.mark.parametrize(
    "fault",
    ["not finite", *(pytest.param(fault, marks=pytest.mark.slow) for fault in ("lost", "short of room"))],
)
def test_a_step_that_went_wrong_changes_no_weights(
    fault: str, in_tensors: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = trainer_of()
    trainer.gather_statistics()
    rollout = trainer.begin(1, 3)
    assert trainer.advance(rollout)
    assert trainer.look_at_outcomes()
    assert trainer.capacities is not None
    steps, kept, moments = trainer.counters.step, weights(trainer), trainer.learner.state()
    assert steps > 0
    if fault == "lost":
        rollout.watch.lost = torch.tensor(True)
    elif fault == "short of room":
        trainer.capacities.sizes["faces"] = 5
    else:
        monkeypatch.setattr("pb4u.training.trainer.step_energies", _not_finite)
    assert trainer.advance(rollout)
    assert torch.equal(weights(trainer), kept)
    assert all(
        torch.equal(moments[name], now) for name, now in trainer.learner.state().items() if "average" not in name
    )
    assert trainer.look_at_outcomes() == (fault != "not finite")
    assert trainer.counters.step == steps
    assert rollout.watch.seen_lost == (fault != "not finite")
    assert trainer.capacities.sizes["faces"] > 5


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_real_card_learns_what_a_processor_learns(in_tensors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ContactPlanes, "transported_normals", lambda self, pose: self.normals)
    one, other = trainer_of(), trainer_of(workers=Workers(0, 1, torch.device("cuda")))
    for trainer in (one, other):
        trainer.gather_statistics()
        rollout = trainer.begin(1, 2)
        for _ in range(2):
            assert trainer.advance(rollout)
        assert trainer.look_at_outcomes()
    assert other.counters.step == one.counters.step > 0
    torch.testing.assert_close(weights(other).cpu(), weights(one), rtol=0, atol=1e-4)


@pytest.mark.slow
def test_what_steps_gave_is_read_once_a_line_of_the_log(in_tensors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = trainer_of(replace(CONJUGATE, log_every=3))
    trainer.gather_statistics()
    rollout, reads, copied = trainer.begin(1, 6), [], torch.Tensor.cpu
    monkeypatch.setattr(torch.Tensor, "cpu", lambda self: reads.append(1) or copied(self))
    taken: list[bool] = []
    learn = trainer.learn
    monkeypatch.setattr(trainer, "learn", lambda *given: taken.append(learn(*given)) or taken[-1])
    while rollout.steps_left:
        assert trainer.advance(rollout)
    assert len(reads) == len(taken) // 3 >= 2


def _not_finite(*args: object, **kwargs: object) -> Energies:
    energies = step_energies(*args, **kwargs)  # type: ignore[arg-type]
    return Energies({name: value * torch.nan for name, value in energies.terms.items()})


@pytest.mark.slow
def test_validation_reads_back_once_a_clip(in_tensors: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """And gives the score that a processor gives, which decides in every frame."""
    monkeypatch.setattr(ContactPlanes, "transported_normals", lambda self, pose: self.normals)
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    accelerator = import_module("accelerator")
    one, other = trainer_of(on_card=False), trainer_of()
    scores = []
    for trainer in (one, other):
        trainer.gather_statistics()
        sample = trainer.validation.samples[0]
        scores.append(trainer.validation._rollout(trainer.model.eval(), sample))
    frames, energy, strain = scores[0]
    assert frames > 0
    assert scores[1] == (frames, pytest.approx(energy, rel=1e-4), pytest.approx(strain, rel=1e-4))
    window = other.loader.load([sample], 2)
    _ = window.start(0.0, 0.0)
    moved = accelerator.faked((other.validation, other.model, window), torch.device("meta"))
    for _ in range(2):
        # Constants are made by the first.
        with accelerator.Counted() as counted, torch.no_grad():
            assert len(list(moved[0]._frames(*moved[1:]))) == window.length
    assert sum(counted.launches.values()) > 1000
    assert not counted.transfers


def test_data_that_a_card_has_no_room_for_is_refused_before_the_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = trainer_of()
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda device: (10**4, 10**11))
    with pytest.raises(InputError, match=r"garments of \d+ triangles"):
        trainer.run()
    assert trainer.counters.window == 0
