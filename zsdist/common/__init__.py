"""Small tools for any part of the package, independent of cars, learning and runs."""
