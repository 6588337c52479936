#!/bin/sh
# Gymnasium 1.4.0: the entry point `gymnasium.envs`, by which an installed package registered its environments in 0.29,
# is read no more. Nothing says so.
#
# Input: a package with `[project.entry-points."gymnasium.envs"]`, whose function registers `demo/Nothing-v0`, in the
# form that Gymnasium 0.26 to 0.29 documented.
# Behaviour: under 0.29.1 `gymnasium.make("demo/Nothing-v0")` works at once. Under 1.4.0 it raises an error about the
# namespace, and never calls the function. The module in front of the id helps: `gymnasium.make("demo:demo/Nothing-v0")`
# imports it, and the environment must be registered by that import.
#
# Output seen:
#     0.29.1: made
#     1.4.0: NamespaceNotFound, with the module in front: made
#
# Ends with status 1 where the behaviour has changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/package"
cat > "$folder/package/pyproject.toml" <<'TOML'
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"
[project]
name = "demo"
version = "1"
[project.entry-points."gymnasium.envs"]
__root__ = "demo:register_all"
[tool.setuptools]
py-modules = ["demo"]
TOML
cat > "$folder/package/demo.py" <<'PYTHON'
import gymnasium
from gymnasium.envs.registration import register, registry


class Nothing(gymnasium.Env):
    observation_space = action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        return 0, 0.0, True, False, {}


def register_all():
    if "demo/Nothing-v0" not in registry:
        register("demo/Nothing-v0", entry_point="demo:Nothing")


register_all()  # where the module is imported by its name
PYTHON
cat > "$folder/make.py" <<'PYTHON'
import sys

import gymnasium


def made(name):
    try:
        gymnasium.make(name)
    except gymnasium.error.Error as error:
        return type(error).__name__
    return "made"


print(f"{gymnasium.__version__}: {made('demo/Nothing-v0')}", end="")
if gymnasium.__version__.startswith("1."):
    print(f", with the module in front: {made('demo:demo/Nothing-v0')}", end="")
print()
PYTHON
for version in 0.29.1 1.4.0; do
    python3 -m venv "$folder/$version"
    "$folder/$version/bin/pip" install --quiet "gymnasium==$version" setuptools "$folder/package"
    (cd "$folder" && "$folder/$version/bin/python" make.py) | tee -a "$folder/output"
done
[ "$(cat "$folder/output")" = "0.29.1: made
1.4.0: NamespaceNotFound, with the module in front: made" ]
