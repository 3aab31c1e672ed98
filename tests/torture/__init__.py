"""A campaign of kills, damaged inputs, faults and load: `make torture`, docs/reliability.md."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # the helpers of the other tests
