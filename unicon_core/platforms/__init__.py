"""Platforms: robots and simulators behind recv, send and close, for adapter writers."""
