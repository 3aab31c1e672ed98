"""Reproduction of the publication: its Table 1, its figures and its recipes."""
