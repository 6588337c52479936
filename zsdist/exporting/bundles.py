"""Whole export of a policy: networks, recorded steps, model card and manifest, in a folder that is whole or absent."""

import contextlib
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from zsdist import __version__
from zsdist.common import folders, output_files
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.workers import Simulation
from zsdist.exporting.card import model_card
from zsdist.exporting.graphs import write_network, write_vision
from zsdist.exporting.past import evaluations_of, training_of
from zsdist.exporting.recording import record_steps
from zsdist.planning.footprint import ADVANCES, CAR_LENGTH_M, CAR_WIDTH_M, MARGIN_M, TURNS
from zsdist.run.checkpoint import Policy
from zsdist.runtime.bundle import CARD_FILE, MANIFEST_FILE, NETWORK_FILES, PARITY_FILE, VISION_FILE, Bundle, sha256
from zsdist.runtime.manifest import (
    FORMAT,
    BundleAction,
    BundleCamera,
    BundleFootprint,
    BundleGraph,
    BundleLimits,
    BundleManifest,
    decisive_settings,
)
from zsdist.runtime.parity import ParityResult, check
from zsdist.sim.physics.controller import GAINS
from zsdist.types import Action
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.visual_act import VisualAct

LEAST_STEPS = 200
FRAMES = {
    "arena": "metres from the centre of the square arena, x east, y north; headings in radians counter-clockwise from "
    "east; poses and goals are in it",
    "robot": "x forward, y left, origin on the ground below the robot's centre",
    "camera": "at (forward_m, 0, height_m) of the robot, looking along x, level; rows of a picture from the top, "
    "columns from the left",
    "grid": "cell (ix, iy) from the south-western one, (0, 0); its centre is at ((ix + 0.5) * cell_size_m - half, "
    "(iy + 0.5) * cell_size_m - half), with half = cells * cell_size_m / 2; headings are multiples of 45 degrees",
}

Progress = Callable[[str, int, int], None]  # what is done, steps done, least number of steps


def export_policy(
    policy: Policy,
    name: str,
    out: Path,
    *,
    steps: int = LEAST_STEPS,
    episodes: int = 0,
    evaluations: Sequence[Path] = (),
    simulation: Simulation | None = None,
    progress: Progress = lambda what, done, total: None,
) -> ParityResult:
    """Write the bundle of a policy, check it, and return what the check found.

    Args:
        policy: policy to export.
        name: name of the policy in the bundle.
        out: folder to make; it may exist and be empty.
        steps: least number of recorded steps.
        episodes: least number of recorded episodes.
        evaluations: results of `zsdist evaluate --json` for the model card.
        simulation: simulation in which the steps are recorded; None: physics and the camera.
        progress: called while steps are recorded and checked.

    Raises:
        RunError: the folder holds something already or cannot be written, or an evaluation is of another policy.
        WeightsError: weights of the vision model are missing or damaged.
        BundleError: the bundle does not decide as the policy does.
    """
    check_new(out)
    settings = policy.config
    trained_on, evaluated = training_of(policy), evaluations_of(policy, evaluations)
    visual_act = VisualAct.load(settings.vision, settings.camera)
    with output_files.written(f"bundle {out}"), _folder(out) as folder:
        graphs = {"vision": write_vision(visual_act, folder / VISION_FILE)}
        for level, file in NETWORK_FILES.items():
            graphs[level.value] = write_network(level, policy.parameters[level], folder / file)
        record_steps(
            Contender(settings, policy.parameters),
            folder / PARITY_FILE,
            steps,
            episodes,
            simulation,
            lambda done, least: progress("recording steps", done, least),
        )
        vision = VisionIdentity.of(visual_act, settings.vision.network)
        manifest = _manifest(policy, name, vision, graphs).model_copy(
            update={"trained_on": trained_on, "evaluated": evaluated}
        )
        (folder / CARD_FILE).write_text(model_card(manifest, steps), encoding="utf-8")
        hashes = {path.name: sha256(path) for path in folders.visible(folder)}
        whole = manifest.model_copy(update={"files": hashes})
        (folder / MANIFEST_FILE).write_text(whole.model_dump_json(indent=1) + "\n", encoding="utf-8")
        return check(Bundle.load(folder), on_step=lambda done, total: progress("checking steps", done, total))


def check_new(out: Path) -> None:
    """Raise `RunError` unless a path can become the folder of a bundle: it does not exist, or is an empty folder."""
    if out.is_dir() and not folders.visible(out):
        return
    if out.exists() or out.is_symlink():
        raise RunError(f"--out {str(out)!r} exists already; allowed is a new folder, or an empty one")


def _manifest(policy: Policy, name: str, vision: VisionIdentity, graphs: dict[str, BundleGraph]) -> BundleManifest:
    """Return the manifest without hashes and without the policy's past."""
    settings = policy.config
    return BundleManifest(
        format=FORMAT,
        name=name,
        zsdist=__version__,
        weights_sha256=policy.sha256,
        files={},
        vision=vision.to_json(),
        camera=_camera(settings),
        frames=FRAMES,
        grid=settings.grid,
        footprint=BundleFootprint(length_m=CAR_LENGTH_M, width_m=CAR_WIDTH_M, margin_m=MARGIN_M),
        actions=_actions(settings.grid.cell_size_m),
        graphs=graphs,
        settings=decisive_settings(settings),
        limits=BundleLimits(
            max_steps=settings.sim.max_steps,
            success_radius_m=settings.sim.success_radius_m,
            speed_mps=GAINS.speed_most_mps,
        ),
        trained_on={},
        evaluated={},
    )


def _camera(settings: Config) -> BundleCamera:
    camera, px = settings.camera, settings.camera.size_px
    return BundleCamera(
        width_px=px,
        height_px=px,
        field_of_view_deg=camera.field_of_view_deg,
        focal_px=px / 2 / math.tan(math.radians(camera.field_of_view_deg) / 2),
        centre_px=(px / 2, px / 2),
        height_m=camera.height_m,
        forward_m=camera.forward_m,
        range_m=camera.range_m,
    )


def _actions(cell_size_m: float) -> tuple[BundleAction, ...]:
    return tuple(
        BundleAction(
            name=action.name,
            turn_deg=45.0 * TURNS[action],
            forward_m=ADVANCES[action] * cell_size_m,
            forward_diagonal_m=ADVANCES[action] * cell_size_m * math.sqrt(2),
        )
        for action in Action
    )


@contextlib.contextmanager
def _folder(out: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `out`, which takes its place if nothing goes wrong."""
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        yield folder
        folder.chmod(0o755)  # that of a temporary folder is 0o700
        os.replace(folder, out)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
