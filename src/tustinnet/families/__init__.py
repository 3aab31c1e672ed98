"""Families of models: what a kind of model is, how it is built, kept and told, a file each."""
