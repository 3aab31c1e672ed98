"""How well a model simulates records it was not trained on."""
