"""`python benchmarks/bundle.py --runtime DIR`: an exported policy against the training code, and what its runner needs.

`make runtime VENV=DIR` makes the environment in which the runner is measured. The policy is exported here, with whole
episodes in simulation as its recorded steps; the runner then decides on their pictures and poses in its environment.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from _common import report

HERE = Path(__file__).parent


def main() -> None:
    """Export, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runtime", type=Path, required=True, help="environment made by make runtime VENV=DIR")
    parser.add_argument("--policy", default="pretrained", help="policy to export (default: pretrained)")
    parser.add_argument("--episodes", type=int, default=20, help="episodes that are compared (default: 20)")
    parser.add_argument("--bundle", type=Path, help="bundle that was exported before; none is exported")
    parser.add_argument("--quick", action="store_true", help="2 episodes")
    options = parser.parse_args()
    python = options.runtime.absolute() / "bin" / "python"
    if not python.exists():
        raise SystemExit(f"{python} does not exist; run: make runtime VENV={options.runtime}")
    with tempfile.TemporaryDirectory() as folder:
        bundle = options.bundle or Path(folder) / "bundle"
        if options.bundle is None:
            episodes = 2 if options.quick else options.episodes
            command = ["-m", "zsdist.export", options.policy, "--out", bundle, "--steps", "1", "--episodes", episodes]
            subprocess.run([sys.executable, *map(str, command)], check=True, cwd=HERE.parent)
        checked = in_runtime(python, "-m", "zsdist.export", "--check", bundle.absolute())
        print(checked.strip())
        in_runtime(python, HERE / "_runner_probe.py", bundle.absolute())  # compiles what is compiled once
        found = json.loads(in_runtime(python, HERE / "_runner_probe.py", bundle.absolute()))
    print(f"{len(found['packages'])} packages: {', '.join(found['packages'])}")
    print(f"of torch, ray, pybullet and scipy it loads: {', '.join(found['heavy']) or 'none'}")
    figures = {name: value for name, value in found.items() if isinstance(value, float | int)}
    figures |= {"packages": len(found["packages"]), "heavy": len(found["heavy"]), "disk_mb": disk_mb(options.runtime)}
    report("bundle", figures, {})


def in_runtime(python: Path, *words: object) -> str:
    """Return what a command prints in the runner's environment, outside of the checkout and without its packages."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [str(python), *map(str, words)]
    done = subprocess.run(command, check=True, cwd="/", env=environment, stdout=subprocess.PIPE, text=True)
    return done.stdout


def disk_mb(folder: Path) -> float:
    """Return the size of all files in a folder, in millions of bytes."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return sum(path.stat().st_size for path in files) / 1e6


if __name__ == "__main__":
    main()
