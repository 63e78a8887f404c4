"""Retargeting: a human hand's fingers brought to a robot hand's joints, for block `retarget`."""
