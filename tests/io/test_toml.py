"""A written file reads back the same; wrong input is rejected in one line that names file, key and value."""

import math
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foveate.errors import InputError
from foveate.io.records import from_table, to_table
from foveate.io.toml import digest, dumps_toml, load_toml, save_toml


@dataclass(frozen=True, kw_only=True)
class Triangle:
    shape: Literal["triangle", "wedge"] = "triangle"
    depth: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Ball:
    shape: Literal["ball"] = "ball"
    frame: Literal["body", "world"] = "body"
    radius: float

    def __post_init__(self) -> None:
        if self.radius <= 0:
            raise InputError(f"radius = {self.radius}: expected a positive number\nof metres")


@dataclass(frozen=True, kw_only=True)
class Box:
    frame: Literal["body", "world"] = "world"
    shape: Literal["box"] = "box"
    corners: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Agent:
    limits: tuple[float, float] = (0.0, 4.0)
    name: str = "robot"
    view: Triangle | Ball | Box = Triangle()


@dataclass(frozen=True, kw_only=True)
class Scenario:
    steps: int
    drifting: bool = False
    tau: float = 1.0
    drift: float | None
    frame: Literal["body", "world"] = "body"
    mixed: Literal[1, True, "all"] = "all"
    seed: int | None = None
    noise: tuple[tuple[float, ...], ...] = ((0.04, 0.0), (0.0, 0.04))
    labels: tuple[str, ...] = ()
    agent: Agent = field(default_factory=Agent)
    extra: Triangle | Ball | None = None
    boxes: tuple[Box, ...] = ()
    κ: float = 0.4


numbers = st.floats(allow_nan=False, allow_infinity=False)
triangles = st.builds(Triangle, shape=st.sampled_from(["triangle", "wedge"]), depth=numbers)
balls = st.builds(Ball, radius=st.floats(1e-300, 1e300))
boxes = st.builds(Box, corners=st.lists(st.tuples(numbers, numbers), max_size=3).map(tuple))
scenarios = st.builds(
    Scenario,
    steps=st.integers(),
    drifting=st.booleans(),
    tau=numbers,
    drift=st.none() | numbers,
    frame=st.sampled_from(["body", "world"]),
    mixed=st.sampled_from([1, True, "all"]),
    seed=st.none() | st.integers(),
    noise=st.lists(st.lists(numbers, max_size=3).map(tuple), max_size=3).map(tuple),
    labels=st.lists(st.text(st.characters(codec="utf-8")), max_size=3).map(tuple),
    agent=st.builds(
        Agent,
        limits=st.tuples(numbers, numbers),
        name=st.text(st.characters(codec="utf-8")),
        view=triangles | balls | boxes,
    ),
    extra=st.none() | triangles | balls,
    boxes=st.lists(boxes, max_size=2).map(tuple),
    κ=numbers,
)


@settings(deadline=None, max_examples=50)
@given(scenario=scenarios, header=st.text(st.characters(codec="ascii", exclude_categories=["Cc"])))
def test_written_toml_reads_back_the_same(scenario: Scenario, header: str):
    text = dumps_toml(scenario, header)
    again = from_table(Scenario, tomllib.loads(text), "written")
    assert again == scenario
    assert type(again.mixed) is type(scenario.mixed)
    assert dumps_toml(again, header) == text
    assert digest(again) == digest(scenario)


@settings(deadline=None, max_examples=30)
@given(one=scenarios, other=scenarios)
def test_digest_tells_different_configurations_apart(one: Scenario, other: Scenario):
    assert (digest(one) == digest(other)) == (to_table(one) == to_table(other))


