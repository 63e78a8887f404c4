"""What an operator's head and hands command: targets of the robot's end effectors."""
