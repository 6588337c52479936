"""Transport of bytes between roles, independent of their meaning."""
