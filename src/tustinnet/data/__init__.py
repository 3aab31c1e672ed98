"""Records of experiments: what they are, how they are read and checked, where they come from."""
