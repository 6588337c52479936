"""Model card of a bundle: what the policy is, what it was trained and tried on, and what nobody has tried."""

from typing import Any

from zsdist.common import places
from zsdist.runtime.manifest import BundleManifest

NEVER_TRIED = (
    "real pictures: it was trained on rendered ones, and the loss on real ones is not known",
    "hardware of any kind: nothing here is a proof that a robot with it is safe",
    "slopes, steps, holes, glass, wires, table tops, and whatever the camera cannot see above or below its view",
    "another height, angle or field of view of the camera than below",
    "a robot larger than the footprint below, or one that cannot turn in place",
    "night, rain, glare, blur of motion, and pictures older than 0.1 s",
    "errors of the pose beyond those of a simulated car, whose pose is exact",
)
_FIGURES = ("success", "collision", "timeout", "spl")


def model_card(manifest: BundleManifest, steps: int) -> str:
    """Return the model card in Markdown.

    Args:
        manifest: content of `manifest.json`, whose hashes may be missing still.
        steps: number of recorded steps.
    """
    camera, footprint, grid, limits = manifest.camera, manifest.footprint, manifest.grid, manifest.limits
    side_m = grid.cells * grid.cell_size_m
    trained = manifest.trained_on
    lines = [
        f"# {manifest.name}",
        "",
        "Policy that drives a robot to a goal by one camera and its pose, exported by "
        f"[zsdist](https://pypi.org/project/zsdist/) {manifest.zsdist}. Weights {manifest.weights_sha256[:16]}, vision "
        f"{manifest.vision['network']} on {manifest.vision['encoder']}.",
        "",
        "**It is not proven on hardware.** Keep an emergency stop at hand.",
        "",
        "## Trained on",
        "",
        f"{trained['episodes']} simulated episodes in scenes of {', '.join(trained['scenes'])}, seed "
        f"{trained['seed']}.",
        "",
        "## Evaluated on",
        "",
        *_evaluated(manifest.evaluated),
        "",
        "## Never tried on",
        "",
        *(f"- {line};" for line in (*_families_left(manifest), *NEVER_TRIED[:-1])),
        f"- {NEVER_TRIED[-1]}.",
        "",
        "## What it needs",
        "",
        "| | |",
        "|---|---|",
        f"| camera | {camera.width_px} x {camera.height_px} pixels, {camera.field_of_view_deg:g} degrees both ways, "
        f"level, {camera.height_m:g} m above the ground, {camera.forward_m:g} m ahead of the robot's centre |",
        f"| range of vision | {camera.range_m:g} m; what is farther counts as free |",
        f"| pose | x, y and heading of the robot's centre; the planning grid is {side_m:g} m x {side_m:g} m |",
        f"| robot | at most {footprint.length_m:g} m x {footprint.width_m:g} m, with {footprint.margin_m:g} m of "
        "margin; turns in place; never drives backward |",
        f"| goal | reached within {limits.success_radius_m:g} m; at most {limits.max_steps} actions |",
        "",
        "## Files",
        "",
        "| file | content |",
        "|---|---|",
        "| `manifest.json` | the contract: camera, frames, grid, footprint, actions, inputs and outputs, hashes |",
        "| `vision.onnx` | picture to distributions of distances |",
        "| `high.onnx`, `low.onnx` | Q-networks: features of the situation to values |",
        f"| `parity.safetensors` | {steps} recorded steps: picture, pose, goal, masks, values, action |",
        "",
        "    zsdist export --check .     # replays the recorded steps",
        "    zsdist drive . --help       # drives a robot",
        "",
    ]
    return "\n".join(lines)


def _evaluated(results: dict[str, dict[str, Any]]) -> list[str]:
    if not results:
        return [
            "Nothing that is recorded here. `zsdist evaluate POLICY --scenes SCENES --json FILE` evaluates, and "
            "`zsdist export POLICY --evaluation FILE` puts the result here."
        ]
    lines = [
        "Simulated test scenes, greedy, under the shield; 95% intervals in brackets.",
        "",
        "| scenes | n | success | collision | timeout | SPL |",
        "|---|---|---|---|---|---|",
    ]
    for scenes, result in results.items():
        cells = [_cell(result[name], result[f"{name}_95"]) for name in _FIGURES]
        lines.append(f"| {scenes} | {result['episodes']} | {' | '.join(cells)} |")
    return lines


def _cell(value: float | None, interval: list[float] | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if interval is None else f"{value:.3f} ({interval[0]:.3f} to {interval[1]:.3f})"


def _families_left(manifest: BundleManifest) -> list[str]:
    """Return a line with the families of scenes of the package that the policy was not evaluated on."""
    left = [family for family in places.FAMILIES if family.startswith("ood-") and family not in manifest.evaluated]
    return [f"simulated scenes of {', '.join(left)}"] if left else []
