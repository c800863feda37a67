"""Weights averaged over the last steps of a training: calmer than those of any one step."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class MovingAverage:
    """An exponential moving average of a module's parameters, faster while the training is young.

    Args:
        module: whose parameters are averaged. decay: share of the average that a step keeps.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.values: dict[str, Tensor] = {name: p.detach().clone() for name, p in module.named_parameters()}

    @torch.no_grad()
    def update(self, module: nn.Module, step: int) -> None:
        """Take in the parameters after optimiser step number `step`, counted from 1."""
        decay = min(self.decay, (1.0 + step) / (10.0 + step))
        for name, parameter in module.named_parameters():
            self.values[name].lerp_(parameter, 1.0 - decay)

    @torch.no_grad()
    def swap(self, module: nn.Module) -> None:
        """Exchange the module's parameters with the averaged ones; called twice, nothing has changed."""
        for name, parameter in module.named_parameters():
            own = parameter.detach().clone()
            parameter.copy_(self.values[name])
            self.values[name].copy_(own)
