"""Largest sizes of models, for recipes and model files: larger ones exhaust memory or time."""

MOST_LAYERS, MOST_UNITS, MOST_STATES = 100, 10_000, 1000
MOST_SUBSTEPS = 10_000  # more would be a period far too long for the system
MOST_UNROLLED = 100  # each is compiled
LONGEST_WARM_UP = 100_000  # samples
MOST_TIMES, LONGEST_TIME = 100, 1e6  # of relaxation; the latter in seconds
MOST_TAPS, FARTHEST_TAP = 100, 1000  # of inputs; the latter in samples
MOST_MEMBERS = 10_000  # of a committee
