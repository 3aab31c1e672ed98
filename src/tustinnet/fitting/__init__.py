"""From records and a recipe to a model: by training weights, or by identifying parameters."""
