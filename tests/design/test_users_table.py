"""Users as a table of pandas."""

import numpy as np

from bayes_impedance.design.users import Users
from bayes_impedance.network.notation import parse


def test_users_have_a_row_each_and_elements_have_units() -> None:
    log_elements = np.log([[1e-3, 2.0, 3e-4], [2e-3, 1.0, 5e-4]])
    users = Users(parse("m1|r1|n1"), "N s/m", ("a", "b"), log_elements)
    table = users.to_dataframe()
    assert table.shape == (2, 3)
    assert table.index.tolist() == ["a", "b"]
    np.testing.assert_array_equal(table.loc["b"], list(users.of(1).values()))
    assert table.attrs["units"] == {"m1": "kg", "r1": "N s/m", "n1": "m/N"}
