"""What reproduces the publication, and nothing else."""
