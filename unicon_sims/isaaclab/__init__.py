"""Isaac Lab, and with it Isaac Sim, as a platform, never run against NVIDIA's own modules."""
