"""Webots as a platform: unicon is the extern controller; never run against Webots itself."""
