"""Stop for motors that are too hot or in error, and for an empty battery: `hardware_stop`."""

from __future__ import annotations

from typing import Annotated, Any

from unicon_core.blocks.safety.ranges import RangeStop
from unicon_core.errors import WorkflowError
from unicon_core.schema.marks import Within, positive
from unicon_core.states.standard import HARDWARE_STATES
from unicon_core.workflow.autowire import BuildContext

HOTTEST = 150.0
"""In [°C]: magnets and windings of class F end there."""
COLDEST = -40.0
"""In [°C]: a sensor that tells less is broken."""
HIGHEST_VOLTAGE = 1000.0
"""In [V]: legged robots have 20 to 60."""


def hardware_stop(
    context: BuildContext,
    *,
    temperature: Annotated[float, positive(HOTTEST, "°C")] = 90.0,
    charge: Annotated[float, Within(0.0, 1.0)] = 0.05,
    voltage: Annotated[float | None, positive(HIGHEST_VOLTAGE, "V")] = None,
) -> RangeStop:
    """Stop where a motor is too hot or tells an error, or where the battery is empty.

    It looks at those of the hardware states that the platform writes: `motor_temperature`,
    `motor_error`, `battery_charge` and, where a bound is given, `battery_voltage`.

    Args:
        temperature: highest of a motor in [°C].
        charge: lowest of the battery, as a share of 1.
        voltage: lowest of the battery in [V]; None does not look.

    Raises:
        WorkflowError: the platform tells nothing of this.
    """
    bounds: dict[str, tuple[Any, Any]] = {
        "motor_temperature": (COLDEST, temperature),
        "motor_error": (0, 0),
        "battery_charge": (charge, 1.0),
    }
    if voltage is not None:
        bounds["battery_voltage"] = (voltage, HIGHEST_VOLTAGE)
    states, platform = context.states, context.platform
    told = HARDWARE_STATES if platform is None else platform.facts.writes
    seen = {name: pair for name, pair in bounds.items() if name in states and name in told}
    if not seen:
        raise WorkflowError("the platform tells nothing of motors and battery; leave it out")
    return RangeStop(states, context.robot, seen, "allowed are")
