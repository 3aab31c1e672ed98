"""Tables, figures, progress bars and the HTML report."""