def test_written_toml_is_as_a_person_would_write_it():
    scenario = Scenario(
        steps=9,
        drift=None,
        tau=2,
        labels=('a "quoted"\tname\x7f',),
        boxes=(Box(corners=((1.0, 1e-7),)),),
        extra=Ball(radius=0.5),
    )
    assert dumps_toml(scenario, "The paper's scenario\n\nsecond line").splitlines() == [
        "# The paper's scenario",
        "#",
        "# second line",
        "steps = 9",
        "drifting = false",
        "tau = 2.0",
        'frame = "body"',
        'mixed = "all"',
        "noise = [[0.04, 0.0], [0.0, 0.04]]",
        r'labels = ["a \"quoted\"\tname\u007f"]',
        'boxes = [{frame = "world", shape = "box", corners = [[1.0, 1e-07]]}]',
        '"κ" = 0.4',
        "",
        "[agent]",
        "limits = [0.0, 4.0]",
        'name = "robot"',
        "",
        "[agent.view]",
        'shape = "triangle"',
        "depth = 2.0",
        "",
        "[extra]",
        'shape = "ball"',
        'frame = "body"',
        "radius = 0.5",
    ]


def test_digest_is_the_same_in_every_process_and_for_equal_instances():
    assert digest(Triangle()) == "e24769e82953067c"
    assert digest(Triangle(depth=2)) == digest(Triangle())
    assert digest(Triangle(depth=2.5)) != digest(Triangle())


def test_keys_left_out_take_their_defaults(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text("steps = 3\ntau = 1\n[agent.view]\nshape = 'ball'\nradius = 3\n")
    loaded = load_toml(Scenario, path)
    assert loaded == Scenario(steps=3, drift=None, agent=Agent(view=Ball(radius=3.0)))
    assert type(loaded.tau) is float


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("step = 3", "step = 3: unknown key; did you mean steps?"),
        ("zzz = 3", "zzz = 3: unknown key; known are steps, drifting, tau"),
        ("steps = 1\n[agent]\nlimit = 3", "agent.limit = 3: unknown key; did you mean limits?"),
        ("tau = 1.0", "steps: is missing; expected a whole number"),
        ("steps = 1.0", "steps = 1.0: expected a whole number"),
        ("steps = true", "steps = True: expected a whole number"),
        ("tau = true", "tau = True: expected a finite number"),
        ("tau = '1'", "tau = '1': expected a finite number"),
        ("tau = nan", "tau = nan: expected a finite number"),
        ("tau = -inf", "tau = -inf: expected a finite number"),
        ("tau = 1979-05-27", "tau = datetime.date(1979, 5, 27): expected a finite number"),
        (f"tau = {'9' * 400}", f"tau = {'9' * 57}...: expected a finite number"),
        (f"tau = 0x{'f' * 5000}", "tau = a number of thousands of digits: expected a finite number"),
        ("drifting = 1", "drifting = 1: expected true or false"),
        ("frame = 'bdy'", "frame = 'bdy': expected one of 'body', 'world'"),
        ("mixed = 1.0", "mixed = 1.0: expected one of 1, True, 'all'"),
        ("agent = 3", "agent = 3: expected a table"),
        ("[agent]\nname = 3", "agent.name = 3: expected a text in quotes"),
        ("[agent]\nlimits = [1, 2, 3]", "agent.limits = [1, 2, 3]: expected a list of 2 values"),
        ("[agent]\nlimits = 1", "agent.limits = 1: expected a list of 2 values, each a finite number"),
        ("[agent]\nlimits = [0, 'x']", "agent.limits[1] = 'x': expected a finite number"),
        ("noise = 1", "noise = 1: expected a list of values, each a list of values, each a finite number"),
        ("noise = [[1], [2, inf]]", "noise[1][1] = inf: expected a finite number"),
        ("[agent]\nview = 'ball'", "agent.view = 'ball': expected a table"),
        (
            "[agent.view]\ndepth = 1",
            "agent.view.shape: is missing; expected one of 'triangle', 'wedge', 'ball'",
        ),
        (
            "[agent.view]\nshape = 'bal'",
            "agent.view.shape = 'bal': expected one of 'triangle', 'wedge', 'ball'",
        ),
        ("[agent.view]\nshape = ['ball']", "agent.view.shape = ['ball']: expected one of 'triangle'"),
        ("[agent.view]\nshape = 'ball'", "agent.view.radius: is missing; expected a finite number"),
        ("[agent.view]\nshape = 'ball'\ndepth = 1", "agent.view.depth = 1: unknown key; known are shape"),
        (
            "[agent.view]\nshape = 'ball'\nradius = -1",
            "agent.view: radius = -1.0: expected a positive number of metres",
        ),
        (
            "boxes = [{shape = 'box', corners = [[1]]}]",
            "boxes[0].corners[0] = [1]: expected a list of 2 values",
        ),
        ("tau = 1 2", "is not TOML: "),
        ("tau = ", "is not TOML: "),
        ("tau = 1\ntau = 2", "is not TOML: "),
        (f"tau = {'9' * 5000}", "is not TOML: "),
        (f"noise = {'[' * 10_000}", "is not TOML: "),
    ],
)
def test_wrong_input_is_named_in_one_line(tmp_path: Path, text: str, problem: str):
    path = tmp_path / "run.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match="run") as caught:
        load_toml(Scenario, path)
    assert str(caught.value).startswith(f"{path}: {problem}")
    assert len(str(caught.value).splitlines()) == 1


