"""Identification: which strength, friction, armature and delay of joints explain a recorded run."""
