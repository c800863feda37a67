"""The baselines in the trainer that ours has, with what ContourCraft minimises besides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from tests.baselines.test_networks import TINY
from tests.training.ball_data import TINY as TINY_TRAINING
from tests.training.ball_data import ball_data

from pb4u.baselines.meshgraphnet import MeshGraphNet, MeshGraphNetConfiguration
from pb4u.simulation.checkpoint import load_checkpoint
from pb4u.training.budget import Budget
from pb4u.training.configuration import TrainingConfiguration, training_from_json, training_to_json, with_settings
from pb4u.training.distribution import Workers
from pb4u.training.progress import Reporter
from pb4u.training.run_folder import RunFolder
from pb4u.training.trainer import Trainer

ALONE = Workers(0, 1, torch.device("cpu"))


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Listener(Reporter):
    def __init__(self) -> None:
        self.means: list[dict[str, float]] = []

    def progressed(self, step: int, progress: float, seconds: float, means: object) -> None:
        self.means.append(dict(means))  # type: ignore[call-overload]

    def validated(self, step: int, score: object, best: bool) -> None: ...

    def said(self, sentence: str) -> None: ...


@pytest.mark.parametrize("name", TINY)
@pytest.mark.parametrize("most_steps", [0, 3])
def test_every_method_trains_and_is_kept(name, most_steps, tmp_path):
    configuration = replace(
        TINY_TRAINING, network=TINY[name], most_propagation_steps=most_steps, log_every=2, validate_every=100
    )
    listener = Listener()
    folder = RunFolder.create(tmp_path / "run", training_to_json(configuration))
    assert Trainer(configuration, Budget(6), ball_data(), ALONE, folder, listener).run() == "finished"
    assert load_checkpoint(folder.best).configuration == TINY[name]
    contacts = {"repulsion", "contours"}
    assert set(listener.means[-1]) & contacts == (contacts if name == "contourcraft" else set())


class Pull:
    """Stands in for a method's loss: everything is drawn 2 cm up, more so as the training goes on."""

    name = "pull"

    def energies(self, garments, before, after, progress):
        return 1e6 * ((after[:, 1] - before[:, 1] - 0.02) ** 2).mean()[None] * torch.ones(garments.garment_count)


class PulledNetwork(MeshGraphNet):
    def further_losses(self):
        return (Pull(),)


class PulledConfiguration(MeshGraphNetConfiguration):
    def network(self):
        return PulledNetwork(self)


def test_what_a_method_minimises_besides_is_learnt_but_is_no_part_of_the_total():
    rises, means = [], {}
    for kind in (MeshGraphNetConfiguration, PulledConfiguration):
        configuration: TrainingConfiguration = replace(
            TINY_TRAINING, network=kind(width=8, blocks=1), log_every=6, validate_every=1000
        )
        listener = Listener()
        trainer = Trainer(configuration, Budget(12), ball_data(), ALONE, None, listener)
        trainer.run()
        rises.append(float(trainer.model.network.decoder.last.bias[1].detach()))
        means = listener.means[-1]
    assert rises[1] > rises[0] + 5e-3
    physical = ("stretch", "bending", "gravity", "inertia", "collision", "friction")
    assert means["pull"] > 100.0
    assert means["total"] == pytest.approx(sum(means[name] for name in physical), rel=1e-4, abs=1e-6)


def test_a_training_of_a_baseline_is_set_up_by_name_and_survives_json():
    configuration = with_settings(TINY_TRAINING, ["network=contourcraft_small", "network.radius=0.02"])
    assert configuration.network.radius == 0.02
    assert training_from_json(training_to_json(configuration)) == configuration
