"""Ablation of the rays of a view: all of them, only the three clearances, or none."""

from dataclasses import replace

import numpy as np

from zsdist.types import View
from zsdist.vision.labels import sectors
from zsdist.vision.rays import soft_labels


def ablate_rays(view: View, rays: str) -> View:
    """Return the part of a view that the setting `vision.rays` leaves to the agent.

    Args:
        view: output of the vision model.
        rays: `all`: the view unchanged; `three`: each ray has the clearance of its direction, as the paper's f, l and
            r; `none`: neither rays nor advice.
    """
    if rays == "three":
        distance_m = (sectors(view.ray_angles_rad) * view.clearance_m[:, None]).sum(0)  # each ray has one sector
        return replace(view, ray_probabilities=soft_labels(distance_m))
    if rays == "none":
        nothing = np.zeros(3, np.float32)
        return replace(
            view,
            advice=nothing,
            clearance_m=nothing,
            dynamic=nothing,
            ray_probabilities=view.ray_probabilities[:0],
            ray_angles_rad=view.ray_angles_rad[:0],
        )
    return view
