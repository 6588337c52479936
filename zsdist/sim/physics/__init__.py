"""Physics of the car among a scene's obstacles: PyBullet's world, the controller, collisions and rays."""
