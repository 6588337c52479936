"""What travels: one message per arrow, its bytes, and the keys it travels under. No input or output happens here."""
