"""Check of a trained vision model on pictures that were not used for training or any choice."""
