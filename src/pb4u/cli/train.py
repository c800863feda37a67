"""`pb4u train`: a network from the physics alone, in a folder that it can always go on from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pb4u.cli.console import JsonFlag, check_json_target, keep_inputs, tell, verb
from pb4u.cli.record_flags import given_values, record_flags
from pb4u.training.request import TrainingRequest


@verb(request=record_flags(TrainingRequest))
def train(*, request: Mapping[str, Any], json: JsonFlag = None) -> None:
    """Train a network. After a kill, --resume continues from the last checkpoint; an interrupt saves and ends."""
    from pb4u.training.session import train as run

    check_json_target(json)
    training = TrainingRequest(**given_values(TrainingRequest, request))
    keep_inputs([training.pack, training.weights], [("--json", json)])
    result = run(training)
    tell(result, json, result["sentence"] + (f" Weights: {result['weights']}" if result["weights"] else ""))
