"""Tests that every simulator must pass, for pytest: of names, signs, units, frames, servos, seeds.

# test_my_simulator.py
from unicon_core.conformance import Conformance

class TestMySimulator(Conformance):
    platform = "my_package.simulator:make"
"""

from unicon_core.conformance.contract import Contract
from unicon_core.conformance.mechanics import Mechanics
from unicon_core.conformance.rig import Case, Rig

__all__ = ["Case", "Conformance", "Contract", "Mechanics", "Rig"]


class Conformance(Contract, Mechanics):
    """All of them; a subclass names its `platform`."""
