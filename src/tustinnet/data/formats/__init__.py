"""Readers of binary files, a module for each format; each is read in a process of its own."""
