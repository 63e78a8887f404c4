"""ONNX networks behind a policy, through the optional `onnxruntime`, imported when built."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from unicon_base.arrays import Array
from unicon_base.errors import MissingDependencyError, PolicyError, alternatives, imported, one_line
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.hints import Feed
from unicon_core.policies.networks.onnx_file import Arrays, OnnxFile, Tensor, read_onnx

PROVIDERS = {
    "cpu": ("CPUExecutionProvider", "pip install 'unicon_ros[sim]'"),
    "cuda": ("CUDAExecutionProvider", "pip install onnxruntime-gpu"),
    "tensorrt": ("TensorrtExecutionProvider", "pip install onnxruntime-gpu tensorrt"),
}
"""Word of a contract to onnxruntime's name of the execution provider, and how it is installed."""


_shared: WeakValueDictionary[tuple[Path, str, int], Any] | None = None


def share_sessions() -> None:
    """From now on load each network once in this process, while anybody has it.

    For many programs side by side, whose files do not change meanwhile: the weights stay in the
    cache from one to the next. A session remembers nothing between two calls.
    """
    global _shared
    if _shared is None:
        _shared = WeakValueDictionary()


def load_session(path: Path, provider: str = "cpu", threads: int = 1) -> Any:
    """Return an onnxruntime session.

    One thread: with its default pool onnxruntime spins and takes 66 % of a CPU at 50 Hz against
    1.5 %, at the same latency.

    Args:
        path: the model.
        provider: where it runs, one of `PROVIDERS`. onnxruntime falls back to the CPU with a
            warning; here that is refused, for the whole network and for single nodes.
        threads: that work on one operator.

    Raises:
        MissingDependencyError: onnxruntime is not installed, or lacks the provider.
        PolicyError: onnxruntime cannot load the model, or cannot run it there.
    """
    name, install = PROVIDERS[provider]
    onnxruntime = imported("onnxruntime", f"policy {path.name}", "sim")
    available = onnxruntime.get_available_providers()
    if name not in available:
        there = [word for word, (full, _) in PROVIDERS.items() if full in available]
        raise MissingDependencyError(
            f"policy {path.name}",
            f"onnxruntime with {name} (provider: {provider}; available: {', '.join(there)})",
            install,
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if provider != "cpu":
        options.add_session_config_entry("session.disable_cpu_ep_fallback", "1")
    try:
        session = onnxruntime.InferenceSession(str(path), sess_options=options, providers=[name])
    except Exception as error:  # onnxruntime raises classes of its own, derived from Exception
        reason = one_line(error)[:200]
        where = "" if provider == "cpu" else f" for provider {provider}"
        raise PolicyError(f"{path}: onnxruntime cannot load it{where}: {reason}") from error
    if provider != "cpu" and name not in session.get_providers():
        raise PolicyError(
            f"{path}: provider {provider} does not start on this machine, its driver or libraries "
            f"are missing; install them ({install}), or write provider: cpu"
        )
    return session


class OnnxNetwork:
    """An ONNX model in one onnxruntime session.

    Args:
        path: the model.
        provider: where it runs, one of `PROVIDERS`; its inputs and outputs are in host memory.
        threads: as of `load_session`.

    Attributes:
        file: what the file says of itself.
        inputs, outputs: tensors with names, types and shapes.

    Raises:
        PolicyError: the file or one of its external files is missing or broken.
        MissingDependencyError: onnxruntime is not installed, or lacks the provider.
    """

    def __init__(self, path: Path, provider: str = "cpu", threads: int = 1) -> None:
        self.file: OnnxFile = read_onnx(path)
        if lost := self.file.lost_weights():
            raise PolicyError(f"{path}: its weights {lost}")
        self.inputs, self.outputs = self.file.inputs, self.file.outputs
        key = path.resolve(), provider, threads
        self._session = (_shared and _shared.get(key)) or load_session(path, provider, threads)
        if _shared is not None:
            _shared[key] = self._session

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
        """Return a function that runs the network on these arrays, without copies.

        Args:
            inputs: input name -> contiguous array of the tensor's shape and type.
            outputs: likewise; outputs that are not named are not fetched.
        """
        session = self._session
        binding = session.io_binding()
        for bind, arrays in ((binding.bind_input, inputs), (binding.bind_output, outputs)):
            for name, array in arrays.items():
                bind(name, "cpu", 0, array.dtype.type, list(array.shape), array.ctypes.data)
        keep = (session, binding, dict(inputs), dict(outputs))
        # The Python wrapper costs 2 µs of 15 a call; its inside is private, so it is only used
        # where it is there.
        raw = getattr(getattr(session, "_sess", None), "run_with_iobinding", None)
        inner = getattr(binding, "_iobinding", None)
        private = raw is not None and inner is not None
        call: Any = raw if private else session.run_with_iobinding
        given = (inner, None) if private else (binding,)

        def run(_keep: object = keep) -> None:
            call(*given)

        return run


OBSERVATION = "observation"


def chained_outputs(contract: PolicyContract) -> dict[str, Tensor]:
    """Return the outputs of all networks of a policy; those of earlier ones as `NAME.output`."""
    tensors: dict[str, Tensor] = {}
    for part in contract.parts:
        tensors |= _named(part.name, read_onnx(part.model).outputs)
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
        self._name, provider, threads = contract.name, contract.provider, contract.threads
        self._parts = [
            (part.name, OnnxNetwork(part.model, provider, threads), part.feeds)
            for part in contract.parts
        ]
        made: dict[str, Tensor] = {}
        inputs: list[Tensor] = []
        self._width = 0
        for name, network, feeds in self._parts:
            known = [tensor.name for tensor in network.inputs]
            for fed in feeds:
                if fed not in known:
                    what = f"network {name!r}" if name else "the network of the action"
                    raise self._fail(f"{what} has no input {fed!r}; {alternatives(fed, known)}")
            for fed, tensor in zip(known, _named(name, network.inputs).values()):
                if fed in feeds:
                    self._check(tensor, feeds[fed], made)
                else:
                    inputs.append(tensor)
            made |= _named(name, network.outputs)
        free = all(tensor.free_batch for _, network, _ in self._parts for tensor in network.inputs)
        vector = Tensor(OBSERVATION, "float32", ("batch" if free else 1, self._width))
        self.inputs, self.outputs = (vector, *inputs), (*made.values(),)

    def _fail(self, message: str) -> PolicyError:
        return PolicyError(f"policy {self._name}: {message}")

    def _row(self, tensor: Tensor) -> int:
        """Return how many values of one robot a tensor has."""
        width = tensor.width
        if tensor.dtype != "float32" or not isinstance(width, int):
            raise self._fail(f"feeds: {tensor} is not (batch × width) of float32; export it so")
        return width

    def _check(self, tensor: Tensor, feeds: tuple[Feed, ...], made: Mapping[str, Tensor]) -> None:
        """Refuse parts that do not fill an input; note how wide the observation must be."""
        self._row(tensor)
        total = 0
        for feed in feeds:
            if feed.source not in (OBSERVATION, *made):
                raise self._fail(
                    f"feeds of {tensor.name}: nothing before it is called {feed.source!r}; "
                    f"{alternatives(feed.source, (OBSERVATION, *made))}"
                )
            source = tensor if feed.source == OBSERVATION else made[feed.source]
            width = self._row(source)
            stop = width if feed.stop is None else feed.stop
            if source is tensor:
                self._width = max(self._width, stop)
            elif stop > width:
                raise self._fail(f"feeds of {tensor.name}: {feed} is beyond {source}")
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
        arrays: dict[str, Array] = {**inputs, **outputs}
        wanted = {feed.source for _, _, feeds in self._parts for f in feeds.values() for feed in f}
        steps: list[Callable[[], object]] = []
        for name, network, feeds in self._parts:
            taken, given = {}, {}
            for key, tensor in zip(_named(name, network.inputs), network.inputs):
                if tensor.name not in feeds:
                    taken[tensor.name] = arrays[key]
                    continue
                whole = np.zeros((rows, int(tensor.width)), np.float32)
                taken[tensor.name] = tensor.shaped(whole)
                parts = [
                    arrays[feed.source].reshape(rows, -1)[:, feed.start : feed.stop]
                    for feed in feeds[tensor.name]
                ]
                steps.append(partial(np.concatenate, parts, 1, whole))
            for key, tensor in zip(_named(name, network.outputs), network.outputs):
                if key in wanted and key not in arrays:
                    arrays[key] = np.zeros((rows, int(tensor.width)), np.float32)
                if key in arrays:
                    given[tensor.name] = tensor.shaped(arrays[key])
            steps.append(network.bind(taken, given))

        def run() -> None:
            for step in steps:
                step()

        return run


def _named(name: str, tensors: Iterable[Tensor]) -> dict[str, Tensor]:
    """Return the tensors of a network by the names that they have among several."""
    named = ((f"{name}.{each.name}" if name else each.name, each) for each in tensors)
    return {key: replace(each, name=key) for key, each in named}
