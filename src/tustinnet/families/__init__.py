"""Families of models: how each kind of model is built, stored and described, one file each."""
