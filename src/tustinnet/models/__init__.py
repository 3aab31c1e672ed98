"""Models of mechanical systems: the next state for a state and an input."""
