"""Wait until a Ray cluster has a number of cores: python deploy/await_cores.py ADDRESS CORES [SECONDS, 600 by default].

Machines of a cluster join it one after the other, and a run that is started before they have is refused. Unlike
`ray symmetric-run`, it does not mind further machines, nor other clusters of Ray on this machine.
"""

import sys
import time

import ray


def main(address: str, cores: float, within_s: float = 600.0) -> None:
    """Return once the cluster has the cores; exit with one line where it has not in time."""
    deadline_s, said = time.monotonic() + within_s, ""
    while True:
        found, news = look(address)
        if found >= cores:
            return
        if time.monotonic() > deadline_s:
            sys.exit(f"the cluster at {address} has {found:g} of {cores:g} cores after {within_s:g} s{news}")
        if said != (said := f"{found:g} of {cores:g} cores have joined{news}"):
            print(said, flush=True)
        time.sleep(1)


def look(address: str) -> tuple[float, str]:
    """Return the cores of the cluster, none where it does not answer, and what was wrong then."""
    try:
        if not ray.is_initialized():
            ray.init(address=address, log_to_driver=False, logging_level="CRITICAL")
        return ray.cluster_resources().get("CPU", 0.0), ""
    except Exception as error:  # Ray raises errors of many classes while a cluster starts
        ray.shutdown()
        return 0.0, f": {str(error).strip().splitlines()[0]}" if str(error).strip() else f": {type(error).__name__}"


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:4]))
