"""Networks: what loads and runs the network of a policy, one module for each runtime."""

from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.onnx import ChainedNetworks, OnnxNetwork
from unicon_core.policies.networks.onnx_file import Network, Remembering, Tensor
from unicon_core.policies.networks.torch import LerobotNetwork, TorchNetwork

__all__ = ["Network", "OnnxNetwork", "Remembering", "Tensor", "TorchNetwork", "open_network"]


def open_network(contract: PolicyContract) -> Network:
    """Load the network of a policy in the runtime that its file is for.

    Raises:
        PolicyError: its file is missing or broken.
        MissingDependencyError: that runtime is not installed.
    """
    if contract.is_torchscript:
        return TorchNetwork(contract)
    if contract.is_lerobot:
        return LerobotNetwork(contract)
    if contract.networks:
        return ChainedNetworks(contract)
    return OnnxNetwork(contract.model, contract.provider, contract.threads)
