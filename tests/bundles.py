"""Small bundles of the shipped policy: with the small vision network, small pictures and a car without physics."""

import json
import shutil

from zsdist.evaluation.workers import Simulation
from zsdist.exporting.bundles import export_policy
from zsdist.run.policies import load_by_name
from zsdist.runtime.bundle import MANIFEST_FILE, PARITY_FILE
from zsdist.sim.physics.kinematic import make_env

SMALL = ("vision.network=student", "camera.size_px=64")
KINEMATIC = Simulation(lambda config, images=True, exact=False: make_env(config, images, exact=True))


def small_policy():
    return load_by_name("pretrained", (), SMALL)


def write_bundle(folder, steps=12):
    export_policy(small_policy(), "small", folder, steps=steps, simulation=KINEMATIC)
    return folder


def damaged(bundle, tmp_path, change):
    """Return a copy of a bundle whose manifest was changed by `change(content)`."""
    folder = shutil.copytree(bundle, tmp_path / "bundle")
    content = json.loads((folder / MANIFEST_FILE).read_text())
    change(content)
    (folder / MANIFEST_FILE).write_text(json.dumps(content))
    return folder


def rewritten(bundle, tmp_path, change):
    """Return a copy of a bundle whose recorded steps were changed by `change(columns)`, with the right hash."""
    import hashlib

    import safetensors.numpy

    steps = {name: column.copy() for name, column in safetensors.numpy.load_file(bundle / PARITY_FILE).items()}
    change(steps)
    content = safetensors.numpy.save(steps)
    folder = damaged(
        bundle, tmp_path, lambda about: about["files"].update({PARITY_FILE: hashlib.sha256(content).hexdigest()})
    )
    (folder / PARITY_FILE).write_bytes(content)
    return folder
