"""The kinds of networks that a checkpoint may hold, and networks by name."""

from __future__ import annotations

from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.registry import Registry

CONFIGURATIONS: Registry[type[NetworkConfiguration]] = Registry(
    "network configuration", {Pb4uConfiguration.__name__: Pb4uConfiguration}
)
"""Name of a type -> the type; checkpoints name it in their header."""

NETWORKS: Registry[NetworkConfiguration] = Registry("network preset")
"""Every network that can be trained by name."""
