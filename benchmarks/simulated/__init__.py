"""Twelve simulated machines, their sensors and their system files, for `machines.py`."""
