"""The command `tustinnet`: one file per verb, no numerics."""
