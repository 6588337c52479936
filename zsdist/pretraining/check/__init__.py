"""Check of trained vision on pictures that nothing was trained or chosen on."""
