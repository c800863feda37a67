"""A training as a record: to JSON and back, and single fields by name."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.network.registry import NETWORKS
from pb4u.training.configuration import (
    TRAININGS,
    TrainingConfiguration,
    training_from_json,
    training_to_json,
    with_settings,
)
from pb4u.training.request import TrainingRequest
from pb4u.training.session import train


def test_every_preset_survives_json() -> None:
    for configuration in (TRAININGS.named(name).configuration for name in TRAININGS):
        assert training_from_json(json.loads(json.dumps(training_to_json(configuration)))) == configuration


def test_settings_replace_fields_of_every_kind() -> None:
    changed = with_settings(
        TrainingConfiguration(),
        [
            "batch=4",
            "noise=0",
            "curriculum.learning_rate=1e-3",
            "curriculum.window_steps=((0,1),(0.5,2))",
            "data.garments=tshirt,dress",
            "data.triangles=1200",
            "network.width=64",
            "network.warm_start_shares=0.5,1",
            "data.motions=()",
            "after_settling=zero",
        ],
    )
    assert changed.data.motions == ()
    assert (changed.batch, changed.noise, changed.after_settling) == (4, 0.0, "zero")
    assert changed.curriculum.learning_rate == 1e-3
    assert changed.curriculum.window_length(0.6) == 2
    assert changed.data.garments == ("tshirt", "dress")
    assert changed.data.triangles == (1200,)
    assert replace(TrainingConfiguration().network, width=64, warm_start_shares=(0.5, 1)) == changed.network  # type: ignore[type-var]


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("bath=2", "did you mean batch"),
        ("curriculum.learning_rat=1", "learning_rate"),
        ("curriculum=1", "set one of curriculum.window_steps"),
        ("batch.size=1", "batch has no parts"),
        ("batch=two", "'two' is of another type"),
        ("batch=1.5", "'1.5' is of another type"),
        ("batch", "has no ="),
        ("batch=0", "batch must be 1 or more"),
        ("inside_weight=-1.0", "inside_weight must not be below 0"),
        ("data.triangles=many", "of another type"),
        ("network.layout.extra=descent", "of another type"),
        ("material.density=0.2", "of another shape"),
        ("curriculum.window_steps=((0,1,2),)", "of another shape"),
        ("curriculum.window_steps=((0,'a'),)", "of another shape"),
        ("network.width=-1", "network.width must be 1 or more"),
        ("interleaved=0", "interleaved must be 1 or more"),
        ("after_settling=fast", "one of skinned, slowed, zero, carried"),
    ],
)
def test_what_cannot_be_set_is_refused_in_a_sentence(setting: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        with_settings(TrainingConfiguration(), [setting])


def test_unknown_presets_and_foreign_records_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean small"):
        TRAININGS.named("smal")
    with pytest.raises(InputError, match="cannot be read"):
        training_from_json({"network": {"type": "Foreign"}})


def test_fixed_steps_with_a_random_number_of_steps_are_refused_before_any_work(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.raises(InputError, match=r"propagation steps.*most_propagation_steps=0"):
        train(TrainingRequest(preset="comparison", set=["network=literal_small_without_both"], out=out))
    assert not out.exists()


def test_the_literal_arms_differ_in_control_and_scaling_alone() -> None:
    full, arms = NETWORKS["literal_small"], ("without_propagation_control", "without_update_scaling", "without_both")
    changed = [NETWORKS[f"literal_small_{arm}"] for arm in arms]
    assert all(replace(arm, control=full.control, scaling=full.scaling) == full for arm in changed)
    assert [arm.control == full.control for arm in changed] == [False, True, False]
    assert [arm.scaling == full.scaling for arm in changed] == [True, False, False]


def test_the_literal_network_learns_the_k_of_its_mean_edge_length_up_to_32_times_its_triangles() -> None:
    network = NETWORKS["literal_small"]
    finest = network.scaling.reference_length / np.sqrt(32.0)
    assert TRAININGS.named("literal_small").configuration.most_propagation_steps >= network.control.distance / finest
