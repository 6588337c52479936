"""Picture of the points of `_crowd.py`, and of what the model makes of them: measured are dots, modelled are lines."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _scaling_model as model
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIZES = (10, 30, 100, 300, 1000, 3000, 10_000)  # actors


def draw(points: Sequence[dict[str, Any]], weights_bytes: int, file: Path) -> None:
    """Write a picture of cores, delays and needs to a file."""
    figure, (cores, delays, needs) = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    for part in model.COSTS:
        costs = model.fit(points, part)
        predicted = [sum(costs[name] * point[name] for name in model.COSTS[part]) for point in points]
        rates = [point["transitions_per_s"] for point in points]
        (dots,) = cores.plot(rates, [point[f"{part}_cores"] for point in points], "o", label=f"{part}, measured")
        pairs = sorted(zip(rates, predicted, strict=True))
        cores.plot(*zip(*pairs, strict=True), "-", color=dots.get_color(), label=f"{part}, modelled")
    cores.set(xlabel="stored transitions per second", ylabel="cores", title="CPU time")
    for name in ("ack", "weights"):
        seen = [(point["clients"], point[f"{name}_p99_ms"]) for point in points if f"{name}_p99_ms" in point]
        delays.plot(*zip(*sorted(seen), strict=True), "o", label=f"{name}, 99%, measured")
    delays.set(xlabel="clients", ylabel="ms", title="Delays", xscale="log", yscale="log")
    rate = points[-1]["rate"]
    sizes = [model.needs(points, clients, rate, 1.0, weights_bytes) for clients in SIZES]
    for name in ("hub_cores", "shards"):
        needs.plot(SIZES, [size[name] for size in sizes], "-", label=f"{name.replace('_', ' ')}, modelled")
    needs.set(xlabel=f"actors, {rate:g} transitions per second each", title="Needs", xscale="log", yscale="log")
    for axes in (cores, delays, needs):
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)
