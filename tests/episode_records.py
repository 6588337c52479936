"""A record of an episode or of a validation drive, as an actor sends it."""

RECORD = {
    "scene": "made up",
    "outcome": "success",
    "steps": 3,
    "return": 1.0,
    "epsilon": 0.5,
    "shielded": True,
    "path_m": 1.0,
    "start": [0.0, 0.0],
    "goal": [1.0, 1.0],
    "path": [[0.0, 0.0]],
}
