"""What an episode depends on, as hashes: the code that drives it, and who drives."""

import hashlib
import json

from zsdist.common import code_hash
from zsdist.dqn import network
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.visual_act import VisualAct

ROOT = "zsdist.evaluation.workers"  # all that drives an episode is imported from here


def code_sha256() -> str:
    """Hash of the code that determines an episode: simulator, vision, planning, agent and drivers.

    What measures, reports, learns or distributes is not in it, nor are settings: those are hashed as values.
    """
    return code_hash.sha256(ROOT)


def entrant_sha256(contender: Contender) -> str:
    """Hash of who drives: the baseline or variant, its settings, its networks, and what it sees by.

    Raises:
        WeightsError: it sees by vision weights that are missing or damaged.
    """
    settings = contender.settings.model_dump(mode="json", include={"grid", "sim", "camera", "vision", "agent"})
    settings["vision"].pop("cache_bytes")
    perception = None
    if contender.observability is Observability.CAMERA:
        model = VisualAct.load(contender.settings.vision, contender.settings.camera)
        perception = VisionIdentity.of(model, contender.settings.vision.network).to_json()
    networks = {level: network.sha256(parameters) for level, parameters in (contender.networks or {}).items()}
    told = [contender.baseline, contender.variant, contender.shielded, settings, perception, networks]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[: code_hash.DIGITS]
