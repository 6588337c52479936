"""Path of the scripts that these tests share with `tests/chaos`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "chaos"))
