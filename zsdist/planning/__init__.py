"""Maps, geometry and rewards in plain numpy: nothing here knows a network, a camera or a transport."""
