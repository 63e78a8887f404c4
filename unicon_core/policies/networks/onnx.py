"""ONNX networks behind a policy, through the optional `onnxruntime`, imported when built."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from unicon_base.errors import MissingDependencyError, PolicyError, imported, one_line
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.network import Arrays
from unicon_core.policies.networks.onnx_file import OnnxFile, read_onnx

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


def session_of(path: Path, provider: str, threads: int) -> Any:
    """Return a session, where they are shared the one that is there; see `load_session`."""
    if _shared is None:
        return load_session(path, provider, threads)
    key = path.resolve(), provider, threads
    session = _shared.get(key)
    if session is None:
        session = _shared[key] = load_session(path, provider, threads)
    return session


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


def threads_of(contract: PolicyContract) -> int:
    """Return how many threads a policy's networks have: one in the process of the ticks."""
    return 1 if contract.child is None else contract.child.threads


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
        self._session = session_of(path, provider, threads)

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
        if raw is not None and inner is not None:

            def run(_keep: object = keep) -> None:
                raw(inner, None)

        else:

            def run(_keep: object = keep) -> None:
                session.run_with_iobinding(binding)

        return run
