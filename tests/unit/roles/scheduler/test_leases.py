import tracemalloc

from zsdist.roles.scheduler.leases import Leases


def test_every_number_is_finished_once_even_when_actors_die():
    leases = Leases()
    for round_number in range(200):
        for actor in ("a", "b"):
            leases.grant(actor, capacity=3, barrier=50)
        if round_number % 7 == 3:
            leases.give_back("a")
            continue
        for actor in ("a", "b"):
            for number in leases.held_by(actor)[:1]:
                assert leases.finish(number, actor)
    assert leases.finished == set(range(1, 51))
    assert not leases.holders


def test_no_number_above_the_barrier_is_leased():
    leases = Leases()
    leases.grant("a", capacity=10, barrier=4)
    assert leases.held_by("a") == [1, 2, 3, 4]


def test_a_number_given_back_is_leased_again_and_no_longer_counts_for_its_first_holder():
    leases = Leases()
    leases.grant("a", capacity=1, barrier=10)
    assert leases.give_back("a") == [1]
    leases.grant("b", capacity=1, barrier=10)
    assert leases.held_by("b") == [1]
    assert not leases.finish(1, "a")
    assert leases.finish(1, "b")


def test_a_resumed_run_leases_unfinished_numbers():
    leases = Leases({1, 2, 4})
    leases.grant("a", capacity=3, barrier=100)
    assert leases.held_by("a") == [3, 5, 6]


def test_numbers_finished_out_of_order_count_towards_the_barrier():
    leases = Leases({1, 2, 7})
    leases.grant("a", capacity=10, barrier=5)
    assert leases.held_by("a") == [3, 4]


def test_what_is_finished_takes_no_memory_and_no_time():
    leases, actors, granted = Leases(), [f"actor-{index}" for index in range(4096)], 0
    tracemalloc.start()
    for _ in range(5):
        for actor in actors:
            leases.grant(actor, 4, 10**9)
            granted += 4
            for number in leases.held_by(actor):
                leases.finish(number, actor)
        assert leases.take_changed() == set(actors)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert leases.finished_count == granted
    assert grown < 2 * 2**20  # the empty sets of 4,096 actors


def test_a_long_run_with_a_gap_resumes_where_it_was():
    leases = Leases(set(range(1, 100_001)) - {77, 99_990})
    leases.grant("a", 3, 10**6)
    assert leases.held_by("a") == [77, 99_990, 100_001]
    assert leases.finished == set(range(1, 100_001)) - {77, 99_990}
