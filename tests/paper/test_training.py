"""The baselines in the trainer that ours has, with what ContourCraft minimises besides."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.paper.test_networks import TINY
from tests.training.ball_data import TINY as TINY_TRAINING
from tests.training.listening import Listener, made

from pb4u.network.acceleration_model import Derived
from pb4u.paper.baselines.meshgraphnet import MeshGraphNet, MeshGraphNetConfiguration
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.simulation.checkpoint import load_checkpoint
from pb4u.training.configuration import TrainingConfiguration, training_from_json, training_to_json, with_settings

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.parametrize("name", TINY)
@pytest.mark.parametrize("most_steps", [0, 3])
def test_every_method_trains_and_is_kept(name, most_steps, tmp_path):
    configuration = replace(
        TINY_TRAINING, network=TINY[name], most_propagation_steps=most_steps, log_every=2, validate_every=100
    )
    listener = Listener()
    trainer = made(configuration, 6, tmp_path / "run", listener)
    assert trainer.run() == "finished"
    assert load_checkpoint(trainer.folder.best).configuration == TINY[name]
    contacts = {"repulsion", "contours"}
    assert set(listener.means[-1]) & contacts == (contacts if name == "contourcraft" else set())


class Pull:
    """Stands in for a method's loss: everything is drawn 2 cm up, more so as the training goes on."""

    name = "pull"

    def __init__(self, garments):
        self.garments = garments

    def energies(self, before, after, progress):
        pulled = ((after[:, 1] - before[:, 1] - 0.02) ** 2).mean()
        return 1e6 * pulled[None] * torch.ones(self.garments.garment_count)


class PulledNetwork(MeshGraphNet):
    def derive(self, garments):
        return Derived(losses=(Pull(garments),))


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
        trainer = made(configuration, 12, listener=listener)
        trainer.run()
        rises.append(float(trainer.model.network.decoder.last.bias[1].detach()))
        means = listener.means[-1]
    assert rises[1] > rises[0] + 5e-3
    assert means["pull"] > 100.0
    assert means["total"] == pytest.approx(
        sum(means[name] for name in IncrementalPotential().names), rel=1e-4, abs=1e-6
    )


def test_a_training_of_a_baseline_is_set_up_by_name_and_survives_json():
    configuration = with_settings(TINY_TRAINING, ["network=contourcraft_small", "network.radius=0.02"])
    assert configuration.network.radius == 0.02
    assert training_from_json(training_to_json(configuration)) == configuration
