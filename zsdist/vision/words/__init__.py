"""Words for the contents of pictures: vocabulary, captions, and measures in the space shared with pictures."""
