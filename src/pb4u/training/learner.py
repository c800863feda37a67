"""Weights in training, with their moving averages and Adam's moments: updated, saved and restored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from pb4u.errors import InputError
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.distribution import Workers


class MovingAverage:
    """Moving average of weights, which varies less than the weights of one step; over a shorter time in the first
    steps.

    Args:
        module: module whose parameters are averaged.
        decay: share of the average that remains after a step.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.values: dict[str, Tensor] = {name: p.detach().clone() for name, p in module.named_parameters()}

    @torch.no_grad()
    def update(self, module: nn.Module, step: int) -> None:
        """Add the parameters after an optimiser step to the average.

        Args:
            module: with the parameters.
            step: number of the step, from 1.
        """
        decay = min(self.decay, (1.0 + step) / (10.0 + step))
        parameters = dict(module.named_parameters())
        torch._foreach_lerp_(list(self.values.values()), [parameters[name] for name in self.values], 1.0 - decay)

    @torch.no_grad()
    def swap(self, module: nn.Module) -> None:
        """Exchange the parameters of `module` with the averaged ones; a second call undoes the first.

        Args:
            module: with the same parameters.
        """
        for name, parameter in module.named_parameters():
            values = parameter.detach().clone()
            parameter.copy_(self.values[name])
            self.values[name].copy_(values)


class Learner:
    """A model in training.

    Args:
        configuration: the network, its seed and how it is trained.
        workers: this process and the others.

    Attributes:
        model: the network between its normalisers.
        network: called instead of the model, so that gradients are averaged over processes.
    """

    def __init__(self, configuration: TrainingConfiguration, workers: Workers) -> None:
        torch.manual_seed(configuration.seed)
        self.model = AccelerationModel(configuration.network.network()).to(workers.device)
        self.network = workers.distributed(self.model)
        self.optimiser = torch.optim.Adam(
            self.model.parameters(), lr=configuration.curriculum.learning_rate, fused=True
        )
        self.average = MovingAverage(self.model, configuration.ema_decay)
        self.max_gradient_norm = configuration.gradient_norm

    def begin_with(self, weights: Mapping[str, Tensor]) -> None:
        """Load weights and statistics, each (...) as in the model, by name; the average starts with them too.

        Args:
            weights: weights by name.
        """
        self.model.load_state_dict(weights)
        self.average = MovingAverage(self.model, self.average.decay)

    def gradient(self, loss: Tensor) -> Tensor:
        """Compute the gradient of `loss`, a scalar [J], and clip its norm; returns the norm () before clipping.

        Args:
            loss: () [J].
        """
        self.optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        return torch.nn.utils.clip_grad_norm_(self.model.parameters(), self.max_gradient_norm)

    def step(self, rate: float, number: int, unless: Tensor | None = None) -> None:
        """Take an optimiser step.

        Args:
            rate: learning rate.
            number: number of the step, from 1.
            unless: () float32; if it is 1 and not 0, weights and moments do not change.
        """
        # As a gradient scaler names it: the step is skipped by the kernel, and no processor waits to decide.
        self.optimiser.found_inf = unless  # type: ignore[attr-defined]
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.optimiser.step()
        self.average.update(self.model, number)

    @contextmanager
    def averaged(self) -> Iterator[None]:
        """Context in which the model has its averaged weights instead of the latest ones."""
        self.average.swap(self.model)
        try:
            yield
        finally:
            self.average.swap(self.model)

    def state(self, exact: bool = True) -> dict[str, Tensor]:
        """Copies of weights, statistics, averaged weights and moments, each (...) and its unit as in the model.

        Args:
            exact: keep moments in full precision; otherwise they are rounded to bfloat16: it has the range of float32,
                and 8 bits of a mean gradient, and of the root of a mean square, are precise enough.
        """
        tensors = {f"model/{name}": value.clone() for name, value in self.model.state_dict().items()}
        tensors |= {f"average/{name}": value.clone() for name, value in self.average.values.items()}
        for name, parameter in self.model.named_parameters():
            state = self.optimiser.state.get(parameter)
            if not state:
                continue
            tensors[f"taken/{name}"] = state["step"].clone()
            if exact:
                tensors[f"mean/{name}"] = state["exp_avg"].clone()
                tensors[f"square/{name}"] = state["exp_avg_sq"].clone()
            else:
                tensors[f"mean/{name}"] = state["exp_avg"].to(torch.bfloat16)
                tensors[f"root/{name}"] = state["exp_avg_sq"].sqrt().to(torch.bfloat16)
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Restore the state that `state` gave.

        Args:
            tensors: (...) each as in the model, by name, in the unit of the original.

        Raises:
            InputError: they are of another network.
        """
        parts: dict[str, dict[str, Tensor]] = {
            part: {} for part in ("model", "average", "taken", "mean", "square", "root")
        }
        for key, value in tensors.items():
            part, _, name = key.partition("/")
            parts.setdefault(part, {})[name] = value
        try:
            self.model.load_state_dict(parts["model"])
            for name, value in self.average.values.items():
                value.copy_(parts["average"][name])
        except (RuntimeError, KeyError) as error:
            raise InputError("The checkpoint is of another network than the configuration beside it.") from error
        for name, parameter in self.model.named_parameters():
            self.optimiser.state.pop(parameter, None)
            if name in parts["mean"]:
                square = parts["square"].get(name)
                if square is None:
                    square = parts["root"][name].to(parameter).square()
                self.optimiser.state[parameter] = {
                    "step": parts["taken"][name].to(parameter.device, copy=True),
                    "exp_avg": parts["mean"][name].to(parameter, copy=True),
                    "exp_avg_sq": square.to(parameter, copy=True),
                }
