"""One process or several, each with its share of every batch; the model knows nothing of it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
import torch.distributed as torch_distributed
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from pb4u.errors import InputError
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.simulation.models import available_device

_PATIENCE = timedelta(days=1)
"""How long processes wait for another: while the leading one makes data or validates, the others do nothing."""


@dataclass(frozen=True)
class Workers:
    """The processes of a training.

    Args:
        rank: number of this process, from 0.
        count: number of processes.
        device: device that this process computes on.
    """

    rank: int
    count: int
    device: torch.device

    @property
    def leads(self) -> bool:
        """Whether this process writes files and reports."""
        return self.rank == 0

    def share(self, batch: int) -> slice:
        """Samples of a `batch` for this process.

        Args:
            batch: number of samples in all processes together.

        Raises:
            InputError: it cannot be divided.
        """
        if batch % self.count:
            raise InputError(f"A batch of {batch} cannot be shared by {self.count} processes; set batch to a multiple.")
        size = batch // self.count
        return slice(self.rank * size, (self.rank + 1) * size)

    def distributed(self, model: nn.Module) -> nn.Module:
        """Wrapper of `model` that averages gradients over processes; unused parameters count as zero.

        Args:
            model: the network.
        """
        if self.count == 1:
            return model
        return DistributedDataParallel(model, broadcast_buffers=False, find_unused_parameters=True)

    def mean(self, values: Tensor) -> Tensor:
        """Mean (...) of `values` (...) over processes, in their unit.

        Args:
            values: (...) of this process.
        """
        return self.sum(values) / self.count

    def sum(self, values: Tensor) -> Tensor:
        """Sum (...) of `values` (...) over processes, in their unit.

        Args:
            values: (...) of this process.
        """
        if self.count > 1:
            values = values.clone()
            torch_distributed.all_reduce(values)
        return values

    def agreed(self, flag: bool) -> bool:
        """Whether `flag` is set in any process; all processes get the same answer.

        Args:
            flag: of this process.
        """
        return self.total(float(flag)) > 0.0

    def total(self, value: float) -> float:
        """Sum of `value` over processes, in its unit; a single process copies nothing.

        Args:
            value: of this process.
        """
        if self.count == 1:
            return value
        # Processors agree among themselves, while their cards go on.
        return float(self.sum(torch.tensor(value, dtype=torch.float64)))

    def reduce_statistics(self, model: AccelerationModel) -> None:
        """Give every process the statistics that all have gathered.

        Args:
            model: its normalisers are changed.
        """
        for normaliser in model.normalisers():
            normaliser.sums.copy_(self.sum(normaliser.sums))
            normaliser.refresh()


@contextmanager
def workers(device: str = "auto") -> Iterator[Workers]:
    """Processes that `torchrun` started, or this one alone.

    Args:
        device: "auto", "cpu" or "cuda".

    Raises:
        InputError: an accelerator is requested and absent, or there are fewer cards than processes.
    """
    if device not in ("auto", "cpu", "cuda"):
        raise InputError(
            f"The device must be auto, cpu or cuda, not {device!r}; of several cards the first in "
            "CUDA_VISIBLE_DEVICES is used, and torchrun gives each process its own."
        )
    accelerated = available_device(device) == "cuda"
    count = int(os.environ.get("WORLD_SIZE", "1"))
    rank = int(os.environ.get("RANK", "0"))
    place = torch.device("cpu")
    if accelerated:
        place = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
        if place.index >= torch.cuda.device_count():
            raise InputError(
                f"There are {torch.cuda.device_count()} cards here and none is left for process {place.index + 1}; "
                "start as many processes as there are cards, with --nproc-per-node."
            )
        torch.cuda.set_device(place)
    if count > 1:
        torch_distributed.init_process_group("cpu:gloo,cuda:nccl" if accelerated else "gloo", timeout=_PATIENCE)
    try:
        yield Workers(rank, count, place)
    finally:
        if count > 1:
            torch_distributed.destroy_process_group()
