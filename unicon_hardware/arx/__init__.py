"""ARX arms: EC and DM motors on a CAN bus of 1 Mbit/s."""