def test_unreadable_files_are_named_in_one_line(tmp_path: Path):
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    for name, problem in [("absent", "no such file"), (".", "is a folder"), ("latin", "byte 8 is not UTF-8")]:
        path = tmp_path / (name if name == "." else f"{name}.toml")
        with pytest.raises(ValueError, match=problem) as caught:
            load_toml(Scenario, path)
        assert str(caught.value).startswith(f"{path}: ")
        assert len(str(caught.value).splitlines()) == 1


def test_a_refusal_of_the_whole_names_the_source_alone():
    with pytest.raises(ValueError, match=r"^flags: radius = 0\.0: expected a positive number of metres$"):
        from_table(Ball, {"radius": 0}, "flags")


@pytest.mark.parametrize(
    ("instance", "problem"),
    [
        (Triangle(depth=math.nan), r"Triangle: depth = nan: expected a finite number"),
        (Agent(view=Triangle(depth=math.inf)), r"Agent: view\.depth = inf: expected a finite number"),
    ],
)
def test_writing_rejects_unreadable_values(instance: Any, problem: str):
    with pytest.raises(ValueError, match=problem):
        dumps_toml(instance)


def test_none_is_written_only_where_it_is_the_default():
    @dataclass(frozen=True, kw_only=True)
    class Limited:
        top: float | None = 1.0
        each: tuple[float | None, ...] = ()

    assert to_table(Limited()) == {"top": 1.0, "each": []}
    with pytest.raises(ValueError, match="Limited: would read back otherwise; None can be written only"):
        to_table(Limited(top=None))
    with pytest.raises(ValueError, match=r"Limited: each\[0\] = None: expected a number"):
        to_table(Limited(each=(None,)))


def test_one_member_of_a_union_may_lack_the_tag():
    """A second kind joins one whose tables, and digests, were made without a tag; both may share other fields."""

    @dataclass(frozen=True, kw_only=True)
    class Old:
        mode: Literal["a", "b"] = "a"
        count: int = 1

    @dataclass(frozen=True, kw_only=True)
    class New:
        kind: Literal["new"]
        mode: Literal["a", "c"] = "a"

    @dataclass(frozen=True, kw_only=True)
    class Before:
        part: Old = Old()

    @dataclass(frozen=True, kw_only=True)
    class After:
        part: Old | New = Old()

    assert from_table(After, {"part": {"count": 3}}, "test") == After(part=Old(count=3))
    assert from_table(After, {"part": {"kind": "new", "mode": "c"}}, "test") == After(part=New(kind="new", mode="c"))
    for each in (After(part=Old(mode="b")), After(part=New(kind="new"))):
        assert from_table(After, to_table(each), "test") == each
    assert digest(After()) == digest(Before())
    with pytest.raises(ValueError, match=r"part\.kind = 'old': expected 'new'"):
        from_table(After, {"part": {"kind": "old"}}, "test")
    with pytest.raises(ValueError, match=r"part\.count = 3: unknown key"):
        from_table(After, {"part": {"kind": "new", "count": 3}}, "test")


