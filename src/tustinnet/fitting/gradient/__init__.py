"""Training of models on windows of records, as recipes say."""
