"""Joint trajectories: points in time, what is refused of them, and who plays one; no ROS here."""
