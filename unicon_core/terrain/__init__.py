"""Terrain: ground that is not flat, as words with physical units and as boxes and heights."""
