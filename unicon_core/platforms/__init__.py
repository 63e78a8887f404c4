"""Platforms: robots and simulators behind recv, send and close, for adapter writers."""

_SIMULATORS = ("mujoco", "newton", "pybullet", "mjx", "genesis", "isaacgym", "isaaclab", "webots")

BUILTIN = {name: f"unicon_core.platforms.sim.{name}.platform:make" for name in _SIMULATORS} | {
    "isaacsim": "unicon_core.platforms.sim.isaaclab.platform:make",
    "fake": "unicon_core.platforms.fake:make",
    "fake_robot": "unicon_core.platforms.fake:make_robot",
}
"""Name to factory; others register in the entry point group `unicon.platforms`."""
