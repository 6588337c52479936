#!/bin/sh
# Ray 2.60.0 on Linux: ray.init(address="local", _node_ip_address="127.0.0.1") does not stay on the loopback interface.
#
# Input: the address 127.0.0.1 for a Ray of one machine, which no other machine needs to reach.
# Behaviour: Ray takes the address of the network in its place, without a word, and the GCS, the raylet and the driver
# listen at every address of the machine. With RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0, set before `import ray` - on Linux
# too, whatever its name says - the same call listens at 127.0.0.1 only.
#
# Output seen:
#     as given: node 192.0.2.2, listening at every address: driver gcs_server raylet
#     with the variable: node 127.0.0.1, listening at every address: nothing
#
# A machine without any network has no other address than 127.0.0.1; the script then ends with status 3.
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ray==2.60.0 psutil==7.2.2
cat > "$folder/listen.py" <<'PYTHON'
import psutil
import ray

ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR",
         object_store_memory=100 * 2**20, _node_ip_address="127.0.0.1")
me = psutil.Process()
names = {me.pid: "driver"} | {child.pid: child.name() for child in me.children(recursive=True)}
everywhere = {names[link.pid] for link in psutil.net_connections("tcp")
              if link.status == "LISTEN" and link.pid in names and link.laddr.ip in ("::", "0.0.0.0")}
everywhere &= {"driver", "gcs_server", "raylet"}
print(f"node {ray.util.get_node_ip_address()}, listening at every address: {' '.join(sorted(everywhere)) or 'nothing'}")
ray.shutdown()
PYTHON
export RAY_USAGE_STATS_ENABLED=0 RAY_raylet_start_wait_time_s=300 TMPDIR="$folder"
given=$(env -u RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER "$folder/venv/bin/python" "$folder/listen.py" 2> /dev/null | tail -1)
other=$(RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0 "$folder/venv/bin/python" "$folder/listen.py" 2> /dev/null | tail -1)
echo "as given: $given"
echo "with the variable: $other"
case $given in "node 127.0.0.1,"*) echo "this machine has no network, so nothing was shown"; exit 3 ;; esac
case $given in *": driver gcs_server raylet") ;; *) exit 1 ;; esac
[ "$other" = "node 127.0.0.1, listening at every address: nothing" ]
