"""The trainer itself: it learns, it comes back from an explosion, its curves and weights are what they should be."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tests.training.ball_data import TINY, ball_data, slide
from tests.training.listening import ALONE, Listener, made
from torch import Tensor

from pb4u.errors import InputError, InputWarning
from pb4u.network.graph.features import ADVANCE, DESCENT, FeatureLayout
from pb4u.paper.network_presets import pb4u_small
from pb4u.physics.step_potential import Energies
from pb4u.physics.time_step import TimeStep
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import load_checkpoint
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.step import Prediction, StepMethod, predictions
from pb4u.training import trainer as trainer_module
from pb4u.training.budget import Budget, Counters
from pb4u.training.curriculum import Curriculum
from pb4u.training.journal import draw_curve
from pb4u.training.objective import LOSS_POTENTIAL, step_energies
from pb4u.training.recovery import TrainingFailedError
from pb4u.training.run_folder import NotSavedError, RunFolder
from pb4u.training.trainer import RoundEnd, Trainer
from pb4u.training.validation import Score, Validation
from pb4u.training.windows import Rollout

pytestmark = pytest.mark.usefixtures("one_thread")


def test_the_loss_falls_and_what_is_kept_can_be_simulated_with(tmp_path: Path) -> None:
    listener = Listener()
    trainer = made(replace(TINY, validate_every=60), 60, tmp_path / "run", listener)
    assert trainer.run() == "finished"
    assert trainer.counters.step >= 60
    totals = [means["total"] for means in listener.means]
    early, late = sum(totals[:2]), sum(totals[-2:])
    assert late < 0.8 * early
    checkpoint = load_checkpoint(tmp_path / "run" / "best.safetensors")
    assert checkpoint.record.dt == pytest.approx(1 / 30)
    assert checkpoint.record.propagation_steps == (1, 3)
    assert checkpoint.record.mean_edge_lengths == trainer.data.edge_lengths
    assert trainer.folder is not None
    final = load_checkpoint(trainer.folder.final).model.state_dict()
    for name, averaged in trainer.learner.average.values.items():
        assert torch.equal(final[name], averaged), name
    lines = trainer.folder.metrics()
    assert {"stretch", "bending", "collision", "gravity", "friction", "inertia"} <= set(lines[0])
    assert [line["step"] for line in lines if "total" in line] == sorted(
        {line["step"] for line in lines if "total" in line}
    )
    assert "inside" not in lines[0]
    draw_curve([*lines, lines[-1] | {"inside": 0.01}], tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 5000


def test_an_exploding_training_goes_back_lowers_its_rate_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener()
    trainer = made(TINY, 30, listener=listener)
    original, calls = trainer_module.step_energies, [0]

    def wild(step: TimeStep, positions: Tensor, *weights: float) -> Energies:
        calls[0] += 1
        energies = original(step, positions, *weights)
        spoilt = torch.nan if calls[0] == 15 else 1.0
        return Energies({name: value * spoilt for name, value in energies.terms.items()})

    monkeypatch.setattr(trainer_module, "step_energies", wild)
    assert trainer.run() == "finished"
    assert trainer.counters.rollbacks == 1
    assert trainer.counters.rate_factor == 0.5
    assert len(listener.sentences) == 1
    assert "diverging; it returns to the weights of step" in listener.sentences[0]
    assert all(bool(torch.isfinite(p).all()) for p in trainer.model.parameters())


def test_a_rollback_restores_weights_averages_and_moments() -> None:
    trainer = made(TINY, 12)
    trainer.run()
    kept = trainer.learner.state()
    trainer.budget = Budget(100)
    trainer.train_round()
    assert not all(torch.equal(kept[name], value) for name, value in trainer.learner.state().items())
    trainer.counters = trainer.recovery.roll_back(trainer.counters)
    assert all(torch.equal(kept[name], value) for name, value in trainer.learner.state().items())


def test_a_training_that_keeps_coming_apart_ends_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made(TINY, 50)
    monkeypatch.setattr(Trainer, "train_round", lambda self: RoundEnd.CAME_APART)
    with pytest.raises(TrainingFailedError, match="start it with a lower"):
        trainer.run()


def test_predictions_that_are_not_finite_are_not_learnt_from() -> None:
    trainer = made(TINY, 4)
    trainer.run()
    rollout = trainer.begin(0, 1)
    state = rollout.state
    before = [p.detach().clone() for p in trainer.model.parameters()]
    lost = State(state.positions * torch.nan, state.velocities, state.frame + 1)
    lost.positions.requires_grad_(True)
    assert not trainer.learn(rollout.prepared, rollout.window.timeline.step_from(state), Prediction(lost))
    assert all(torch.equal(a, b) for a, b in zip(before, trainer.model.parameters(), strict=True))


def test_garments_of_two_sizes_and_propagation_counts_share_a_batch() -> None:
    alone, together = made(replace(TINY, batch=1), 1), made(replace(TINY, batch=2), 1)
    samples = [together.sampler.sample(i, 1) for i in range(40)]
    i = next(k for k in range(0, 40, 2) if samples[k].outfit != samples[k + 1].outfit)
    losses = []
    for trainer, chosen in ((alone, [samples[i]]), (alone, [samples[i + 1]]), (together, samples[i : i + 2])):
        trainer.model.load_state_dict(alone.model.state_dict())
        window = trainer.loader.load(chosen, 1)
        steps = [1 + 2 * (sample is samples[i]) for sample in chosen]
        prepared = trainer.model.prepare(window.timeline.garments).with_steps(steps)
        step = window.timeline.step_from(window.start(0.003, 0.002))
        features = StepFeatures(prepared, LOSS_POTENTIAL)
        method = StepMethod(network=NetworkPass(trainer.model, prepared, features, mode=nullcontext))
        *_, after = predictions(step, method)
        energies = trainer_module.step_energies(step, after.state.positions, 5e3)
        losses.append(energies.total.item() / len(chosen))
    assert losses[2] == pytest.approx((losses[0] + losses[1]) / 2, rel=1e-4)


@pytest.mark.parametrize("variant", ["skinned", "zero", "carried"])
def test_the_velocity_after_settling_is_the_chosen_one(variant: str) -> None:
    trainer = made(replace(TINY, after_settling=variant), 1)
    rollout = trainer.begin(0, 2)
    window, state = rollout.window, rollout.state
    moved = 1e-3 * torch.ones_like(state.positions)
    settled = State(state.positions + moved, moved * 3.0, state.frame + 1)
    off = trainer.with_initial_velocity(rollout, settled)
    expected = {
        "skinned": window.timeline.skinned_velocity(1),
        "zero": torch.zeros_like(moved),
        "carried": moved * 30.0,
    }
    assert off.frame == 1
    assert torch.allclose(off.velocities, expected[variant], atol=1e-6)


def test_slowed_garments_set_off_with_half_to_all_of_the_bodys_speed() -> None:
    trainer = made(replace(TINY, after_settling="slowed"), 1)
    rollout = trainer.begin(0, 2)
    window, state = rollout.window, rollout.state
    shares = []
    for number in range(20):
        off = trainer.with_initial_velocity(
            replace(rollout, number=number), State(state.positions, state.velocities, state.frame + 1)
        )
        share = float(off.velocities.norm() / window.timeline.skinned_velocity(1).norm())
        assert torch.allclose(off.velocities, share * window.timeline.skinned_velocity(1), atol=1e-6)
        shares.append(share)
    assert 0.5 <= min(shares) < 0.65
    assert 0.85 < max(shares) <= 1.0


def test_flat_validation_ends_a_training(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made(replace(TINY, validate_every=2, patience=2), 200)
    monkeypatch.setattr(trainer.validation, "score", lambda model: Score(1.0, 1.0, 0.1, 1.0))
    assert trainer.run() == "flat"
    assert trainer.counters.step < 20


def test_a_curriculum_by_the_clock_ends_by_the_clock() -> None:
    budget = Budget(steps=None, minutes=0.02)
    trainer = Trainer(TINY, budget, ball_data(), ALONE, None, Listener())
    assert trainer.run() == "finished"
    # Up to half of the 1.2 s is kept for the validation at the end.
    assert 0.6 <= trainer.counters.seconds < 20.0


def test_the_end_of_the_minutes_does_not_wait_for_a_round(monkeypatch: pytest.MonkeyPatch) -> None:
    long = replace(TINY, interleaved=2, curriculum=Curriculum(window_steps=((0.0, 1000),), learning_rate=1e-3))
    trainer = Trainer(long, Budget(steps=None, minutes=10.0), ball_data(), ALONE, None, Listener())
    original, taken = Trainer.advance, [0]

    def late(self: Trainer, rollout: Rollout) -> bool:
        taken[0] += 1
        if taken[0] == 6:
            self.began -= 700.0
        return original(self, rollout)

    monkeypatch.setattr(Trainer, "advance", late)
    assert trainer.run() == "finished"
    assert taken[0] == 6


def test_better_means_more_frames_survived_then_less_excess() -> None:
    def score(survived: float, excess: float, energy: float = 1.0) -> Score:
        return Score(survived, excess, 0.1, energy)

    assert score(1.0, 9.0).beats(score(0.9, 1.0))
    assert score(1.0, 0.9, energy=9.0).beats(score(1.0, 1.0), 0.005)
    assert not score(1.0, 0.999).beats(score(1.0, 1.0), 0.005)
    assert not score(1.0, 1.0, energy=0.0).beats(score(1.0, 1.0))
    assert not score(0.5, 0.0).beats(score(1.0, 5.0))
    assert score(1.0, 1.0).beats(score(1.0, math.inf))


def test_a_score_has_what_steps_leave_above_their_minima() -> None:
    trainer = made(TINY, 2)
    model = trainer.model.eval()
    usual = trainer.validation.score(model)
    with torch.no_grad():
        model.network.decoder.last.weight.mul_(30.0)
    worse = trainer.validation.score(model)
    assert 0.0 < usual.excess_height < worse.excess_height
    assert [len(reference.shared) for reference in trainer.validation.references] == [2, 2]


def test_a_score_is_of_what_resists_and_not_of_how_low_cloth_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made(TINY, 2)

    def far_lower(step: TimeStep, positions: Tensor, weight: float) -> Energies:
        terms = step_energies(step, positions, weight).terms
        return Energies({**terms, "gravity": terms["gravity"] - 1000.0})

    usual = trainer.validation.score(trainer.model.eval())
    monkeypatch.setattr("pb4u.training.validation.step_energies", far_lower)
    lower = trainer.validation.score(trainer.model.eval())
    assert usual.energy_without_gravity > 0.0
    assert lower.energy_without_gravity == pytest.approx(usual.energy_without_gravity, rel=1e-4)


def test_a_best_score_of_earlier_versions_is_not_compared_with() -> None:
    counters = Counters(step=5, best=Score(1.0, 0.2, 0.1, 0.3))
    assert Counters.from_json(counters.to_json()) == counters
    for name in ("energy", "energy_without_gravity"):
        earlier = counters.to_json() | {"best": {"survived": 1.0, name: 0.25, "strain": 0.1}}
        assert Counters.from_json(earlier) == replace(counters, best=None)


def test_the_network_may_be_any_configuration() -> None:
    wide = replace(TINY, network=replace(pb4u_small, width=4, blocks=0), curriculum=Curriculum(learning_rate=1e-3))
    assert made(wide, 2).run() == "finished"


def test_interleaved_windows_take_turns_until_each_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    curriculum = Curriculum(window_steps=((0.0, 3),), learning_rate=1e-3)
    trainer = made(replace(TINY, interleaved=3, curriculum=curriculum), 100)
    seen: list[tuple[int, int]] = []
    original = Trainer.advance

    def noted(self: Trainer, rollout: Rollout) -> bool:
        seen.append((rollout.number, rollout.steps_left))
        if rollout.number == 1:
            rollout.steps_left = 1
        return original(self, rollout)

    monkeypatch.setattr(Trainer, "advance", noted)
    assert trainer.train_round() is RoundEnd.LEARNT
    assert seen == [(0, 3), (1, 3), (2, 3), (0, 2), (2, 2), (0, 1), (2, 1)]
    assert trainer.counters.step == 7


def test_a_window_does_not_care_what_it_is_interleaved_with() -> None:
    steps = {}
    for together in (1, 2):
        trainer = made(replace(TINY, interleaved=together, curriculum=Curriculum(learning_rate=1e-12)), 100)
        rollout = trainer.begin(1, 2)
        other = trainer.begin(0, 2)
        for _ in range(2):
            assert trainer.advance(rollout)
            if together == 2:
                assert trainer.advance(other)
        steps[together] = rollout.state.positions
    assert torch.allclose(steps[1], steps[2], atol=1e-6)


def test_a_rollback_before_the_first_checkpoint_keeps_the_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made(replace(TINY, checkpoint_every=1000), 3)
    ends = iter([RoundEnd.CAME_APART])
    original = Trainer.train_round
    monkeypatch.setattr(Trainer, "train_round", lambda self: next(ends, None) or original(self))
    assert trainer.run() == "finished"
    assert trainer.counters.rollbacks == 1
    frozen = {name: bool(value) for name, value in trainer.model.named_buffers() if name.endswith("frozen")}
    assert frozen
    assert all(frozen.values()), frozen


def test_a_round_takes_no_more_steps_than_are_left() -> None:
    trainer = made(replace(TINY, interleaved=4), 6)
    assert trainer.run() == "finished"
    assert trainer.counters.step == 6


def test_further_passes_take_no_more_steps_than_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pb4u.simulation.step.LARGE_DECREASE", -float("inf"))
    further = replace(TINY.network, conjugate=True, further_passes=2)
    trainer = made(replace(TINY, network=further, interleaved=4), 6)
    assert trainer.run() == "finished"
    assert trainer.counters.step == 6


CARRIED = replace(
    TINY,
    network=replace(
        pb4u_small,
        width=4,
        blocks=1,
        layout=FeatureLayout(extra=(DESCENT, ADVANCE)),
        passes=2,
        warm_start_shares=(0.5, 1.0),
    ),
    after_settling="slowed",
    interleaved=2,
    curriculum=Curriculum(window_steps=((0.0, 3),), learning_rate=1e-3),
)


def test_further_passes_in_training_start_where_the_last_one_left_off(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = made(CARRIED, 100)
    rollout = trainer.begin(0, 2)
    begun: list[Tensor] = []
    reached: list[Tensor] = []
    original = NetworkPass.correction

    def noted(self: NetworkPass, step: TimeStep, accelerations: Tensor) -> Tensor:
        begun.append(accelerations)
        added = original(self, step, accelerations)
        reached.append((accelerations + added).detach())
        return added

    monkeypatch.setattr(NetworkPass, "correction", noted)
    assert trainer.advance(rollout)
    assert trainer.advance(rollout)
    assert len(begun) == 4
    assert torch.equal(begun[1], reached[0])
    assert torch.equal(begun[3], reached[2])
    assert not torch.equal(begun[2], reached[1])


@pytest.mark.parametrize("checks", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_a_stop_within_a_round_goes_on_from_its_beginning(tmp_path: Path, checks: int) -> None:
    configuration = replace(CARRIED, checkpoint_every=5, statistics_windows=2, validation_frames=2)
    whole = made(configuration, 24)
    whole.run()
    answers = iter([False] * checks + [True])
    stopped = made(configuration, 24, tmp_path / "run")
    stopped.stopping = lambda: next(answers)
    assert stopped.run() == "stopped"
    assert stopped.counters.step == 12
    resumed = made(configuration, 24)
    assert stopped.folder is not None
    found = stopped.folder.load_state()
    assert found is not None
    resumed.resume(*found)
    assert resumed.run() == "finished"
    assert all(torch.equal(value, resumed.learner.state()[name]) for name, value in whole.learner.state().items())


@pytest.mark.parametrize("interleaved", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_stopped_training_goes_on_to_the_same_numbers(tmp_path: Path, interleaved: int) -> None:
    configuration = replace(
        TINY, checkpoint_every=5, statistics_windows=2, validation_frames=2, interleaved=interleaved
    )
    whole = made(configuration, 16)
    whole.run()
    answers = iter([False] * (8 // interleaved) + [True])
    stopped = made(configuration, 16, tmp_path / "run")
    stopped.stopping = lambda: next(answers)
    assert stopped.run() == "stopped"
    resumed = made(configuration, 16)
    assert stopped.folder is not None
    found = stopped.folder.load_state()
    assert found is not None
    resumed.resume(*found)
    assert 0 < resumed.counters.step < 16
    assert resumed.run() == "finished"
    assert all(torch.equal(value, resumed.learner.state()[name]) for name, value in whole.learner.state().items())


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path) -> None:
    trainer = made(TINY, 1, tmp_path / "run")
    trainer.run()
    assert trainer.folder is not None
    found = trainer.folder.load_state()
    assert found is not None
    other = made(replace(TINY, network=replace(pb4u_small, width=4)), 1)
    with pytest.raises(InputError, match="of another network"):
        other.resume(*found)


def test_a_full_disk_costs_a_checkpoint_and_not_the_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener()
    trainer = made(replace(TINY, checkpoint_every=4, validate_every=1000), 8, tmp_path / "run", listener)
    original, calls = RunFolder.save_state, [0]

    def full(self: RunFolder, tensors: dict[str, Tensor], counters: dict[str, object]) -> None:
        calls[0] += 1
        if calls[0] == 1:
            raise NotSavedError("Cannot write last.safetensors: No space left on device.")
        original(self, tensors, counters)

    monkeypatch.setattr(RunFolder, "save_state", full)
    assert trainer.run() == "finished"
    assert "No space left on device. The training goes on" in listener.sentences[0]


def test_validation_clips_are_spread_over_garments_sizes_and_bodies() -> None:
    data = ball_data((4, 6, 8))
    outfits = [
        replace(outfit, garment=replace(outfit.garment, name=name))
        for _ in range(2)
        for name in ("apron", "cape")
        for outfit in data.outfits
    ]
    chosen = Validation(
        replace(data, outfits=tuple(outfits)), replace(TINY, validation_clips=6), made(TINY, 1).loader
    ).samples
    assert sorted(outfits[sample.outfit].garment.name for sample in chosen) == 3 * ["apron"] + 3 * ["cape"]
    assert len({sample.outfit for sample in chosen}) == 6
    assert {outfits[sample.outfit].garment.triangle_count for sample in chosen} == {32, 72, 128}


def test_a_validation_on_training_clips_is_warned_of() -> None:
    data = ball_data()
    with pytest.warns(InputWarning, match="uses clips of the training"):
        Trainer(TINY, Budget(1), replace(data, clips=data.clips[:2]), ALONE, None, Listener())


def test_a_short_clip_shortens_no_other() -> None:
    data, short, long = ball_data(), slide("validation", 0.5, frames=3), slide("validation", 0.6)
    two = Validation(replace(data, clips=(*data.clips[:2], short, long)), TINY, made(TINY, 1).loader)
    assert {two.data.clips[sample.clip].name for sample in two.samples} == {"slide-0.6"}
    assert [two.frames(sample) for sample in two.samples] == 2 * [TINY.validation_frames]
    with pytest.warns(InputWarning, match=r"5 frames.* 3"):
        alone = Trainer(TINY, Budget(1), replace(data, clips=(*data.clips[:2], short)), ALONE, None, Listener())
    assert [alone.validation.frames(sample) for sample in alone.validation.samples] == [3, 3]
    vars(alone.validation)["references"] = ()
    assert alone.validation.score(alone.model.eval()).survived > 0.0


def test_minutes_are_those_of_training_and_not_of_its_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = Trainer(TINY, Budget(steps=3, minutes=0.02), ball_data(), ALONE, None, Listener())
    gather = trainer.gather_statistics

    def slowly() -> None:
        gather()
        trainer.began -= 60.0

    monkeypatch.setattr(trainer, "gather_statistics", slowly)
    trainer.run()
    assert trainer.counters.step > 0
    assert trainer.counters.seconds < 60.0
