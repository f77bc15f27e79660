"""The notation of power laws, wrappers, shared and held parameters: round trips, and one sentence for each mistake."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from strategies import language, repeatable

from bayes_impedance.errors import InputError
from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.extensions import PowerLaw, Wrapped, wrapped
from bayes_impedance.network.notation import Element, Parallel, Series, parse
from bayes_impedance.network.parameters import LOG, LOGIT, QUANTITIES, SIGNED, Symbol


@repeatable
@given(language(max_leaves=10))
def test_print_and_parse_round_trip(network):
    assert parse(str(network)) == network
    assert parse(f"( {network} )".replace("|", " |\n").replace("[", " [ ").replace("]", " ] ")) == network


@repeatable
@given(language(max_leaves=8))
def test_every_place_can_be_found_and_edited(network):
    for path, node in network.walk():
        place = network.place(str(node))
        assert network.at(place) == node
        if place.path == path:
            edited = network.replaced(place, Element("m99"))
            assert parse(str(edited)) == edited
            assert set(edited.elements) == (set(network.elements) - set(node.elements)) | {"m99"}


def test_what_is_written_is_what_is_built():
    m1, n1 = Element("m1"), Element("n1", None, True)
    assert parse("m1|n1*") == Parallel((m1, n1))
    assert parse("m1=0.0115") == Element("m1", None, False, 0.0115)
    assert parse("m1-p1^a1") == Series((m1, PowerLaw(Symbol("p1"), Symbol("a1"))))
    assert parse("p1*^b2=1.5@1e3") == PowerLaw(Symbol("p1", True), Symbol("b2", value=1.5), 1000.0)
    assert parse("p1=3^0.25") == PowerLaw(Symbol("p1", value=3.0), Symbol("", value=0.25))
    delay = Wrapped(CONSTRUCTS["delay"], (Symbol("d1", True),), Parallel((m1, n1)))
    assert parse("delay[d1*](m1|n1*)") == delay == wrapped("delay", [Symbol("d1", True)], m1 | n1)
    assert parse("late:delay[d1*](m1|n1*)-r1") == delay.labelled("late") - Element("r1")
    three = parse("reflex[k1, d1=0.04, f1*](r1)")
    assert [(p.name, p.link, p.shared, p.held) for p in three.parameters] == [
        ("k1", LOG, False, False),
        ("d1", LOG, False, True),
        ("f1", LOG, True, False),
        ("r1", LOG, False, False),
    ]
    assert three.elements == ("k1", "f1", "r1")


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("m1=1e-3|n1*", "m1=0.001|n1*"),
        ("m1=2.50", "m1=2.5"),
        ("p1 ^ a1 @ 1e2", "p1^a1@100"),
        ("m1=0.1234567890123456789", "m1=0.12345678901234568"),
        ("delay [ d1 = - 1e-5 ] ( (m1) )", "delay[d1=-1e-05](m1)"),
        ("gain[g1=2](skin:(n1|r1))", "gain[g1=2](skin:(n1|r1))"),
        ("(x:offset[k1*](r1))-(m1)", "x:offset[k1*](r1)-m1"),
    ],
)
def test_it_is_printed_in_one_way(text, printed):
    assert str(parse(text)) == printed
    assert str(parse(printed)) == printed


@pytest.mark.parametrize("word", CONSTRUCTS)
@pytest.mark.parametrize("mark", ["", "*", "=1.5"])
def test_links_of_wrappers(word, mark):
    """A signed scale for what is the same for all, or known; a logarithmic one for what differs between people."""
    construct = CONSTRUCTS[word]
    symbols = ",".join(f"{letters[0]}{i}{mark}" for i, letters in enumerate(construct.letters, 1))
    own = parse(f"{word}[{symbols}](r9)").own_parameters
    assert [p.link for p in own] == [
        SIGNED if construct.signed and mark and i == 0 else LOG for i in range(len(construct.letters))
    ]


def test_links_and_units_of_leaves():
    parameters = parse("p1^a1|p2*^b1|m1*|n1|r1").parameters
    assert [p.link for p in parameters] == [LOG, LOGIT, LOG, LOGIT, LOG, LOG, LOG]
    assert [p.unit("N s/m") for p in parameters] == ["N s/m", "", "N s/m", "", "kg", "m/N", "N s/m"]
    own = parse("reflex[k1,d1,f1](lowpass[t1](gain[g1](hysteretic[e1](n1))))").parameters
    assert [p.unit("N s/m") for p in own] == ["N/m", "s", "Hz", "s", "", "", "m/N"]
    assert [p.unit("ohm") for p in own] == ["1/F", "s", "Hz", "s", "", "", "F"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # what a name stands for
        (
            "x1|m1",
            "element 'x1' is of no known kind: its first letter must be m (mass), n (compliance) or r (damper)",
        ),
        ("m1|m1*", "element 'm1' occurs twice in the network: give each element a name of its own"),
        ("p1^a1|p2^a1", "element 'a1' occurs twice in the network: give each element a name of its own"),
        ("gain[g1](gain[g1](n1))", "element 'g1' occurs twice in the network: give each element a name of its own"),
        ("g1:gain[g1](m1)", "label 'g1' is used twice or names an element: give each group a name of its own"),
        # power laws
        ("p1|m1", "network 'p1|m1': '|' at character 3 is not '^' and the power law's exponent, such as p1^a1"),
        ("p1", "network 'p1' ends too early: expected '^' and the power law's exponent, such as p1^a1"),
        ("m1^a1", "'m1^a1' is not a power law: only p can have an exponent, as in p1^a1"),
        (
            "p1^m1",
            "'m1' cannot be an exponent: call it a1 (0 to 1, spring to damper) or b1 (1 to 2, damper to mass)",
        ),
        ("p1^*", "network 'p1^*': '*' at character 4 is not an exponent"),
        ("p1^a1@", "network 'p1^a1@' ends too early: expected a number"),
        ("p1^a1@w", "network 'p1^a1@w': 'w' at character 7 is not a number"),
        ("p1^a1@-3", "'p1^a1@-3': the reference frequency must be above zero and finite"),
        ("p1^a1@1e999", "'p1^a1@inf': the reference frequency must be above zero and finite"),
        # symbols
        ("m1=", "network 'm1=' ends too early: expected a number"),
        ("m1=x", "network 'm1=x': 'x' at character 4 is not a number"),
        ("m1=1*", "network 'm1=1*': '*' at character 5 is not '|', '-' or the end"),
        ("m1**", "network 'm1**': '*' at character 4 is not '|', '-' or the end"),
        # wrappers
        (
            "late[d1](m1)",
            "'late[...]' is unknown: there are delay, highpass, lowpass, gain, hysteretic, offset, line_free, "
            "line_fixed, line_matched, reflex, squeeze_film",
        ),
        ("delay[t1](m1)", "'t1' in delay[...] must begin with d (delay): delay[d1](...)"),
        (
            "offset[n1](r1)",
            "'n1' in offset[...] must begin with m (mass) or r (damper) or k (stiffness): offset[m1](...)",
        ),
        ("delay[d1,d2](m1)", "delay has 1 parameter, not 2: delay[d1](...)"),
        ("reflex[k1,d1](m1)", "reflex has 3 parameters, not 2: reflex[k1, d1, f1](...)"),
        ("delay[](m1)", "network 'delay[](m1)': ']' at character 7 is not the name of a parameter"),
        ("delay[3](m1)", "network 'delay[3](m1)': '3' at character 7 is not the name of a parameter"),
        ("delay[d1(m1)", "network 'delay[d1(m1)': '(' at character 9 is not ']'"),
        ("delay[d1]m1", "network 'delay[d1]m1': 'm1' at character 10 is not '('"),
        ("delay[d1](m1", "network 'delay[d1](m1' ends too early: expected ')'"),
        ("delay[d1]()", "network 'delay[d1]()': ')' at character 11 is not an element such as m1, n1 or r1, or '('"),
    ],
)  # fmt: skip
def test_one_sentence_for_each_mistake(text, message):
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        parse(text)


def test_deep_wrappers_are_refused_like_deep_parentheses():
    with pytest.raises(InputError, match="nested more than 50 levels"):
        parse("".join(f"gain[g{i}](" for i in range(400)) + "m1" + ")" * 400)
    deep = "".join(f"gain[g{i}](" for i in range(49)) + "m1" + ")" * 49
    assert len(parse(deep).elements) == 50


def test_what_is_not_rational_says_so():
    for text, what in (("p1^a1@3|m1", "p1^a1@3"), ("r1-delay[d1](m1)", "delay[...]")):
        network = parse(text)
        with pytest.raises(InputError, match=re.escape(f"{what} has no transfer function that is a ratio")):
            network.transfer_function(dict.fromkeys(network.elements, 1.0))


def test_plain_networks_hold_persons_own_elements_only():
    assert parse("a:(m1|n1)-r1").plain
    for text in ("m1*|n1", "m1=2|n1", "p1^a1|n1", "gain[g1](n1)"):
        assert not parse(text).plain


def test_every_letter_of_a_wrapper_stands_for_a_quantity():
    assert {letter for c in CONSTRUCTS.values() for letters in c.letters for letter in letters} <= set(QUANTITIES)
