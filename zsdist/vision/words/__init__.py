"""Words for what a camera sees: vocabulary, captions, and the space they share with pictures."""
