"""Unitree's A1, Aliengo and Go1 over UDP, as unitree_legged_sdk speaks to them."""