def test_a_table_without_a_tag_means_the_member_that_has_a_default_for_it():
    @dataclass(frozen=True, kw_only=True)
    class Usual:
        kind: Literal["usual"] = "usual"
        count: int = 1

    @dataclass(frozen=True, kw_only=True)
    class Other:
        kind: Literal["other"]
        count: int = 2

    @dataclass(frozen=True, kw_only=True)
    class Both:
        part: Usual | Other = Usual()

    assert from_table(Both, {"part": {"count": 3}}, "test").part == Usual(count=3)
    assert from_table(Both, {"part": {"kind": "other"}}, "test").part == Other(kind="other")


@dataclass(frozen=True, kw_only=True)
class Renamed:
    RENAMED: ClassVar[dict[str, str]] = {"breadth": "width"}
    width: float = 1.0
    depth: float = 2.0


@dataclass(frozen=True, kw_only=True)
class HoldsRenamed:
    view: Renamed = Renamed()


def test_old_key_is_read_as_the_new_one(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text("[view]\nbreadth = 3\n")
    assert load_toml(HoldsRenamed, path) == HoldsRenamed(view=Renamed(width=3.0))
    assert "width = 3.0" in dumps_toml(load_toml(HoldsRenamed, path))
    path.write_text("[view]\nbreadth = 'x'\n")
    with pytest.raises(InputError, match=r"view\.width = 'x': expected a finite number"):
        load_toml(HoldsRenamed, path)


def test_old_and_new_key_together_are_rejected(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text("[view]\nbreadth = 3\nwidth = 4\n")
    with pytest.raises(
        InputError, match=r"run\.toml: view\.breadth = 3: is the former name of width: give one of them"
    ):
        load_toml(HoldsRenamed, path)


def test_sealed_file_with_an_old_key_keeps_its_digest(tmp_path: Path):
    @dataclass(frozen=True, kw_only=True)
    class Holds:
        breadth: float = 1.0

    old, path = Holds(breadth=3.0), tmp_path / "run.toml"
    save_toml(old, path)
    text = path.read_text().replace("foveate-holds", "foveate-renamed")
    path.write_text(text)
    assert load_toml(Renamed, path) == Renamed(width=3.0)
    path.write_text(text.replace("breadth = 3.0", "breadth = 3.5"))
    with pytest.raises(InputError, match="does not fit its digest"):
        load_toml(Renamed, path)


@dataclass(frozen=True, kw_only=True)
class Lighter:
    REMOVED: ClassVar[tuple[str, ...]] = ("weight", "colour")
    width: float = 1.0


def test_removed_keys_are_ignored_and_not_written(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text("width = 3\nweight = [1, 2]\n")
    assert load_toml(Lighter, path) == Lighter(width=3.0)
    assert dumps_toml(load_toml(Lighter, path)).split() == ["width", "=", "3.0"]
    path.write_text("width = 3\nweigth = 4\n")
    with pytest.raises(InputError, match=r"run\.toml: weigth = 4: unknown key; did you mean width\?"):
        load_toml(Lighter, path)


def test_sealed_file_with_a_removed_key_keeps_its_digest(tmp_path: Path):
    @dataclass(frozen=True, kw_only=True)
    class Heavy:
        width: float = 1.0
        weight: float = 2.0

    path = tmp_path / "run.toml"
    save_toml(Heavy(), path)
    text = path.read_text().replace("foveate-heavy", "foveate-lighter")
    path.write_text(text)
    assert load_toml(Lighter, path) == Lighter()
    path.write_text(text.replace("weight = 2.0", "weight = 3.0"))
    with pytest.raises(InputError, match="does not fit its digest"):
        load_toml(Lighter, path)


def test_fields_of_types_that_toml_has_not_are_a_mistake_of_ours():
    @dataclass(frozen=True, kw_only=True)
    class Odd:
        table: dict[str, int] | None = None
        either: Ball | Triangle | int | None = None

    with pytest.raises(TypeError, match="table: a configuration cannot hold"):
        from_table(Odd, {"table": {"a": 1}}, "test")
    with pytest.raises(TypeError, match="no Literal field tells"):
        from_table(Odd, {"either": 3}, "test")


def test_reading_a_configuration_does_not_load_jax():
    code = "import sys, foveate.io.toml; sys.exit('jax' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
