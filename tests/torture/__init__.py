"""A campaign of kills, damaged inputs, faults and load: `make torture`.

docs/explanation/reliability.md says what is tried.
"""

import os
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # the helpers of the other tests
# the models in the corpus were made by a compiler set so; another one gives other last bits
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=1")
