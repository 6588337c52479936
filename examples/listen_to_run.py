"""Print the statistics of a run with a plain zenoh client. Nothing of zsdist is imported.

Usage: `python examples/listen_to_run.py [ENDPOINT] [SECONDS]`, by default `tcp/127.0.0.1:7447 10`. The endpoint of a
run is in the file `endpoint` of its folder.
"""

import json
import sys
import threading

import zenoh


def main(endpoint: str = "tcp/127.0.0.1:7447", seconds: str = "10") -> dict[str, dict]:
    """Listen for some seconds and return the last statistics of each role, by key."""
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", json.dumps([endpoint]))
    settings.insert_json5("scouting/multicast/enabled", "false")
    newest: dict[str, dict] = {}

    def show(sample: zenoh.Sample) -> None:
        key, fields = str(sample.key_expr), json.loads(sample.payload.to_string())
        newest[key] = fields
        print(key, json.dumps(fields), flush=True)

    with zenoh.open(settings) as session:
        session.declare_subscriber("zsdist/*/stats/**", show)
        threading.Event().wait(float(seconds))
    return newest


if __name__ == "__main__":
    main(*sys.argv[1:])
