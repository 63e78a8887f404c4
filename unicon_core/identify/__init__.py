"""Identification: which strength, friction, armature and delay of joints explain a recorded run."""

from unicon_core.identify.fit import fit
from unicon_core.identify.found import Fit, Parameter
from unicon_core.identify.motion import Motion
from unicon_core.identify.overlay import overlay_text

__all__ = ["Fit", "Motion", "Parameter", "fit", "overlay_text"]
