"""Messages between roles, their bytes, and the keys under which they are sent; without any input or output."""
