"""How many draws are made anew."""

import pytest

from bayes_impedance.population.draws_again import DrawsAgain


@pytest.mark.parametrize(
    ("excess", "farther", "chosen", "expected"),
    [
        (1.1, False, False, 1024),  # twice as many at least
        (2.5, False, False, 4096),  # the square of the excess, rounded up
        (9.0, False, False, 4096),  # and no more than eight times the first
        (0.5, True, False, 512),  # another range is enough
        (1.1, True, False, 1024),  # the error was too large as well
        (1.1, False, True, 512),  # chosen ones count twice
        (2.0, False, True, 1024),
    ],
)
def test_as_many_as_the_error_asks_for(excess: float, farther: bool, chosen: bool, expected: int) -> None:
    again = DrawsAgain(first=512, last=512, n_persons=71, shared=False)
    assert again.number(excess, farther, chosen) == expected


def test_few_people_get_more_and_shared_parameters_fewer() -> None:
    assert DrawsAgain(first=512, last=512, n_persons=20, shared=False).number(9.0, False, False) == 8192
    assert DrawsAgain(first=512, last=512, n_persons=20, shared=True).number(9.0, False, False) == 2048
    assert DrawsAgain(first=512, last=2048, n_persons=71, shared=False).number(9.0, False, False) == 4096
