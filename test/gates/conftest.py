"""Makes the robots of these tests importable, by workflows too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
