"""What a network is said to be follows from its configuration and its record, never from its name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pb4u.network.acceleration_model import AccelerationModel, NetworkConfiguration
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation_control import FixedSteps
from pb4u.network.registry import NETWORKS
from pb4u.network.update_scaling import NoScaling
from pb4u.paper.departures import departures, description
from pb4u.simulation.checkpoint import Checkpoint, TrainingRecord, from_pretrained

SMALL, WHOLE = NETWORKS["literal_small"], NETWORKS["literal"]
assert isinstance(SMALL, Pb4uConfiguration)
assert isinstance(WHOLE, Pb4uConfiguration)


def checkpoint(configuration: NetworkConfiguration, steps: tuple[int, int] = (5, 8)) -> Checkpoint:
    model = AccelerationModel(replace(configuration, width=16, blocks=1).network())
    return Checkpoint("net", model, configuration, TrainingRecord(1 / 30, (0.028, 0.045), steps), "Apache-2.0")


def test_the_literal_network_departs_in_nothing() -> None:
    assert departures(checkpoint(WHOLE)) == []
    assert departures(checkpoint(SMALL)) == ["It is 64 wide with 4 blocks; the paper's has 128 and 15."]
    assert description(checkpoint(SMALL))["start"] == "free flight"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"control": FixedSteps(5)}, "does not follow the resolution"),
        ({"scaling": NoScaling()}, "not scaled"),
        ({"passes": 2}, "2 times in a step"),
        ({"warm_start_shares": (0.5,)}, "warm start"),
        ({"world_edges": replace(SMALL.world_edges, neighbours=1)}, "nearest of the body"),
        ({"layout": replace(SMALL.layout, world_edge=("relative_now",))}, "world edge feature relative_now"),
    ],
)
def test_each_change_is_a_sentence(change: dict, says: str) -> None:
    found = departures(checkpoint(replace(SMALL, **change)))
    assert any(says in sentence for sentence in found), found


def test_random_steps_in_training_are_a_departure() -> None:
    assert "drawn from 1 to 16" in departures(checkpoint(WHOLE, (1, 16)))[0]


def test_of_released_weights_nothing_is_said_that_their_files_do_not_tell() -> None:
    released = checkpoint(NETWORKS["release_pb4u"], (0, 10_000))
    unknown = replace(released, record=replace(released.record, details={"resolutions": "unknown"}))
    found = " ".join(departures(unknown))
    assert "drawn" not in found
    assert "does not follow" not in found
    assert description(unknown)["trained"]["propagation_steps"] == []


def test_the_shipped_network_says_what_it_adds() -> None:
    told = description(from_pretrained("pb4u-light"))
    # Trained in two stages, one on from the other.
    assert told["trained"]["hours"] == pytest.approx(2.15)
    assert told["width"] == 32
    assert told["search"].startswith("joined passes")
    assert len(told["departs_from_paper"]) >= 8
