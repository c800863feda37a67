"""What a training learns comes back, exactly or within what half precision may cost."""

from __future__ import annotations

import pytest
import torch
from tests.training.ball_data import TINY

from pb4u.training.distribution import Workers
from pb4u.training.learner import Learner

ALONE = Workers(0, 1, torch.device("cpu"))


def practised(scale: float = 1.0) -> Learner:
    learner = Learner(TINY, ALONE)
    for number in (1, 2):
        generator = torch.Generator().manual_seed(number)
        loss = sum((p * torch.randn(p.shape, generator=generator)).sum() for p in learner.model.parameters())
        learner.gradient(scale * loss)  # type: ignore[arg-type]
        learner.step(1e-3, number)
    return learner


@pytest.mark.parametrize(("exact", "tolerance"), [(True, 0.0), (False, 0.01)])
def test_moments_come_back(exact: bool, tolerance: float) -> None:
    learner, other = practised(), Learner(TINY, ALONE)
    other.restore(learner.state(exact))
    for a, b in zip(learner.model.parameters(), other.model.parameters(), strict=True):
        assert torch.equal(a, b)
        for key in ("exp_avg", "exp_avg_sq", "step"):
            mine, theirs = learner.optimiser.state[a][key], other.optimiser.state[b][key]
            assert torch.allclose(mine, theirs, rtol=tolerance, atol=0.0), key


def test_rounded_moments_of_tiny_gradients_do_not_vanish() -> None:
    state = practised(1e-12).state(exact=False)
    roots = [value for name, value in state.items() if name.startswith("root/")]
    assert roots
    assert all(bool((value > 0).all()) for value in roots)


def test_a_state_is_a_copy() -> None:
    learner = practised()
    state = learner.state()
    kept = {name: value.clone() for name, value in state.items()}
    learner.gradient(sum(p.square().sum() for p in learner.model.parameters()))  # type: ignore[arg-type]
    learner.step(1.0, 3)
    assert all(torch.equal(kept[name], value) for name, value in state.items())
    learner.restore(state)
    assert all(torch.equal(kept[name], value) for name, value in learner.state().items())


def test_gradients_are_shortened_and_their_length_told() -> None:
    learner = Learner(TINY, ALONE)
    loss = sum(1e3 * p.sum() for p in learner.model.parameters())
    assert learner.gradient(loss) > 1e3  # type: ignore[arg-type]
    left = torch.cat([p.grad.reshape(-1) for p in learner.model.parameters() if p.grad is not None])
    assert float(left.norm()) == pytest.approx(1.0, rel=1e-3)
