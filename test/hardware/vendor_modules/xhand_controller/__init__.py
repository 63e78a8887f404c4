"""A stand-in for the module of RobotEra: what it is asked is what the hand would be."""
