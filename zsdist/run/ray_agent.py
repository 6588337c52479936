"""Stand-in for the agents that Ray's raylet starts and no run uses: it waits for the raylet's end.

It runs alone, by its path, and imports only the standard library.
"""

import os
import time

LOOK_EVERY_S = 1.0


def main() -> None:
    """Wait until the parent is gone."""
    raylet = os.getppid()
    while os.getppid() == raylet:
        time.sleep(LOOK_EVERY_S)


if __name__ == "__main__":
    main()
