"""TorchScript networks behind a policy, and those that LeRobot trained, run by its own classes.

The optional packages `torch` and LeRobot (`pip install 'unicon_ros[lerobot-policies]'`) are
imported when a network is built.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.errors import PolicyError, imported, one_line
from unicon_base.located_yaml import read_yaml
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.onnx_file import Arrays, Tensor


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
        torch.set_num_threads(contract.threads)
        failed = "torch cannot load it"
        try:
            self._module = torch.jit.load(str(contract.model), map_location="cpu").eval()
            if hasattr(self._module, "reset_memory"):  # exporters of recurrent policies have it
                failed = "its reset_memory does not run without arguments"
                with torch.inference_mode():
                    self._module.reset_memory()
        except (RuntimeError, ValueError) as error:
            raise PolicyError(f"{contract.model}: {failed}: {one_line(error)[:200]}") from error
        self._label = f"policy {contract.name}"
        self._memory = TorchMemory(torch, self._module)
        self.inputs, self.outputs = (
            tuple(
                Tensor(name, "float32", ("", *getattr(contract.images.get(key), "shape", ("",))))
                for key, name in names.items()
            )
            for names in (contract.inputs, contract.outputs)
        )

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
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
                    target.copy_(value.reshape(target.shape))

        before = [np.array(array) for array in outputs.values()]
        try:
            run()
        except RuntimeError as error:
            sizes = ", ".join(str(tuple(array.shape)) for array in inputs.values())
            raise PolicyError(
                f"{self._label}: the TorchScript network does not run with input {sizes} "
                f"(observation.terms) and {len(before[0][0])} joints: {one_line(error)[-160:]}"
            ) from error
        for array, value in zip(outputs.values(), before):
            array[...] = value
        if memory is None:
            return run
        memory.run = run
        return memory


class TorchMemory:
    """The attributes of a module that a call changes, and what they hold between two ticks.

    For networks that are tried and warmed up: exporters of recurrent policies keep the hidden state
    in the module, as buffers that `forward` writes. What it writes stands in its graph: attributes
    that it sets, and tensors that an operation changes in place.

    Several may share a module: each recalls its own before a call.

    Args:
        torch: the package.
        module: a scripted or traced module, as loaded.

    Attributes:
        names: of the attributes, behind those of their submodules.
        run: calls the module, bound to arrays.
    """

    run: Callable[[], None]

    def __init__(self, torch: Any, module: Any) -> None:
        self._torch = torch
        self._in_place: list[tuple[Any, Any, Any]] = []  # of the module, kept, at the beginning
        self._set: list[tuple[Any, str, Any]] = []  # owner, name, at the beginning
        self.names: list[str] = []
        weights = {parameter.data_ptr() for parameter in module.parameters()}
        with torch.inference_mode():
            for path, is_set in sorted(_written(module).items()):
                owner = reduce(getattr, path[:-1], module)
                value = getattr(owner, path[-1])
                is_tensor = isinstance(value, torch.Tensor)
                tensors = [value] if is_tensor else value
                if (
                    isinstance(tensors, list)
                    and tensors
                    and all(
                        hasattr(each, "data_ptr") and each.data_ptr() in weights for each in tensors
                    )
                ):
                    continue  # what only looks as if it were written: the graph cannot tell
                self.names.append(".".join(path))
                if is_set or not is_tensor:
                    self._set.append((owner, path[-1], copy.deepcopy(value)))
                else:
                    self._in_place.append((value, value.clone(), value.clone()))
        self.reset()

    def __call__(self) -> None:
        self.run()

    def share(self) -> TorchMemory:
        """Return another memory of the same module, at its beginning."""
        other = copy.copy(self)
        other._in_place = [(live, first.clone(), first) for live, _, first in self._in_place]
        other.reset()
        return other

    def recall(self) -> None:
        """Give the module what is kept; call it in inference mode."""
        for live, kept, _ in self._in_place:
            live.copy_(kept)
        for (owner, name, _), value in zip(self._set, self._kept):
            setattr(owner, name, copy.deepcopy(value))

    def commit(self) -> None:
        """Keep what the last call left."""
        set_now = [getattr(owner, name) for owner, name, _ in self._set]
        self._keep([live for live, _, _ in self._in_place], set_now)

    def reset(self) -> None:
        """Keep what was there at the beginning."""
        self._keep([first for _, _, first in self._in_place], [first for _, _, first in self._set])

    def _keep(self, in_place: list[Any], values: list[Any]) -> None:
        with self._torch.inference_mode():
            for (_, kept, _), value in zip(self._in_place, in_place):
                kept.copy_(value)
            self._kept = [copy.deepcopy(value) for value in values]

    def save(self) -> Any:
        """Return what is kept, as arrays; `load` takes it back."""
        tensor = self._torch.Tensor

        def plain(value: Any) -> Any:
            return value.detach().cpu().numpy().copy() if isinstance(value, tensor) else value

        return _each([[kept for _, kept, _ in self._in_place], self._kept], plain)

    def load(self, saved: Any) -> None:
        """Keep what another one did."""
        torch = self._torch

        def tensor(value: Any) -> Any:
            return torch.from_numpy(value.copy()) if isinstance(value, np.ndarray) else value

        self._keep(*_each(saved, tensor))


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return lists, tuples and mappings with what a function makes of each value in them."""
    if isinstance(value, (list, tuple)):
        return type(value)(_each(inside, change) for inside in value)
    if isinstance(value, dict):
        return {key: _each(inside, change) for key, inside in value.items()}
    return change(value)


