"""The preflight twin: a workflow in MuJoCo before it meets the robot."""
