"""What an episode depends on, as hashes: the code that drives it, and who drives."""

import hashlib
import json

from zsdist.common import code_hash
from zsdist.dqn import network
from zsdist.evaluation.contenders import Entrant
from zsdist.evaluation.drivers import Sees
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.visual_act import VisualAct

ROOT = "zsdist.evaluation.workers"  # all that drives an episode is imported from here


def code_sha256() -> str:
    """Hash of the code that determines an episode: simulator, vision, planning, agent and drivers.

    What measures, reports, learns or distributes is not in it, nor are settings: those are hashed as values.
    """
    return code_hash.sha256(ROOT)


def entrant_sha256(entrant: Entrant) -> str:
    """Hash of who drives: the baseline or variant, its settings, its networks, and what it sees by.

    Raises:
        WeightsError: it sees by vision weights that are missing or damaged.
    """
    settings = entrant.settings.model_dump(mode="json", include={"grid", "sim", "camera", "vision", "agent"})
    settings["vision"].pop("cache_bytes")
    sight = None
    if entrant.sees is Sees.CAMERA:
        model = VisualAct.load(entrant.settings.vision, entrant.settings.camera)
        sight = VisionIdentity.of(model, entrant.settings.vision.network).written()
    networks = {level: network.sha256(parameters) for level, parameters in (entrant.networks or {}).items()}
    told = [entrant.baseline, entrant.variant, entrant.shielded, settings, sight, networks]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[: code_hash.DIGITS]
