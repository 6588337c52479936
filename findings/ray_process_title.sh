#!/bin/sh
# Ray 2.60.0: the process title of an actor with max_concurrency above 1 says that it rests while a method still runs.
#
# Input: an actor with max_concurrency=2, whose method `work` runs until it is told to end, and a short method `ask`.
# Behaviour: Ray names the process `ray::Actor.work` while `work` runs, as for any actor. When `ask` returns, the title
# becomes `ray::Actor`, the title of an actor without a task, although `work` goes on. So what ps or top shows of a
# threaded actor tells what began or ended last, not what runs: a busy actor cannot be told from a waiting one by it.
#
# Output seen:
#     work runs: ray::Actor.work
#     work runs, ask has returned: ray::Actor
#     work has returned: ray::Actor
#
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ray==2.60.0 psutil==7.2.2
cat > "$folder/title.py" <<'PYTHON'
import os
import threading

import psutil
import ray

ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR",
         object_store_memory=100 * 2**20)


@ray.remote(max_concurrency=3)
class Actor:
    def __init__(self):
        self.begun, self.end = threading.Event(), threading.Event()

    def work(self):
        self.begun.set()
        self.end.wait()

    def ask(self):
        self.begun.wait()
        return os.getpid()

    def finish(self):
        self.end.set()


def title(pid):
    return psutil.Process(pid).cmdline()[0].strip()


# An actor without other methods shows the title that belongs to a running method.
alone = Actor.remote()
pid = ray.get(alone.__ray_call__.remote(lambda self: os.getpid()))
running = alone.work.remote()
while title(pid) != "ray::Actor.work":
    pass
print("work runs:", title(pid))
assert ray.get(alone.ask.remote()) == pid
ready, _ = ray.wait([running], timeout=1.0)
print("work runs, ask has returned:" if not ready else "work has ended:", title(pid))
ray.get(alone.finish.remote())
ray.get(running)
print("work has returned:", title(pid))
ray.shutdown()
PYTHON
export RAY_USAGE_STATS_ENABLED=0 RAY_raylet_start_wait_time_s=300 TMPDIR="$folder"
"$folder/venv/bin/python" "$folder/title.py" 2> /dev/null > "$folder/output"
cat "$folder/output"
[ "$(cat "$folder/output")" = "work runs: ray::Actor.work
work runs, ask has returned: ray::Actor
work has returned: ray::Actor" ]
