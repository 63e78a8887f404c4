"""Several networks as one: an encoder or estimator feeds the network that gives the action.

All run in the same tick, in the order of the contract, on arrays that are laid out once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from unicon_base.arrays import Array
from unicon_base.errors import PolicyError, alternatives
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.hints import Feed
from unicon_core.policies.networks.network import Arrays, Tensor
from unicon_core.policies.networks.onnx import OnnxNetwork, threads_of
from unicon_core.policies.networks.onnx_file import read_onnx

OBSERVATION = "observation"


def chained_outputs(contract: PolicyContract) -> dict[str, Tensor]:
    """Return the outputs of all networks of a policy; those of earlier ones as `NAME.output`."""
    tensors = {tensor.name: tensor for tensor in read_onnx(contract.model).outputs}
    for part in contract.networks:
        for tensor in read_onnx(part.model).outputs:
            tensors[f"{part.name}.{tensor.name}"] = _named(part.name, tensor)
    return tensors


class ChainedNetworks:
    """The networks of one policy behind the interface of one.

    Tensors of the network that gives the action keep their names; those of the others are called
    `NAME.tensor`. The input `observation` is the vector of the contract's terms.

    Args:
        contract: the policy, which has `networks`.

    Attributes:
        inputs: `observation`, and the inputs that nothing inside feeds.
        outputs: of all networks.

    Raises:
        PolicyError: a file is missing or broken, or a feed names no tensor, one of a later
            network, or parts that do not have the input's width.
        MissingDependencyError: onnxruntime is not installed, or lacks the provider.
    """

    def __init__(self, contract: PolicyContract) -> None:
        self._name, provider = contract.name, contract.provider
        threads = threads_of(contract)
        parts: list[tuple[str, Path, Mapping[str, tuple[Feed, ...]]]] = [
            *((part.name, part.model, part.feeds) for part in contract.networks),
            ("", contract.model, contract.feeds),
        ]
        self._parts = [(n, OnnxNetwork(path, provider, threads), feeds) for n, path, feeds in parts]
        made: dict[str, Tensor] = {}
        inputs: list[Tensor] = []
        self._width = 0
        for name, network, feeds in self._parts:
            known = [tensor.name for tensor in network.inputs]
            for fed in feeds:
                if fed not in known:
                    what = f"network {name!r}" if name else "the network of the action"
                    raise self._fail(f"{what} has no input {fed!r}; {alternatives(fed, known)}")
            for tensor in network.inputs:
                if tensor.name in feeds:
                    self._check(_named(name, tensor), feeds[tensor.name], made)
                else:
                    inputs.append(_named(name, tensor))
            for tensor in network.outputs:
                named = _named(name, tensor)
                made[named.name] = named
        free = all(tensor.free_batch for _, network, _ in self._parts for tensor in network.inputs)
        vector = Tensor(OBSERVATION, "float32", ("batch" if free else 1, self._width))
        self.inputs = (vector, *inputs)
        self.outputs = tuple(made.values())

    def _fail(self, message: str) -> PolicyError:
        return PolicyError(f"policy {self._name}: {message}")

    def _row(self, tensor: Tensor) -> int:
        """Return the width of a tensor that is (batch, width)."""
        width = tensor.width
        if tensor.dtype != "float32" or len(tensor.shape) != 2 or not isinstance(width, int):
            raise self._fail(f"feeds: {tensor} is not (batch × width) of float32; export it so")
        return width

    def _check(self, tensor: Tensor, feeds: tuple[Feed, ...], made: Mapping[str, Tensor]) -> None:
        """Refuse parts that do not fill an input; note how wide the observation must be."""
        self._row(tensor)
        total = 0
        for feed in feeds:
            if feed.source == OBSERVATION:
                stop = self._row(tensor) if feed.stop is None else feed.stop
                self._width = max(self._width, stop)
            elif feed.source in made:
                source = made[feed.source]
                width = self._row(source)
                stop = width if feed.stop is None else feed.stop
                if stop > width:
                    raise self._fail(f"feeds of {tensor.name}: {feed} is beyond {source}")
            else:
                known = (OBSERVATION, *made)
                raise self._fail(
                    f"feeds of {tensor.name}: nothing before it is called {feed.source!r}; "
                    f"{alternatives(feed.source, known)}"
                )
            total += stop - feed.start
        if total != tensor.width:
            listed = " + ".join(map(str, feeds))
            raise self._fail(
                f"feeds: {listed} has {total} values and {tensor} takes {tensor.width}"
            )

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
        """Return a function that runs all networks on these arrays, in order.

        Args:
            inputs: input name -> contiguous array; `observation` of shape (rows, size).
            outputs: likewise; outputs that nothing names and nothing inside takes are not fetched.
        """
        rows = len(inputs[OBSERVATION])
        arrays: dict[str, Array] = {OBSERVATION: inputs[OBSERVATION], **outputs}
        wanted = {feed.source for _, _, feeds in self._parts for f in feeds.values() for feed in f}
        steps: list[Callable[[], None]] = []
        for name, network, feeds in self._parts:
            taken, given = {}, {}
            for tensor in network.inputs:
                if tensor.name not in feeds:
                    taken[tensor.name] = inputs[_named(name, tensor).name]
                    continue
                taken[tensor.name] = whole = np.zeros((rows, int(tensor.width)), np.float32)
                start = 0
                for feed in feeds[tensor.name]:
                    source = arrays[feed.source].reshape(rows, -1)[:, feed.start : feed.stop]
                    target = whole[:, start : start + source.shape[1]]
                    start += source.shape[1]
                    steps.append(_copy(source, target))
            for tensor in network.outputs:
                key = _named(name, tensor).name
                if key in wanted and key not in arrays:
                    arrays[key] = np.zeros((rows, int(tensor.width)), np.float32)
                if key in arrays:
                    given[tensor.name] = arrays[key]
            steps.append(network.bind(taken, given))

        def run() -> None:
            for step in steps:
                step()

        return run


def _named(name: str, tensor: Tensor) -> Tensor:
    return Tensor(f"{name}.{tensor.name}", tensor.dtype, tensor.shape) if name else tensor


def _copy(source: Array, target: Array) -> Callable[[], None]:
    def copy() -> None:
        target[...] = source

    return copy
