"""Platforms: robots and simulators behind recv, send and close, for adapter writers."""

BUILTIN = {
    "mujoco": "unicon_core.platforms.sim.mujoco.platform:make",
    "fake": "unicon_core.platforms.fake:make",
}
"""Name to factory; others register in the entry point group `unicon.platforms`."""
