"""Units of message fields: one factor per unit, for mappings that meet other conventions than SI.

States are SI throughout (REP-103). A field's `unit` names the **message's** unit, so the factor
below (message units per SI unit) multiplies on publish and divides on subscribe.
"""

from __future__ import annotations

import math

PER_SI: dict[str, float] = {
    # angle, angular velocity
    "rad": 1.0,
    "deg": 180.0 / math.pi,
    "mrad": 1e3,
    "rev": 1.0 / (2.0 * math.pi),
    "rad/s": 1.0,
    "deg/s": 180.0 / math.pi,
    "rpm": 60.0 / (2.0 * math.pi),
    # length, velocity, acceleration
    "m": 1.0,
    "cm": 1e2,
    "mm": 1e3,
    "m/s": 1.0,
    "mm/s": 1e3,
    "km/h": 3.6,
    "m/s^2": 1.0,
    "g": 1.0 / 9.80665,  # standard gravity, 3rd CGPM (1901)
    # force, torque, mass
    "N": 1.0,
    "kN": 1e-3,
    "N*m": 1.0,
    "mN*m": 1e3,
    "kg": 1.0,
    # time
    "s": 1.0,
    "ms": 1e3,
    "us": 1e6,
    "ns": 1e9,
    # electricity, ratio
    "V": 1.0,
    "mV": 1e3,
    "A": 1.0,
    "mA": 1e3,
    "ratio": 1.0,
    "percent": 1e2,
}
