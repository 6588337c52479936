"""What of a view reaches an agent that is to see less: as much as three clearances tell, or nothing."""

from dataclasses import replace

import numpy as np

from zsdist.types import View
from zsdist.vision.labels import sectors
from zsdist.vision.rays import soft_labels


def ablate_rays(view: View, rays: str) -> View:
    """The view as `vision.rays` lets it through.

    Args:
        view: what is seen.
        rays: `all`: the view as it is; `three`: each ray tells no more than the clearance of its direction, as the
            paper's f, l and r do; `none`: neither rays nor advice.
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
