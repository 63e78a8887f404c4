"""What an operator holds in his hands: devices, what sticks and buttons command, and modes."""
