"""PyBullet as a platform: the robot's model goes to it as a URDF."""
