"""Messages between roles, their bytes, and the keys under which they travel; without any input or output."""
