"""Parameters of a system by the simulation error (multiple shooting), and what to trust of them."""
