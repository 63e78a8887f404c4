"""Arms and hands: inverse kinematics, retargeting, teleoperation, as blocks."""
