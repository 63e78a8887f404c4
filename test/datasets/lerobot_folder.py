"""Compare the chunk of our adapter with that of LeRobot's own class, queue and pipelines.

python lerobot_folder.py FOLDER act|diffusion|pictures, with a Python that has lerobot; pictures:
ACT with a camera of 96 x 96 pixels.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.factory import (
    get_policy_class,
    make_policy_config,
    make_pre_post_processors,
)

from unicon_core.policies import load_policy
from unicon_core.policies.chunks import ChildSpec
from unicon_core.policies.networks import open_network
from unicon_core.robots import load_robot

FEATURES = {
    "observation.state": PolicyFeature(FeatureType.STATE, (6,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (3,)),
}
SMALL = {
    "act": {"chunk_size": 12, "n_action_steps": 4, "dim_model": 32, "n_heads": 2},
    "pictures": {"chunk_size": 12, "n_action_steps": 4, "dim_model": 32, "n_heads": 2,
                 "pretrained_backbone_weights": None},
    "diffusion": {"down_dims": (32, 64), "horizon": 8, "n_action_steps": 6,
                  "num_train_timesteps": 5},
}  # fmt: skip
FRONT = "observation.images.front"
GIVEN = {
    "period": 0.05,
    "default_joint_pos": [0.0] * 6,
    "stiffness": 50.0,
    "damping": 2.0,
    "observation": {"terms": {"environment_state": {"state": "base_lin_vel"}}},
}


def main() -> None:
    """Write a folder, load it as a policy, and compare."""
    folder, given_kind = Path(sys.argv[1]), sys.argv[2]
    sees, kind = given_kind == "pictures", given_kind.replace("pictures", "act")
    torch.manual_seed(1)
    front = {FRONT: PolicyFeature(FeatureType.VISUAL, (3, 96, 96))} if sees else {}
    config = make_policy_config(
        kind,
        input_features=FEATURES | front,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (6,))},
        device="cpu",
        push_to_hub=False,
        **SMALL[given_kind],
    )
    config.normalization_mapping["ENV"] = NormalizationMode.MEAN_STD
    stats = {
        name: {
            "mean": torch.randn(width),
            "std": torch.rand(width) + 0.5,
            "min": torch.full((width,), -2.0),
            "max": torch.full((width,), 3.0),
        }
        for name, width in (("observation.state", 6), ("observation.environment_state", 3),
                            ("action", 6))
    }  # fmt: skip
    if sees:
        stats[FRONT] = {"mean": torch.rand(3, 1, 1), "std": torch.rand(3, 1, 1) + 0.5}
    policy = get_policy_class(kind)(config).eval()
    before, behind = make_pre_post_processors(config, dataset_stats=stats)
    for each in (policy, before, behind):
        each.save_pretrained(folder)
    if sees:  # as a trained one says, which downloads nothing here
        said = json.loads((folder / "config.json").read_text())
        said["pretrained_backbone_weights"] = "ResNet18_Weights.IMAGENET1K_V1"
        (folder / "config.json").write_text(json.dumps(said))

    contract = load_policy(folder, robot=load_robot("arx_x5"), given=GIVEN)
    network = open_network(replace(contract, child=ChildSpec()))
    frames = config.n_obs_steps
    seen = np.random.default_rng(2).normal(size=(frames, 9)).astype(np.float32)
    (taken, *pictures), (given,) = network.inputs, network.outputs
    assert [(each.name, each.shape) for each in pictures] == [(n, (1, 3, 96, 96)) for n in front]
    pixels = np.random.default_rng(3).integers(0, 256, (96, 96, 3), np.uint8)
    image = torch.from_numpy(pixels).to(torch.float32) / 255.0  # as LeRobot's own loops have it
    image = image.permute(2, 0, 1).contiguous()
    assert taken.shape == (1, frames * 9), taken
    chunk = np.zeros(given.shape, np.float32)
    inputs = {taken.name: seen.reshape(1, -1)} | {
        each.name: image[None].numpy() for each in pictures
    }
    call = network.bind(inputs, {given.name: chunk})
    call()
    again = chunk.copy()
    call()
    np.testing.assert_array_equal(chunk, again)

    policy.reset()
    rows = []
    for frame in seen:  # as a robot's loop does, one frame after the other
        parts = {
            "observation.state": torch.from_numpy(frame[:6]),
            "observation.environment_state": torch.from_numpy(frame[6:]),
        } | dict.fromkeys(front, image)
        policy._queues["action"].clear() if kind == "diffusion" else policy.reset()
        torch.manual_seed(0)
        rows = [behind(policy.select_action(before(dict(parts)))).numpy()]
    while len(rows) < config.n_action_steps and kind == "act":
        rows.append(behind(policy._action_queue.popleft()).numpy())
    while policy.config.type == "diffusion" and policy._queues["action"]:
        rows.append(behind(policy._queues["action"].popleft()).numpy())
    expected = np.concatenate(rows)
    assert len(expected) in (4, 6), expected.shape
    np.testing.assert_allclose(chunk[0, : len(expected)], expected, atol=1e-5)
    print("alike", expected.shape)


if __name__ == "__main__":
    main()
