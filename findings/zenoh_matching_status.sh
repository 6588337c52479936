#!/bin/sh
# zenoh 1.10.2 (Python, eclipse-zenoh): Publisher.matching_status is declared as bool and is always true in a condition.
#
# Input: a publisher without any subscriber, in a session that is connected to nobody.
# Behaviour: the types of the package say `Publisher.matching_status -> bool`, "whether there are subscribers matching
# this publisher's key expression". It returns a MatchingStatus object instead, which has no truth value of its own. So
# `if publisher.matching_status:` is true for every publisher, and a type checker refuses `.matching`, which is right.
#
# Output seen:
#     MatchingStatus { matching: false } is taken as True
#
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet eclipse-zenoh==1.10.2
grep -A1 'def matching_status(self) -> bool' "$folder"/venv/lib/python3*/site-packages/zenoh/__init__.pyi
cat > "$folder/status.py" <<'PYTHON'
import zenoh

config = zenoh.Config()
for key, value in (("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]")):
    config.insert_json5(key, value)
with zenoh.open(config) as session:
    status = session.declare_publisher("nobody/listens").matching_status
    print(status, "is taken as", bool(status))
    raise SystemExit(0 if status and not status.matching else 1)
PYTHON
"$folder/venv/bin/python" "$folder/status.py"
