"""Common machines as systems, one file each: equations, a drawing, and a twin."""
