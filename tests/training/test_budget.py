"""The guard: calm on noise and single wild samples, awake when a loss stays high."""

from __future__ import annotations

import numpy as np

from pb4u.training.budget import Budget, ExplosionGuard


def watched(energies: list[float]) -> ExplosionGuard:
    guard = ExplosionGuard()
    for energy in energies:
        guard = guard.after(energy)
        if guard.exploded:
            break
    return guard


def test_noise_and_single_wild_samples_do_not_count() -> None:
    noise = np.random.default_rng(0).lognormal(0.0, 1.0, 500)
    noise[[100, 300]] = 1e6
    assert not watched(noise.tolist()).exploded


def test_a_loss_that_stays_high_counts_within_fifty_steps() -> None:
    guard = watched([1.0] * 300 + [1e3] * 100)
    assert guard.exploded
    assert guard.seen < 350
    assert not guard.calm


def test_a_falling_loss_is_calm() -> None:
    assert watched(np.geomspace(100.0, 0.1, 400).tolist()).calm


def test_minutes_keep_time_for_the_last_validation() -> None:
    assert Budget(None, 10.0).without(120.0) == Budget(None, 8.0)
    assert Budget(5, 1.0).without(300.0) == Budget(5, 0.5)
    assert Budget(5).without(300.0) == Budget(5)
