"""Unitree's robots over DDS: Go2 and H1 (`unitree_go`), G1 and H1-2 (`unitree_hg`)."""
