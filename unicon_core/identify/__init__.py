"""Identification: which strength, friction, armature and delay of joints explain a recorded run."""

from unicon_core.identify.fit import fit
from unicon_core.identify.found import Fit, Parameter, overlay_text
from unicon_core.identify.motion import Motion

__all__ = ["Fit", "Motion", "Parameter", "fit", "overlay_text"]
