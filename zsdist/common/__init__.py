"""Small tools that any part of the package may use: they know nothing of cars, learning or runs."""
