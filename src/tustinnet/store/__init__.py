"""Everything that is kept on disk: model files, checkpoints, run folders, simulations, logs."""
