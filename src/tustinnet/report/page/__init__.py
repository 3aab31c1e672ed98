"""The report: one HTML file that shows how models simulate records."""
