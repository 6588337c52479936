"""Physics of the car among a scene's obstacles: PyBullet world, controller, collisions and rays."""
