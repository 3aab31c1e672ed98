"""The check of records before a fit: what is wrong with them, where, and the line that mends it."""
