"""TorchScript networks behind a policy, through the optional `torch`, imported when built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PolicyError, imported
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.network import Tensor
from unicon_core.policies.networks.torch_memory import TorchMemory


class TorchNetwork:
    """A TorchScript module that takes one tensor and returns one.

    What it remembers from call to call in its buffers, as exporters of recurrent policies have it,
    goes on with ticks only: not when it is tried, not in warm-ups.

    A TorchScript file says nothing of its sizes: the input is called `observation`, the output
    `action`, and a wrong size shows when the network is tried once at build.

    Args:
        contract: the policy.

    Raises:
        MissingDependencyError: torch is not installed.
        PolicyError: torch cannot load the file.
    """

    def __init__(self, contract: PolicyContract) -> None:
        torch = imported("torch", f"policy {contract.name} (TorchScript)", "torch")
        if contract.recurrent:
            raise PolicyError(
                f"policy {contract.name}: recurrent tensors cannot be named in TorchScript; "
                "export it as ONNX"
            )
        self._torch = torch
        torch.set_num_threads(1 if contract.child is None else contract.child.threads)
        try:
            self._module = torch.jit.load(str(contract.model), map_location="cpu").eval()
        except (RuntimeError, ValueError) as error:
            reason = " ".join(str(error).split())[:200]
            raise PolicyError(f"{contract.model}: torch cannot load it: {reason}") from error
        self._label = f"policy {contract.name}"
        if hasattr(self._module, "reset_memory"):  # exporters of recurrent policies have it
            try:
                with torch.inference_mode():
                    self._module.reset_memory()
            except RuntimeError as error:
                reason = " ".join(str(error).split())[:200]
                raise PolicyError(
                    f"{contract.model}: its reset_memory does not run without arguments: {reason}"
                ) from error
        self._memory = TorchMemory(torch, self._module)
        self.inputs = tuple(Tensor(name, "float32", ("", "")) for name in contract.inputs.values())
        self.outputs = tuple(
            Tensor(name, "float32", ("", "")) for name in contract.outputs.values()
        )

    def bind(
        self, inputs: Mapping[str, NDArray[Any]], outputs: Mapping[str, NDArray[Any]]
    ) -> Callable[[], None]:
        """Return a function that runs the module on these arrays; it is tried once.

        Raises:
            PolicyError: the module does not take the input, or gives another size, or remembers
                and shall drive several robots.
        """
        torch, module = self._torch, self._module
        memory = self._memory.share() if self._memory.names else None
        rows = max((len(array) for array in inputs.values()), default=1)
        if memory is not None and rows > 1:
            raise PolicyError(
                f"{self._label}: it is recurrent ({', '.join(memory.names)}) and can drive one "
                f"robot, not num_robots {rows}; run one workflow for each robot"
            )
        tensors = [torch.from_numpy(array) for array in inputs.values()]
        targets = [torch.from_numpy(array) for array in outputs.values()]

        def run() -> None:
            with torch.inference_mode():
                if memory is not None:
                    memory.recall()
                result = module(*tensors)
                results = result if isinstance(result, (tuple, list)) else (result,)
                for target, value in zip(targets, results):
                    target.copy_(value)

        before = [np.array(array) for array in outputs.values()]
        try:
            run()
        except RuntimeError as error:
            sizes = ", ".join(str(tuple(array.shape)) for array in inputs.values())
            reason = " ".join(str(error).split())[-160:]
            raise PolicyError(
                f"{self._label}: the TorchScript network does not run with input {sizes} "
                f"(observation.terms) and {len(before[0][0])} joints: {reason}"
            ) from error
        for array, value in zip(outputs.values(), before):
            array[...] = value
        return run if memory is None else _Remembering(run, memory)


class _Remembering:
    """A bound module and what it remembers."""

    def __init__(self, run: Callable[[], None], memory: TorchMemory) -> None:
        self._run = run
        self.commit, self.reset = memory.commit, memory.reset
        self.save, self.load = memory.save, memory.load

    def __call__(self) -> None:
        self._run()
