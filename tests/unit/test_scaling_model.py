"""The model of what runs of any size need (`benchmarks/_scaling_model.py`)."""

import importlib.util
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "benchmarks" / "_scaling_model.py"
HUB = {"pushes_per_s": 4e-5, "push_bytes_per_s": 2e-9, "acks_per_s": 3e-5, "weights_per_s": 8e-5, "clients": 2e-4}
SHARD = {"transitions_per_s": 2e-5, "pushes_per_s": 1e-5, "acks_per_s": 1e-5}


@pytest.fixture(scope="module")
def model():
    spec = importlib.util.spec_from_file_location("_scaling_model", SOURCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def point(clients, rate):
    transitions = clients * rate
    does = {
        "clients": clients,
        "rate": rate,
        "transitions_per_s": transitions,
        "pushes_per_s": transitions / 8,
        "push_bytes_per_s": transitions * 200,
        "acks_per_s": transitions / 16 + 4 * clients,
        "weights_per_s": clients,
    }
    spent = {"hub_cores": sum(HUB[name] * does[name] for name in HUB)}
    return does | spent | {"shard_cores": sum(SHARD[name] * does[name] for name in SHARD)}


POINTS = [point(clients, rate) for clients in (4, 16, 64, 256) for rate in (20, 100, 300)]


def test_the_fit_predicts_the_points_that_it_was_made_from(model):
    for part in ("hub", "shard"):
        costs = model.fit(POINTS, part)
        assert costs["error"] < 1e-3 and min(costs.values()) >= 0


def test_a_larger_run_needs_what_its_parts_cost(model):
    needed = model.needs(POINTS, 1000, 300.0, 1.0, 136_000)
    truth = point(1000, 300)
    assert needed["transitions_per_s"] == 300_000
    assert needed["hub_cores"] == pytest.approx(truth["hub_cores"], rel=0.25)
    assert needed["shards"] == pytest.approx(truth["shard_cores"] / model.FULL, rel=0.25, abs=1)


def test_costs_are_never_negative_whatever_the_noise(model):
    noisy = [dict(one, hub_cores=one["hub_cores"] * (0.5 if number % 2 else 1.5)) for number, one in enumerate(POINTS)]
    assert min(model.fit(noisy, "hub").values()) >= 0


def test_a_single_point_is_refused(model):
    with pytest.raises(ValueError, match="1 points; allowed are 2 or more"):
        model.fit(POINTS[:1], "hub")
