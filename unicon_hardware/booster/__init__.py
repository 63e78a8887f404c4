"""Booster's T1 over DDS."""
