"""Parameters as they were given, and made to fit before rclpy looks at their types."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


def parameters_given(node: Any) -> Mapping[str, Any]:
    """Return the parameters that a node was given at start, by name; none where rclpy hides it."""
    given: Mapping[str, Any] = getattr(node, "_parameter_overrides", {})
    return given


def parameter_given(node: Any, name: str, default: Any) -> Any:
    """Return what was given at start for a parameter that is not declared yet, of any type.

    An empty list has no type in rcl, which hands over a parameter that is not set: that is None.
    """
    from rcl_interfaces.msg import ParameterDescriptor

    if name not in parameters_given(node) and hasattr(node, "_parameter_overrides"):
        return default  # nothing was given, as nearly always
    # Public and of any type: declared, read and taken back.
    descriptor = ParameterDescriptor(dynamic_typing=True)
    value = node.declare_parameter(name, None, descriptor).value
    node.undeclare_parameter(name)
    return default if value is None and not isinstance(default, list) else value


def convert_parameters(node: Any, fitted: Callable[[str, Any], tuple[Any, Any]]) -> bool:
    """Let what is set be made to fit first; False where rclpy cannot (Humble).

    Args:
        node: rclpy node.
        fitted: returns the value for a name and a value, and the number of its type or None where
            rclpy is to guess it.
    """
    from rclpy.parameter import Parameter

    add = getattr(node, "add_pre_set_parameters_callback", None)
    if add is None:
        return False

    def convert(parameters: list[Any]) -> list[Any]:
        made = []
        for parameter in parameters:
            if parameter.type_ == Parameter.Type.NOT_SET:  # to be removed
                made.append(parameter)
                continue
            value, kind = fitted(parameter.name, parameter.value)
            if kind is not None:
                made.append(Parameter(parameter.name, Parameter.Type(kind), value))
            elif value is not parameter.value and type(value) is not type(parameter.value):
                made.append(Parameter(parameter.name, value=value))
            else:
                made.append(parameter)
        return made

    add(convert)
    return True
