"""What the tests of diagnoses share: helpers beside them, and the policy tests' small networks."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parent / "policies")]
