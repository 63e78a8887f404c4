"""Platforms: robots and simulators behind recv, send and close, for adapter writers."""

BUILTIN = {
    "mujoco": "unicon_core.platforms.sim.mujoco.platform:make",
    "newton": "unicon_core.platforms.sim.newton.platform:make",
    "pybullet": "unicon_core.platforms.sim.pybullet.platform:make",
    "mjx": "unicon_core.platforms.sim.mjx.platform:make",
    "genesis": "unicon_core.platforms.sim.genesis.platform:make",
    "isaacgym": "unicon_core.platforms.sim.isaacgym.platform:make",
    "isaaclab": "unicon_core.platforms.sim.isaaclab.platform:make",
    "isaacsim": "unicon_core.platforms.sim.isaaclab.platform:make",
    "webots": "unicon_core.platforms.sim.webots.platform:make",
    "fake": "unicon_core.platforms.fake:make",
    "fake_robot": "unicon_core.platforms.fake:make_robot",
}
"""Name to factory; others register in the entry point group `unicon.platforms`."""
