"""Physical systems: one file each with coordinates, energies, nominal values and ranges."""
