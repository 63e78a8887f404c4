"""Stand-in for isaaclab.actuators: actuator_base_cfg.py, actuator_pd_cfg.py."""

from isaaclab.lab import ImplicitActuatorCfg

__all__ = ["ImplicitActuatorCfg"]
