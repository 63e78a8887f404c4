"""Newton, of NVIDIA and others under the Linux Foundation: MuJoCo's physics behind its own model."""
