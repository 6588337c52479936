"""How nothing gets lost: numbered frames, windows, acknowledgements and credit, as pure state machines."""
