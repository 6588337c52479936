"""What the car sees: pretrained encoder, visual-act head on its tokens, labels, losses, training (Algorithm 1)."""
