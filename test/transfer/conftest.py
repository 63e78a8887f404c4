"""Makes the simulators of these tests importable, here and in the processes of the runs."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
