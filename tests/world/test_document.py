"""YAML documents: lines, and problems in plain words."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from beamseg_batch.errors import BeamsegError, WorldError
from beamseg_batch.schema import Node, Positive, Vector3
from beamseg_batch.world.document import load_document, validate
from tests.world.worlds import written

TEXT = """\
name: a world
base: &base {radius: 0.1,
  ends: [[0, 0, 0],
         [1, 0, 0]]}
members:
  - radius: 0.2
    ends: [[0, 0, 0], [0, 0, 1]]

  - {radius: 0.3}
  - <<: *base
    shape: round
"""


class Bar(Node):
    radius: Positive = 0.05
    shape: Literal["round", "square"] = "round"
    ends: tuple[Vector3, Vector3] | None = None
    count: int = 1

    @model_validator(mode="after")
    def _no_seven(self):
        if self.count == 7:
            raise ValueError("seven is too many")
        return self


class Orbit(Node):
    kind: Literal["orbit"]
    distance: Positive


class Line(Node):
    kind: Literal["line"]
    speed: Positive = 1.0


class Description(Node):
    members: tuple[Bar, ...] = ()
    flight: Annotated[Orbit | Line, Field(discriminator="kind")] | None = None
    at_most: Annotated[tuple[float, ...], Field(max_length=2)] = ()
    title: str = ""


def refusal(folder, text, model=Description, key=()):
    document = load_document(written(folder, text))
    with pytest.raises(WorldError) as caught:
        validate(model, document, key)
    return str(caught.value).replace(f"{folder}/", "")


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ((), None),
        (("name",), 1),
        (("base",), 2),
        (("base", "radius"), 2),
        (("base", "ends"), 3),
        (("base", "ends", 1), 4),
        (("base", "ends", 1, 2), 4),
        (("members",), 5),
        (("members", 0), 6),
        (("members", 0, "ends"), 7),
        (("members", 1), 9),
        (("members", 2, "shape"), 11),
        (("members", 2, "radius"), 2),
    ],
)
def test_line_of__counts_from_one(tmp_path, key, line):
    assert load_document(written(tmp_path, TEXT)).line_of(key) == line


@pytest.mark.parametrize(
    ("key", "line"),
    [
        (("nothing",), None),
        (("members", 9), 5),
        (("members", 1, "ends"), 9),
        (("members", "radius"), 5),
        (("name", "first"), 1),
        (("name", 0), 1),
        (("base", 0), 2),
    ],
)
def test_line_of__place_that_is_not_there(tmp_path, key, line):
    assert load_document(written(tmp_path, TEXT)).line_of(key) == line


def test_load_document__holds_plain_values(tmp_path):
    document = load_document(written(tmp_path, TEXT))
    assert type(document.data) is dict
    assert document.data["members"][2] == {
        "radius": 0.1,
        "ends": [[0, 0, 0], [1, 0, 0]],
        "shape": "round",
    }
    assert document.value(("members", 1, "radius")) == 0.3
    assert document.path == tmp_path / "world.yaml"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "world.yaml: is empty"),
        (b"# nothing\n", "world.yaml: is empty"),
        (b"- 1\n", "world.yaml: must be a mapping of keys to values"),
        (b"1: 2\n", "world.yaml: must be a mapping of keys to values"),
        (b"a: 1\nb: [1,\n", "world.yaml:3: is not valid YAML: "),
        (b"a: 1\nb: 2\na: 3\n", "world.yaml:3: is not valid YAML: found duplicate key"),
        (b"a: 1\n\tb: 2\n", "world.yaml:2: is not valid YAML: "),
        (b"a: *b\n", "world.yaml:1: is not valid YAML: found undefined alias"),
        (b"a: !!python/object:os.system x\n", "world.yaml:1: is not valid YAML: "),
        (b"a: 2001-99-99\n", "world.yaml: is not valid YAML: "),
        (b"[[]: 1]: 2\n", "world.yaml: is not valid YAML: "),
        (b"a: \xff\xfe\n", "world.yaml: is not valid YAML: 'utf-8' codec"),
        (b"a: \0\n", "world.yaml: is not valid YAML: "),
        (b"[" * 1000, "world.yaml: is not valid YAML: "),
    ],
)
def test_load_document__raise_on_a_file_that_is_none(tmp_path, content, message):
    (tmp_path / "world.yaml").write_bytes(content)
    with pytest.raises(WorldError) as caught:
        load_document(tmp_path / "world.yaml")
    assert str(caught.value).removeprefix(f"{tmp_path}/").startswith(message)
    assert "\n" not in str(caught.value)


def test_load_document__raise_on_a_missing_file(tmp_path):
    with pytest.raises(WorldError, match=r"none\.yaml: cannot be read: No such file"):
        load_document(tmp_path / "none.yaml")


def test_world_error__is_one_of_ours():
    assert issubclass(WorldError, BeamsegError)
    assert issubclass(WorldError, ValueError)
    assert WorldError("").exit_code == 2


def test_validate__part_of_a_document(tmp_path):
    document = load_document(written(tmp_path, TEXT))
    assert validate(Bar, document, ("members", 1)).radius == 0.3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "members:\n- {}\n- radius: -0.05\n",
            "world.yaml:3: members[1].radius: must be above 0, not -0.05",
        ),
        ("members:\n- radius: x\n", "world.yaml:2: members[0].radius: must be a number, not 'x'"),
        ("members:\n- radius: .nan\n", "world.yaml:2: members[0].radius: must be finite, not nan"),
        ("members:\n- count: 1.5\n", "2: members[0].count: must be a whole number, not 1.5"),
        (
            "members:\n- shape: hexagon\n",
            "world.yaml:2: members[0].shape: must be 'round' or 'square', not 'hexagon'",
        ),
        (
            "members:\n- radius: 1\n  raduis: 2\n",
            "world.yaml:3: members[0].raduis: unknown key; did you mean 'radius'?",
        ),
        (
            "members:\n- xyzzy: 2\n",
            "members[0].xyzzy: unknown key; there are: radius, shape, ends, count",
        ),
        ("membres: []\n", "world.yaml:1: membres: unknown key; did you mean 'members'?"),
        ("members: 5\n", "world.yaml:1: members: must be a list, not 5"),
        ("members: [5]\n", "members[0]: must be a mapping of keys to values, not 5"),
        ("members:\n- ends: [[0, 0, 0], [1, 0]]\n", "2: members[0].ends[1][2]: is missing"),
        ("members:\n- count: 7\n", "world.yaml:2: members[0]: seven is too many"),
        ("at_most: [1, 2, 3]\n", "at_most: must hold at most 2 values, not [1, 2, 3]"),
        ("title: 5\n", "world.yaml:1: title: must be text, not 5"),
        ("flight: {kind: orbt}\n", "'kind' must be one of 'orbit', 'line'"),
        ("flight: {distance: 1}\n", "world.yaml:1: flight: 'kind' is missing"),
        ("flight:\n  kind: orbit\n", "world.yaml:1: flight.distance: is missing"),
        (
            "flight:\n  kind: orbit\n  distance: 0\n",
            "world.yaml:3: flight.distance: must be above 0, not 0",
        ),
        (
            "flight:\n  kind: line\n  sped: 0\n",
            "world.yaml:3: flight.sped: unknown key; did you mean 'speed'?",
        ),
    ],
)
def test_validate__says_where_and_what(tmp_path, text, message):
    said = refusal(tmp_path, text)
    assert message in said
    assert "\n" not in said


def test_validate__a_line_for_each_problem(tmp_path):
    text = "members:\n- radius: -1\n- shape: x\ntitle: []\n"
    assert [line.split(": ")[1] for line in refusal(tmp_path, text).splitlines()] == [
        "members[0].radius",
        "members[1].shape",
        "title",
    ]


def test_validate__part_says_the_whole_place(tmp_path):
    said = refusal(tmp_path, TEXT.replace("0.3", "-3"), Bar, ("members", 1))
    assert said == "world.yaml:9: members[1].radius: must be above 0, not -3"


def test_validate__missing_part(tmp_path):
    assert refusal(tmp_path, TEXT, Bar, ("flight",)) == "world.yaml: flight: is missing"
    assert refusal(tmp_path, TEXT, Bar, ("members", 7)) == "world.yaml:5: members[7]: is missing"


def test_validate__huge_value_is_shortened(tmp_path):
    text = "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]\n"
    for name, before in zip("bcdefgh", "abcdefg", strict=True):
        text += f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    said = refusal(tmp_path, text + "title: *h\n")
    assert "title: must be text, not [[[...]" in said
    assert max(map(len, said.splitlines())) < 200
