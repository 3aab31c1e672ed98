"""Operations on plain sampled signals: time bases, velocities, transients, windows."""
