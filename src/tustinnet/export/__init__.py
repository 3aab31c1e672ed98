"""Models outside of the package: a step for control loops."""
