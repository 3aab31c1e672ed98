"""Records of experiments: their contents, their sources, how they are read and checked."""
