"""Blocks for robots that work with their hands while they walk: frames, gravity, moving targets."""
