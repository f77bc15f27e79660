"""The notation and the algebra of networks: text, operators and arrays say the same."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given
from strategies import (
    build,
    combined,
    leaf_impedance,
    names,
    network_impedance,
    networks,
    repeatable,
    shape_impedance,
    shapes,
    shapes_with_elements,
    text,
)

from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import PAPER_NETWORK, Element, Parallel, Place, Series, parse

S = 2j * np.pi * np.array([0.037, 0.41, 1.3, 17.7])
A, B, C, D = (Element(name) for name in ("m1", "n1", "r1", "r2"))


# Notation


@repeatable
@given(networks())
def test_print_and_parse_round_trip(network):
    assert parse(str(network)) == network


@repeatable
@given(shapes())
def test_text_and_operators_build_the_same_network(shape):
    assert parse(text(shape)) == build(shape)
    assert build(shape).elements == names(shape)


@pytest.mark.parametrize(
    ("notation", "network"),
    [
        ("m1-n1|r1", A - B | C),
        ("m1|n1-r1", A | B - C),
        ("m1-n1|r1-r2", A - B | C - D),
        ("m1|n1-r1|r2", A | B - C | D),
        ("(m1|n1)-r1", (A | B) - C),
        ("m1-(n1|r1)-r2", A - (B | C) - D),
        ("m1-n1-r1", A - B - C),
        ("m1-(n1-r1)", A - (B - C)),
    ],
)
def test_precedence_is_pythons(notation, network):
    assert parse(notation) == network


def test_series_binds_tighter():
    assert parse("m1-n1|r1") == Parallel((Series((A, B)), C))
    assert parse("m1|n1-r1") == Parallel((A, Series((B, C))))


def test_nested_groups_of_one_kind_are_flattened_unless_labelled():
    assert parse("(m1|n1)|(r1|r2)") == Parallel((A, B, C, D))
    assert parse("m1-(n1-r1)") == Series((A, B, C))
    assert parse("a:(m1|n1)|r1") == Parallel((Parallel((A, B)).labelled("a"), C))
    assert parse("a:(m1|n1)|r1") != parse("m1|n1|r1")


def test_blanks_and_superfluous_parentheses_do_not_matter():
    assert parse(" ( m1 )\t|\n((n1)-skin : (r1)) ") == A | B - C.labelled("skin")


def test_paper_network_prints_as_it_is_written():
    network = parse(PAPER_NETWORK)
    assert str(network) == PAPER_NETWORK
    assert network.elements == ("n3", "r3", "m2", "r1", "n1", "m1", "n2", "r2")


def test_label_of_the_whole_network_is_printed():
    assert str(parse("finger:(m1|n1)")) == "finger:(m1|n1)"
    assert str(parse("finger:m1")) == "finger:m1"


EXPECTED_PART = "an element such as m1, n1 or r1, or '('"
EXPECTED_END = "'|', '-' or the end"


@pytest.mark.parametrize(
    ("notation", "problem"),
    [
        ("", f"ends too early: expected {EXPECTED_PART}"),
        ("m1|", f"ends too early: expected {EXPECTED_PART}"),
        ("(m1|n1", "ends too early: expected ')'"),
        ("skin:", f"ends too early: expected {EXPECTED_PART}"),
        ("m1||n1", f"'|' at character 4 is not {EXPECTED_PART}"),
        ("-m1", f"'-' at character 1 is not {EXPECTED_PART}"),
        ("m1|)", f"')' at character 4 is not {EXPECTED_PART}"),
        ("m1 n1", f"'n1' at character 4 is not {EXPECTED_END}"),
        ("(m1|n1))", f"')' at character 8 is not {EXPECTED_END}"),
        ("(m1|n1 & r1)", "'&' at character 8 is not ')'"),
        ("m1 | 3k", f"'3' at character 6 is not {EXPECTED_PART}"),
        ("m1+n1", f"'+' at character 3 is not {EXPECTED_END}"),
    ],
)
def test_what_cannot_be_read_is_reported_with_its_position(notation, problem):
    with pytest.raises(InputError) as error:
        parse(notation)
    separator = " " if problem.startswith("ends") else ": "
    assert str(error.value) == f"network '{notation}'{separator}{problem}"


@pytest.mark.parametrize(
    ("notation", "message"),
    [
        ("m1|k1", "element 'k1' is of no known kind: its first letter must be m (mass), n (compliance) or r (damper)"),
        ("m1|n1-m1", "element 'm1' occurs twice in the network: give each element a name of its own"),
        ("port:(m1|n1)", "'port' cannot be a label: use letters, digits and '_', and not the word 'port'"),
    ],
)
def test_what_can_be_read_but_not_used_is_refused(notation, message):
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        parse(notation)


def test_duplicates_are_refused_by_every_way_of_building():
    for make in (
        lambda: A | A,
        lambda: (A - B) - A,
        lambda: (A | B).beside("n1", A),
        lambda: (A | B - C).in_series("r1", B),
        lambda: (A | B).replaced("n1", A),
        lambda: Parallel((A, Series((B, A)))),
    ):
        with pytest.raises(InputError, match="occurs twice"):
            make()


@pytest.mark.parametrize("label", ["port", "", "a b", "1a", "a-b", "a:b"])
def test_labels_are_plain_words(label):
    with pytest.raises(InputError, match="cannot be a label"):
        A.labelled(label)


@pytest.mark.parametrize("name", ["", "m 1", "1m", "m-1", "m1\n"])
def test_names_are_plain_words(name):
    with pytest.raises(InputError, match="is not a name of an element"):
        Element(name)


def test_groups_have_two_parts():
    with pytest.raises(InputError, match="at least two parts"):
        Parallel((A,))


# Physics


@repeatable
@given(shapes_with_elements())
def test_operators_equal_arrays(shape_and_values):
    shape, values = shape_and_values
    np.testing.assert_allclose(build(shape).impedance(S, values), shape_impedance(shape, S, values), rtol=1e-12)


def test_impedance_broadcasts_values_against_frequencies():
    values = {"m1": np.array([[1.0], [2.0]]), "n1": 0.5, "r1": np.array([[3.0], [4.0]])}
    z = (A - B | C).impedance(S, values)
    assert z.shape == (2, S.size)
    for i in range(2):
        m, r = values["m1"][i, 0], values["r1"][i, 0]
        np.testing.assert_allclose(z[i], r + 1 / (1 / (S * m) + S * 0.5), rtol=1e-14)


def test_missing_value_is_named():
    with pytest.raises(InputError, match="element 'n1' has no value: there are values for m1"):
        (A | B).impedance(S, {"m1": 1.0})


# Places and edits


@repeatable
@given(networks())
def test_places_are_all_nodes_and_the_port_comes_first(network):
    places = network.places()
    assert places[0] == Place((), "port")
    assert len(places) == len(list(network.walk())) == len({place.path for place in places})
    for place in places[1:]:
        node = network.at(place)
        assert place.name == (node.label or (node.name if isinstance(node, Element) else str(node)))
        assert network.at(place.name) == node
        assert network.place(str(node)).path == place.path


def test_names_of_places():
    network = parse(PAPER_NETWORK)
    assert [place.name for place in network.places()] == [
        *("port", "skin", "n3", "r3", "tissue", "m2", "r1", "n1", "limb", "m1", "n2|r2", "n2", "r2")
    ]
    assert network.place("m1-(n2|r2)") == network.place("limb") == Place((1, 3), "limb")
    with pytest.raises(InputError, match=r"no place 'toe' in the network .*: there are port, skin, n3"):
        network.place("toe")


ADDITIONS = {"m77": Element("m77"), "n77-r77": parse("n77-r77"), "n77|r77": parse("n77|r77"), "b": parse("b:(n77|r77)")}
ADDED = {"m77": 0.6, "n77": 1.7, "r77": 0.4}


@pytest.mark.parametrize("addition", ADDITIONS.values(), ids=ADDITIONS)
@repeatable
@given(shapes_with_elements(max_leaves=8))
def test_insertions_at_every_place_equal_arrays(addition, shape_and_values):
    shape, values = shape_and_values
    network, values = build(shape), values | ADDED
    extra = network_impedance(addition, S, values)
    for place in network.places():
        for edited, parallel in ((network.beside(place, addition), True), (network.in_series(place, addition), False)):
            expected = network_impedance(
                network, S, values, place.path, lambda z, parallel=parallel: combined(parallel, [z, extra])
            )
            np.testing.assert_allclose(network_impedance(edited, S, values), expected, rtol=1e-12)
            assert sorted(edited.elements) == sorted(network.elements + addition.elements)
            assert parse(str(edited)) == edited  # still in the one way in which it can be written
            # A group that the addition joins keeps its label; no other label changes.
            assert {n.label for _, n in edited.walk()} >= {n.label for _, n in network.walk()} - {None}


@repeatable
@given(shapes_with_elements(max_leaves=8))
def test_replacements_at_every_place_equal_arrays(shape_and_values):
    shape, values = shape_and_values
    network, values = build(shape), values | ADDED
    for place in network.places():
        for new in ADDITIONS.values():
            edited = network.replaced(place, new)
            extra = network_impedance(new, S, values)
            expected = network_impedance(network, S, values, place.path, lambda _, extra=extra: extra)
            np.testing.assert_allclose(network_impedance(edited, S, values), expected, rtol=1e-12)
            assert parse(str(edited)) == edited


@given(networks(min_leaves=2))
def test_networks_cannot_be_changed(network):
    before = str(network)
    for _, node in network.walk():
        for field in ("members", "name", "_label"):
            with pytest.raises((dataclasses.FrozenInstanceError, AttributeError)):
                setattr(node, field, None)
    network.beside("port", Element("m77"))
    network.in_series(network.elements[0], Element("m77"))
    network.labelled("other")
    assert str(network) == before
    assert hash(network) == hash(parse(before))


def test_leaf_arithmetic_of_the_tests_is_newton_hooke_and_a_damper():
    """The tests' own arithmetic, checked once against numbers."""
    assert [leaf_impedance(name, 2j, 4.0) for name in ("m1", "n1", "r1")] == [8j, -0.125j, 4.0]


@pytest.mark.parametrize(
    ("notation", "words"),
    [
        ("(" * 400 + "m1" + ")" * 400, "nested more than 50 levels"),
        ("(r1|" * 400 + "m1" + ")" * 400, "nested more than 50 levels"),
        ("a:" * 400 + "m1", "nested more than 50 levels"),
        ("m1|" * 40_000 + "m1", "at most 10000 are read"),
        ("m" + "1" * 5000, "is not an element"),
        ("m1\n|\x1b[31m", "is not"),
        (3, "must be text"),
        (None, "must be text"),
    ],
)
def test_what_is_too_deep_long_or_no_text_is_refused_in_one_short_line(notation, words):
    with pytest.raises(InputError) as error:
        parse(notation)
    assert words in str(error.value)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 300


def test_many_parts_are_read_at_once():
    assert len(parse("|".join(f"m{i}" for i in range(1000))).elements) == 1000
