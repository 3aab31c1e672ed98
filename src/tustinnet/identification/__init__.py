"""Parameters of grey-box models from records, with what can be trusted of them."""
