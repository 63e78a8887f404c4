"""Makes the helpers of these tests and of those of records importable."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parent / "record"), str(HERE.parent / "attack")]
