"""The live view of runs in a browser: a server on this machine, which only reads, and its page."""
