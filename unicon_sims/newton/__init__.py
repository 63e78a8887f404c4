"""Newton as a platform: the robot's model is built in it link by link."""
