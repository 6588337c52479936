"""Networks on the tokens of an encoder, and the small one that needs none; torch."""
