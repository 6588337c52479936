"""Image encoders behind one protocol: pictures to tokens, words to the space that both share."""
