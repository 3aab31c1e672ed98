"""Simulation of models: the rollout and where it starts."""
