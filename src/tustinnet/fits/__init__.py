"""The one way to fit: records are prepared, a model is fitted to them, scored and kept."""
