"""Isaac Gym Preview 4 as a platform, never run against NVIDIA's own module."""
