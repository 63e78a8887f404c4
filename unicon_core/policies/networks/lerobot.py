"""Policies that LeRobot trained, run by its own classes; its package is imported when one is built.

`pip install 'unicon_ros[lerobot-policies]'`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from unicon_base.errors import PolicyError, imported, one_line
from unicon_base.located_yaml import read_yaml
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.networks.onnx_file import Arrays, Tensor

EXTRA = "lerobot-policies"
_STEPS = ("policy_preprocessor.json", "policy_postprocessor.json")


class LerobotNetwork:
    """The policy of a folder with LeRobot's pipelines before and behind it.

    Its input is the frames of all features, the oldest first, shape (1, frames · width); its output
    `action` a chunk in the units of the training data, shape (1, H, m). Each call draws the same
    noise, so that the answer depends on the observation alone.

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
        torch.set_num_threads(1 if contract.child is None else contract.child.threads)
        device = "cpu" if contract.provider == "cpu" else "cuda"
        for name in _STEPS:  # a step without a registered name is imported from anywhere
            said = read_yaml(folder / name, PolicyError, foreign=True)
            steps = said.value.get("steps") if isinstance(said.value, Mapping) else None
            if not all(isinstance(s, dict) and "registry_name" in s for s in steps or [None]):
                raise said.error(("steps",), "steps: not all are LeRobot's own; none is imported")
        try:
            self._config = config = configs.PreTrainedConfig.from_pretrained(str(folder))
            config.device = device
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
        self._widths = {name: each.shape[0] for name, each in config.input_features.items()}
        width = config.n_obs_steps * sum(self._widths.values())
        shape = (1, contract.chunk.size, config.output_features["action"].shape[0])
        self.inputs: tuple[Tensor, ...] = (Tensor("observation", "float32", (1, width)),)
        self.outputs: tuple[Tensor, ...] = (Tensor("action", "float32", shape),)

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
        """Return a function that runs the policy on these arrays."""
        torch, policy = self._torch, self._policy
        target = torch.from_numpy(outputs["action"])
        frames = torch.from_numpy(inputs["observation"]).reshape(self._config.n_obs_steps, -1)
        parts = dict(zip(self._widths, frames.split(list(self._widths.values()), 1)))

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
