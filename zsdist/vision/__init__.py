"""Vision of the car: pretrained encoder, visual-act head on its tokens, labels, losses, training (Algorithm 1)."""
