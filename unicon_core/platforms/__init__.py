"""Platforms: robots and simulators behind recv, send and close, for adapter writers."""

BUILTIN = {
    "mujoco": "unicon_core.platforms.mujoco.platform:make",
    "fake": "unicon_core.platforms.fake:make",
    "fake_robot": "unicon_core.platforms.fake:make_robot",
}
"""Name to factory; others register in the entry point group `unicon.platforms`."""
