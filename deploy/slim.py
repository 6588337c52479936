"""Removal of those files of installed packages that zsdist never reads: 0.4 GB of an installation with all extras.

`python deploy/slim.py` lists them with their sizes; `--remove` removes them from the environment of this interpreter.
Packages are whole again after `pip install --force-reinstall`. Development needs none of them either, but another
program in the same environment may.
"""

import argparse
import shutil
import sysconfig
from pathlib import Path

UNREAD = (  # glob patterns below the folder of the packages
    "pybullet_data",  # models and textures of PyBullet's examples
    "pybullet_envs",
    "pybullet_examples",
    "pybullet_robots",
    "ray/jars",  # workers in Java
    "ray/rllib",
    "torch/bin/protoc*",
    "torch/bin/test_*",
    "torch/bin/*Test",
    "torch/include",  # for extensions in C++
    "torch/test",
    "numba/tests",
    "scipy/*/tests",
    "sympy/*/tests",
    "sympy/*/*/tests",
    "matplotlib/tests",
)


def unread(packages: Path) -> list[Path]:
    """Return the files and folders that can be removed from a folder of packages."""
    return sorted(path for pattern in UNREAD for path in packages.glob(pattern))


def size(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
    return sum(file.stat().st_size for file in files)


def remove(path: Path) -> None:
    """Remove a file or a folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def main() -> None:
    """List or remove what is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--remove", action="store_true", help="remove the files instead of listing them only")
    here = Path(sysconfig.get_path("purelib"))
    parser.add_argument("--packages", type=Path, default=here, metavar="DIR", help=f"folder of packages ({here})")
    options = parser.parse_args()
    found = unread(options.packages)
    sizes = [size(path) for path in found]
    for path, amount in zip(found, sizes, strict=True):
        print(f"{amount / 1e6:8.1f} MB  {path.relative_to(options.packages)}")
        if options.remove:
            remove(path)
    print(f"{sum(sizes) / 1e6:8.1f} MB  {'removed' if options.remove else 'in all; --remove removes them'}")


if __name__ == "__main__":
    main()
