"""The scripts of benchmarks/ are imported as modules; processes that they start find them, too."""

from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'benchmarks'))
