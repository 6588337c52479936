import signal

import pytest

from zsdist.run.interruption import interruptible


def test_the_first_signal_requests_a_stop_and_the_second_stops_at_once():
    before = signal.getsignal(signal.SIGTERM)
    with interruptible() as interruption:
        assert not interruption()
        signal.raise_signal(signal.SIGTERM)
        assert interruption()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) == before