def _written(module: Any) -> dict[tuple[str, ...], bool]:
    """Return the attributes that a call writes, as paths, and whether it sets them."""
    graph = module.inlined_graph
    aliases = graph.alias_db()
    found: dict[tuple[str, ...], bool] = {}
    for node in graph.findAllNodes("prim::GetAttr"):
        value = node.output()
        if value.type().kind() != "ClassType" and aliases.has_writers(value):
            found[_path(node)] = False
    for node in graph.findAllNodes("prim::SetAttr"):
        found[_path(node)] = True
    return found


def _path(node: Any) -> tuple[str, ...]:
    """Return the names that lead to the attribute that a node gets or sets."""
    names = [node.s("name")]
    owner = node.inputsAt(0).node()
    while owner.kind() == "prim::GetAttr":
        names.append(owner.s("name"))
        owner = owner.inputsAt(0).node()
    return tuple(reversed(names))


EXTRA = "lerobot-policies"
_STEPS = ("policy_preprocessor.json", "policy_postprocessor.json")


def lerobot_files(folder: Path) -> list[Path]:
    """Return what LeRobot reads of a folder: configuration, pipelines, network, normalisation.

    Raises:
        PolicyError: the folder has no pipelines.
    """
    files = [folder / name for name in ("config.json", *_STEPS)]
    if lost := [path for path in files if not path.is_file()]:
        raise PolicyError(f"{lost[0]}: no such file; copy the whole folder, as LeRobot saved it")
    return [*files, *sorted(folder.glob("*.safetensors"))]


class LerobotNetwork:
    """The policy of a folder with LeRobot's pipelines before and behind it.

    Its input `observation` is the frames of all features, the oldest first, shape (1, frames ·
    width), but for pictures, which are inputs of their own; its output `action` a chunk in the
    units of the training data, shape (1, H, m). Each call draws the same noise, so that the answer
    depends on the inputs alone.

    Args:
        contract: the policy, read from its folder.

    Raises:
        MissingDependencyError: LeRobot is not installed.
        PolicyError: it cannot load the folder.
    """

    def __init__(self, contract: PolicyContract) -> None:
        what, folder = f"policy {contract.name} (LeRobot)", contract.model.parent
        self._torch = torch = imported("torch", what, EXTRA)
        factory = imported("lerobot.policies.factory", what, EXTRA)
        configs = imported("lerobot.configs.policies", what, EXTRA)
        torch.set_num_threads(contract.threads)
        device = "cpu" if contract.provider == "cpu" else "cuda"
        for name in _STEPS:  # a step without a registered name is imported from anywhere
            said = read_yaml(folder / name, PolicyError, foreign=True)
            steps = said.value.get("steps") if isinstance(said.value, Mapping) else None
            if not all(isinstance(s, dict) and "registry_name" in s for s in steps or [None]):
                raise said.error(("steps",), "steps: not all are LeRobot's own; none is imported")
        try:
            self._config = config = configs.PreTrainedConfig.from_pretrained(str(folder))
            config.device = device
            config.pretrained_backbone_weights = None  # the folder has all weights
            made = factory.get_policy_class(config.type)
            self._policy = made.from_pretrained(str(folder), config=config)
            moved = {"device_processor": {"device": device}}
            self._before, self._behind = factory.make_pre_post_processors(
                config, str(folder), preprocessor_overrides=moved
            )
        except Exception as error:  # of torch, safetensors, draccus
            text = f"{folder}: LeRobot cannot load it: {one_line(error)[:200]}"
            raise PolicyError(text) from error
        assert contract.chunk is not None
        features, pictures = config.input_features, {contract.inputs[n] for n in contract.images}
        self._widths = {n: each.shape[0] for n, each in features.items() if n not in pictures}
        width = config.n_obs_steps * sum(self._widths.values())
        shape = (1, contract.chunk.size, config.output_features["action"].shape[0])
        self.inputs: tuple[Tensor, ...] = (
            Tensor("observation", "float32", (1, width)),
            *(Tensor(n, "float32", (1, *features[n].shape)) for n in features if n in pictures),
        )
        self.outputs: tuple[Tensor, ...] = (Tensor("action", "float32", shape),)

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
        """Return a function that runs the policy on these arrays."""
        torch, policy = self._torch, self._policy
        target = torch.from_numpy(outputs["action"])
        frames = torch.from_numpy(inputs["observation"]).reshape(self._config.n_obs_steps, -1)
        parts = {name: torch.from_numpy(array) for name, array in inputs.items()}
        parts |= dict(zip(self._widths, frames.split(list(self._widths.values()), 1)))
        del parts["observation"]

        def chunk() -> Any:
            seen = self._before(dict(parts))
            if self._config.type == "diffusion":  # its own chunk is of the frames that it queued
                return policy.diffusion.generate_actions({name: seen[name][None] for name in parts})
            return policy.predict_action_chunk(seen)

        def run() -> None:
            torch.manual_seed(0)
            with torch.inference_mode():
                target.copy_(self._behind(chunk()))

        return run
