"""Controllers in forms that run without this package: C, gains, scripts of solvers."""
