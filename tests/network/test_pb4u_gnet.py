"""The network against its readable twin, and its size."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.network_scenes import DT, accelerations, moment, prepared_for, sheet
from tests.readable_network import readable_accelerations
from torch.utils._python_dispatch import TorchDispatchMode

from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.world_edges import WorldEdgeRule
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.network.propagation import PAPER_PROPAGATION, RELEASED_PROPAGATION, PropagationForm
from pb4u.network.registry import NETWORKS

TINY = Pb4uConfiguration(width=16, blocks=3)
FORMS = {
    "paper": PAPER_PROPAGATION,
    "release": RELEASED_PROPAGATION,
    "mesh_only": replace(PAPER_PROPAGATION, world_edges=False),
    "mixed": PropagationForm(norm="accumulated", message_norm=False, world_edges=True, decay=0.5),
    "normed_messages": PropagationForm(message_norm=True),
}


def model_of(configuration: Pb4uConfiguration, seed: int = 0, dtype: torch.dtype = torch.float64) -> AccelerationModel:
    torch.manual_seed(seed)
    model = AccelerationModel(configuration.network()).to(dtype)
    for parameter in model.parameters():
        # Away from the initial values, so that biases and norms of 0 and 1 hide nothing.
        parameter.data += 0.05 * torch.randn_like(parameter)
    return model


def weights_gradients(model: AccelerationModel, loss: torch.Tensor) -> dict[str, torch.Tensor]:
    model.zero_grad()
    loss.backward()
    return {name: p.grad.clone() for name, p in model.named_parameters()}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("neighbours", [1, 3])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_it_equals_its_readable_twin_forward_and_backward(form, neighbours, dtype):
    configuration = replace(TINY, propagation=FORMS[form], world_edges=WorldEdgeRule(neighbours=neighbours))
    model = model_of(configuration, dtype=dtype)
    at = moment([sheet(9, 12), sheet(7, 6, edge=0.02, seed=3)])
    prepared = prepared_for(model, at, steps=(4, 2), dtype=dtype)
    graph = prepared.graph(at.state, at.collider, DT)
    assert graph.edges["garment_to_body"].edge_count > 0

    fast, readable = model(graph, prepared), readable_accelerations(model, graph, prepared)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    scale = readable.detach().abs().max()
    assert (fast - readable).abs().max() < tolerance * scale
    weighting = torch.randn(fast.shape, generator=torch.Generator().manual_seed(1)).to(fast) / scale
    expected = weights_gradients(model, (readable * weighting).sum())
    for name, gradient in weights_gradients(model, (fast * weighting).sum()).items():
        bound = tolerance * max(float(expected[name].abs().max()), 1.0)
        assert (gradient - expected[name]).abs().max() < bound, name


def test_gradients_reach_the_state_as_the_twin_says():
    model = model_of(TINY)
    at = moment([sheet(9, 12)])
    gradients = []
    for evaluate in (lambda g, p: model(g, p), lambda g, p: readable_accelerations(model, g, p)):
        positions = at.state.positions.clone().requires_grad_()
        prepared = prepared_for(model, at, steps=3)
        graph = prepared.graph(replace(at.state, positions=positions), at.collider, DT)
        evaluate(graph, prepared).square().sum().backward()
        gradients.append(positions.grad)
    assert gradients[0].abs().max() > 0
    assert (gradients[0] - gradients[1]).abs().max() < 1e-10 * gradients[1].abs().max()


def test_result_and_gradients_are_the_same_to_the_last_bit_every_time():
    model = model_of(TINY, dtype=torch.float32)
    at = moment([sheet(9, 12)])
    first, second = (accelerations(model, at, dtype=torch.float32) for _ in range(2))
    assert torch.equal(first, second)
    gradients = [weights_gradients(model, result.square().sum()) for result in (first, second)]
    assert all(torch.equal(gradient, gradients[1][name]) for name, gradient in gradients[0].items())


class WidestEdgeTensor(TorchDispatchMode):
    """Remembers the most columns of any tensor that has a row for each edge."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows, self.columns = rows, 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        for tensor in result if isinstance(result, tuple) else (result,):
            if isinstance(tensor, torch.Tensor) and tensor.dim() == 2 and tensor.shape[0] >= self.rows:
                self.columns = max(self.columns, tensor.shape[1])
        return result


