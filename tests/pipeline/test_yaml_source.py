from __future__ import annotations

import math

import pytest

from scaffold_pipeline.config.yaml_source import parse, parse_scalar, to_yaml
from scaffold_pipeline.errors import ConfigError


def faults_of(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse(text, "c.yaml")
    return [str(fault) for fault in caught.value.faults]


def test_every_value_and_key_has_its_place():
    document = parse("a: 1\nb:\n  - c: [x, y]\n", "c.yaml")
    assert document.values == {"a": 1, "b": [{"c": ["x", "y"]}]}
    assert document.places["b", 0, "c"] == (3, 5)
    assert document.places["b", 0, "c", 1] == (3, 12)


def test_a_fault_stands_at_the_nearest_thing_around_what_is_missing():
    document = parse("a: 1\nb:\n  - c: 2\n", "c.yaml")
    assert str(document.fault(("b", 0, "d", "e"), "is missing")) == "c.yaml:3:5: is missing"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a: [1, 2\nb: 3\n", "c.yaml:2:2: not valid YAML"),
        ("a: 1\n\tb: 2\n", "c.yaml:2:1: not valid YAML"),
        ("a:\n\t- 1\n", "c.yaml:2:1: not valid YAML"),
        ("a: 'open\n", "c.yaml:2:1: not valid YAML"),
        ("a: b: c\n", "c.yaml:1:5: not valid YAML"),
        ("a: *nowhere\n", "c.yaml:1:4: not valid YAML"),
        ("a: !python/name:os.system x\n", "c.yaml:1:4: not valid YAML"),
        ("a: 1\n---\nb: 2\n", "c.yaml:2:1: not valid YAML"),
        ("a: 1\nb: x\x00y\n", "c.yaml:2:5: not valid YAML: unacceptable character #x0000"),
        ("a: 2024-13-45\n", "c.yaml:1:1: not valid YAML"),
    ],
)
def test_what_is_not_yaml_is_one_fault_with_its_place(text: str, fault: str):
    (got,) = faults_of(text)
    assert got.startswith(fault)
    assert "\n" not in got


@pytest.mark.parametrize("text", ["a: &x [1, *x]\n", "a: &x {b: *x}\n", "a: " + "[" * 600 + "]" * 600 + "\n"])
def test_a_value_within_itself_is_refused(text: str):
    (fault,) = faults_of(text)
    assert "an alias refers to a value that contains it, or values are nested too deeply" in fault


def test_aliases_that_unfold_without_end_are_refused():
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    (fault,) = faults_of("\n".join(lines))
    assert "has more than 100000 values" in fault


def test_keys_given_twice_are_faults_at_every_depth():
    document = parse("a: 1\nb:\n  - c: 2\n    c: 3\na: 4\n", "c.yaml")
    assert [str(fault) for fault in document.faults] == [
        "c.yaml:4:5: 'c' is given twice, first on line 3; keep one",
        "c.yaml:5:1: 'a' is given twice, first on line 1; keep one",
    ]


def test_values_are_those_of_yaml_1_2():
    text = "a: 12:30\nb: yes\nc: 0o17\nd: 1e-5\ne: .inf\nf: ~\n"
    assert parse(text, "c.yaml").values == {"a": "12:30", "b": "yes", "c": 15, "d": 1e-5, "e": math.inf, "f": None}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.5", 0.5),
        ("[stl, 3mf]", ["stl", "3mf"]),
        ("true", True),
        ("", None),
        ("[open", "[open"),
        ("2024-13-45", "2024-13-45"),
        ("{a: 1, a: 2}", "{a: 1, a: 2}"),
        ("bone #2.stl", "bone"),
        ("'bone #2.stl'", "bone #2.stl"),
    ],
)
def test_the_text_of_a_setting_is_a_yaml_value_or_stays_text(text: str, value: object):
    assert parse_scalar(text) == value


def test_written_yaml_is_read_back_as_it_was_in_its_order():
    values = {
        "z": [1, -0.1, 1e-7, 1e22, 0.1 + 0.2, 2**63 - 1, True, None],
        "text": ["yes", "1e3", "null", "", " a", "a: b", "#", "x" * 300, "two\nlines", "Größe µm", "0x1f", "12:30"],
        "a": {"c": [], "b": {}},
    }
    document = parse(to_yaml(values), "c.yaml")
    assert document.values == values
    assert list(document.values) == ["z", "text", "a"]
