"""Drafts of data cards: evidence on each column, the choice of channels, the splits, the text."""