@pytest.mark.parametrize("form", FORMS)
def test_nothing_wider_than_one_latent_is_ever_built_for_edges(form):
    configuration = replace(TINY, width=64, propagation=FORMS[form])
    model = model_of(configuration)
    at = moment([sheet(9, 12)])
    prepared = prepared_for(model, at, steps=2)
    graph = prepared.graph(at.state, at.collider, DT)
    rows = graph.edges["mesh"].edge_count
    assert rows > 3 * at.garments.vertex_count
    with WidestEdgeTensor(rows) as seen:
        model(graph, prepared).sum().backward()
    assert seen.columns == 64
    with WidestEdgeTensor(rows) as of_twin:
        readable_accelerations(model, graph, prepared)
    assert of_twin.columns == 3 * 64


@pytest.mark.parametrize("gradients", [False, True])
def test_bfloat16_weights_answer_in_full_precision_and_stay_close(gradients):
    exact = model_of(TINY, dtype=torch.float32)
    rounded = exact.for_inference(torch.bfloat16)
    at = moment([sheet(9, 12)])
    with torch.set_grad_enabled(gradients):
        expected = accelerations(exact, at, dtype=torch.float32).detach()
        found = accelerations(rounded, at, dtype=torch.float32).detach()
    assert found.dtype == torch.float32
    assert 0 < float((found - expected).norm() / expected.norm()) < 0.02
    assert {p.dtype for p in exact.parameters()} == {torch.float32}, "the model it was made from is left as it was"


def test_the_paper_size_model_has_about_four_million_parameters():
    """4.00 M, as counted from the released code (reference, section 0), its 0.25 M unused ones left out.

    An MLP of two hidden layers, 128 wide, with a LayerNorm has 128 n + 33,408 parameters for n inputs. Encoders of
    20, 11 and 9 inputs 105,344; f_m of 3 x 128 82,560 (its LayerNorm acts on the sum); f_u of 2 x 128 66,176; fifteen
    blocks of three such MLPs of 3 x 128 inputs 3,715,200; the decoder, without LayerNorm, 33,411; the type embedding
    3 x 9 = 27. Together 4,002,718. The released form has one LayerNorm more.
    """

    def count(name: str) -> int:
        return sum(p.numel() for p in NETWORKS[name].network().parameters())

    assert count("pb4u_paper") == 105_344 + 82_560 + 66_176 + 3_715_200 + 33_411 + 27 == 4_002_718
    released = replace(NETWORKS["pb4u_paper"], propagation=RELEASED_PROPAGATION).network()
    assert sum(p.numel() for p in released.parameters()) == count("pb4u_paper") + 256


def test_every_preset_runs_and_uses_all_its_weights():
    at = moment([sheet(6, 7)], dtype=torch.float32)
    for name, configuration in NETWORKS.items():
        if not isinstance(configuration, Pb4uConfiguration):
            continue
        model = AccelerationModel(replace(configuration, width=8, blocks=2).network())
        accelerations(model, at, dtype=torch.float32).square().sum().backward()
        unused = [parameter for parameter, p in model.named_parameters() if p.grad is None]
        assert not unused, (name, unused)


def test_without_a_body_near_it_runs_on_the_garment_alone():
    model = model_of(TINY)
    with_far_body = moment([sheet(6, 7)])
    body = with_far_body.collider
    far = replace(body, now=body.colliders.pose(body.now.positions + 5.0))
    alone = accelerations(model, moment([sheet(6, 7)], body=False))
    assert torch.equal(accelerations(model, replace(with_far_body, collider=far)), alone)
