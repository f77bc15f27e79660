"""Networks are sent to worker processes, wrappers included."""

import pickle

from hypothesis import given
from strategies import language, repeatable


@repeatable
@given(network=language())
def test_a_network_that_was_sent_is_the_same(network) -> None:
    there = pickle.loads(pickle.dumps(network, pickle.HIGHEST_PROTOCOL))
    assert there == network
    assert str(there) == str(network)
