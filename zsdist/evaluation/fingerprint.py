"""Hashes of all that an episode depends on: the code that drives it, and the contender."""

import hashlib
import json

from zsdist.common import code_hash
from zsdist.dqn import network
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.vision.visual_act import VisualAct

ROOT = "zsdist.evaluation.workers"  # imports everything that drives an episode


def code_sha256() -> str:
    """Return the hash of the code that determines an episode: simulator, vision, planning, agent and drivers.

    Code that measures, reports, learns or distributes is not part of it. Settings are hashed as values instead.
    """
    return code_hash.sha256(ROOT)


def contender_sha256(contender: Contender) -> str:
    """Return the hash of a contender: baseline or variant, settings, networks, and the vision model it uses.

    Raises:
        WeightsError: its vision weights are missing or damaged.
    """
    settings = contender.settings.model_dump(mode="json", include={"grid", "sim", "camera", "vision", "agent"})
    settings["vision"].pop("cache_bytes")
    perception = None
    if contender.observability is Observability.CAMERA:
        model = VisualAct.load(contender.settings.vision, contender.settings.camera)
        perception = VisionIdentity.of(model, contender.settings.vision.network).written()
    networks = {level: network.sha256(parameters) for level, parameters in (contender.networks or {}).items()}
    parts = [contender.baseline, contender.variant, contender.shielded, settings, perception, networks]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[: code_hash.DIGITS]
