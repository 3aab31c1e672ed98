"""Machine code for programs: simulations with derivatives, several records side by side."""
