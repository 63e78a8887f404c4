"""Builds a platform as the workflow does: keys of the scene go there, the rest to the engine."""

from __future__ import annotations

from unicon_core.platforms.kit.disturbances import disturb
from unicon_core.platforms.kit.scene import SCENE_KEYS, Scene


def in_scene(make, states, robot, period, **options):
    """Return the platform in its scene."""
    scene = Scene(**{key: options.pop(key) for key in SCENE_KEYS if key in options})
    platform = make(states, robot, period, scene=scene, **options)
    return disturb(platform, scene, states, robot, period)
