"""Conditions that figures must hold."""

from __future__ import annotations

import pytest

from beamseg_batch.errors import ConfigError
from beamseg_batch.evaluation import Gate, check_gates, load_gates

KNOWN = ("recall", "axis_offset.median", "axis_offset.max", "joints.found")


@pytest.mark.parametrize(
    ("text", "gate"),
    [
        ("recall>=0.99", Gate("recall", ">=", 0.99)),
        (" recall == 1 ", Gate("recall", "==", 1.0)),
        ("axis_offset.median<5e-3", Gate("axis_offset.median", "<", 0.005)),
        ("joints.found > 2", Gate("joints.found", ">", 2.0)),
        ("axis_offset.max <= .01", Gate("axis_offset.max", "<=", 0.01)),
    ],
)
def test_load_gates__reads_a_condition(text, gate):
    assert load_gates([text], KNOWN) == (gate,)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("recall", "--require: 'recall' is not a gate; write METRIC SIGN NUMBER"),
        ("recall=1", "is not a gate"),
        ("recall=>1", "is not a gate"),
        ("recall >= ", "is not a gate"),
        ("0.9 <= recall <= 1", "is not a gate"),
        ("", "is not a gate"),
        ("recall>=lots", "the limit 'lots' is not a number"),
        ("recall>=nan", "the limit 'nan' is not a number"),
        ("axis_ofset.median<=1", r"no metric 'axis_ofset\.median'; did you mean 'axis_offset"),
        ("nothing.like.it<=1", "there are: recall, axis_offset.median"),
    ],
)
def test_load_gates__wrong(text, reason):
    with pytest.raises(ConfigError, match=reason):
        load_gates([text], KNOWN)


def test_load_gates__of_a_file(tmp_path):
    file = tmp_path / "gates.yaml"
    file.write_text("# what a release must hold\n- recall >= 0.99\n- axis_offset.max<0.01\n")
    gates = load_gates([f"@{file}", "joints.found==2"], KNOWN)
    assert [str(gate) for gate in gates] == [
        "recall >= 0.99",
        "axis_offset.max < 0.01",
        "joints.found == 2",
    ]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("- recall >= 0.9\n- rcall < 1\n", r"gates\.yaml:2: there is no metric 'rcall'"),
        ("- recall >= 0.9\n\n- recall\n", r"gates\.yaml:3: 'recall' is not a gate"),
        ("recall: 0.9\n", "must be a list of gates"),
        ("- recall: 0.9\n", "must be a list of gates"),
        ("", "must be a list of gates"),
        ("- [\n", "is not valid YAML"),
    ],
)
def test_load_gates__wrong_file(tmp_path, text, reason):
    file = tmp_path / "gates.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=reason):
        load_gates([f"@{file}"], KNOWN)


def test_load_gates__missing_file(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read"):
        load_gates([f"@{tmp_path / 'none.yaml'}"], KNOWN)


@pytest.mark.parametrize(
    ("sign", "outcomes"),
    [
        ("<=", (True, True, False)),
        (">=", (False, True, True)),
        ("==", (False, True, False)),
        ("<", (True, False, False)),
        (">", (False, False, True)),
    ],
)
def test_check_gates__signs(sign, outcomes):
    gate = Gate("recall", sign, 0.5)
    found = tuple(check_gates([gate], {"recall": value})[0].passed for value in (0.4, 0.5, 0.6))
    assert found == outcomes


def test_check_gates__says_what_was_found():
    (check,) = check_gates([Gate("axis_offset.max", "<=", 0.005)], {"axis_offset.max": 0.0408591})
    assert (check.name, check.found) == ("axis_offset.max <= 0.005", "is 0.0408591")
    assert not check.passed


@pytest.mark.parametrize("sign", ["<=", ">=", "==", "<", ">"])
def test_check_gates__a_figure_without_value_fails(sign):
    (check,) = check_gates([Gate("recall", sign, 0.0)], {"recall": None})
    assert not check.passed
    assert "has no value" in check.found
