"""Parameters by the forces along a measured motion; nothing is simulated."""
