"""The layout of the package: a folder imports only from folders before it in ORDER, and no files import in a circle.

Imports inside functions and under TYPE_CHECKING count. Files and functions stay within the sizes below. The tests
mirror the package: tests/A/test_b.py tests the module A/b.py.
"""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "foveate"

ORDER = [
    *("types", "errors", "names", "registration"),
    *("io", "geometry"),
    *("models", "scenario", "simulation"),
    *("policies", "planning"),
    *("experiment", "learning"),
    *("evaluation", "recordings", "plotting", "study"),
    *("deploy", "bench", "api", "gym", "stonesoup", "ros", "cli", "__main__"),
]
"""Folders and root modules of the package, from the ground up, a line a storey."""
ROOT_MODULES = 8
FILE_LINES, FUNCTION_LINES, NESTED_FUNCTIONS = 250, 50, 2

TESTS = Path(__file__).parent
TESTED_ELSEWHERE = {
    **dict.fromkeys(("types", "errors"), "test_api.py"),  # names without behaviour
    # The modules of one command, tested through the command line.
    **{f"cli.{name}": "cli/test_cli.py" for name in ("common", "evaluate", "export", "fit", "main", "options", "plan")},
    **{f"cli.{name}": "cli/test_cli.py" for name in ("render", "replay", "train")},
    **{
        f"cli.run.{name}": "cli/test_cli.py"
        for name in ("evaluate", "export", "fit", "plan", "render", "replay", "train")
    },
    **{f"cli.{name}": "cli/test_config.py" for name in ("arguments", "help", "presets", "run.config", "run.presets")},
    "cli.logs": "io/test_progress.py",
    **dict.fromkeys(("cli.run.bench", "bench.report"), "cli/test_bench.py"),
    "cli.run.reproduce": "cli/test_reproduce.py",
    **dict.fromkeys(("cli.view", "cli.run.view"), "plotting/live/test_server.py"),
    **{
        f"deploy.onnx.{name}": "deploy/onnx/test_export.py"
        for name in ("arithmetic", "decision", "graph", "indexing", "shapes", "trace")
    },
    "deploy.onnx.session": "deploy/test_exported.py",
    **dict.fromkeys(("deploy.belief", "deploy.policy"), "test_api.py"),
    **dict.fromkeys(("deploy.tracks", "deploy.history", "deploy.observing"), "deploy/test_tracker.py"),
    "deploy.kalman_polar": "simulation/test_polar.py",  # beside the filter that it equals
    **dict.fromkeys(("gym.render", "gym.task", "simulation.batch"), "gym/test_envs.py"),
    "stonesoup.parts": "stonesoup/test_manager.py",
    # The modules of a training.
    **{f"learning.{name}": "learning/test_loop.py" for name in ("learner", "train", "validation")},
    "learning.run_files": "learning/test_killed.py",
    "learning.critic": "learning/test_actor_critic.py",
    **dict.fromkeys(("learning.sb3.network", "learning.sb3.vec_env"), "learning/sb3/test_ppo.py"),
    # Implementations of one protocol, tested alike.
    **dict.fromkeys(("geometry.fov_planar", "geometry.fov_spatial"), "geometry/test_fov.py"),
    "geometry.way_tables": "geometry/test_ways.py",
    **dict.fromkeys(("geometry.series", "geometry.lie_planar"), "geometry/test_lie.py"),
    **dict.fromkeys(("models.problem", "simulation.records", "simulation.step"), "simulation/test_rollout.py"),
    "simulation.draft": "simulation/test_rollout.py",
    "simulation.drawn": "simulation/test_episodes.py",
    "models.detections.records": "models/detections/test_filter.py",
    "models.target": "scenario/test_target.py",
    "models.obstacles": "geometry/test_sight.py",
    **{
        f"scenario.{name}": "scenario/test_obstacles.py"
        for name in ("obstacle_grids", "random_maps", "random_obstacles")
    },
    "models.robot": "policies/test_tokens.py",
    "models.team": "scenario/test_team.py",
    "learning.windows": "learning/test_trajectories.py",
    "policies.team_tokens": "learning/test_team_play.py",
    **{
        f"simulation.team.{name}": "simulation/team/test_rollout.py"
        for name in ("evidence", "exchange", "radio", "records", "step", "window")
    },
    "simulation.team.mate_scans": "simulation/team/test_tracks.py",
    **dict.fromkeys(("scenario.rows", "simulation.team.starts"), "scenario/test_team.py"),
    **dict.fromkeys(("experiment.experiment", "experiment.learners"), "experiment/test_presets.py"),
    "experiment.run_folder": "experiment/test_checkpoint.py",
    **dict.fromkeys(("evaluation.report", "evaluation.rows"), "evaluation/test_evaluate.py"),
    "evaluation.summary_table": "cli/test_tables.py",
    "evaluation.planners": "planning/test_receding.py",
    "planning.named": "policies/test_heuristics.py",
    "evaluation.plan": "cli/test_cli.py",
    "io.provenance": "test_api.py",
    "io.figures": "plotting/test_figures.py",
    **dict.fromkeys(("io.records", "io.validate"), "io/test_toml.py"),
    **dict.fromkeys(("recordings.velocities", "recordings.moments"), "recordings/test_motion.py"),
    **dict.fromkeys(("recordings.definitions", "recordings.unpack"), "recordings/test_bags.py"),
    "ros.main": "ros/test_node.py",
    "ros.records": "ros/test_core.py",
    **{f"recordings.{name}": "recordings/test_tables.py" for name in ("clock", "fixes", "layout", "rows")},
    "recordings.unused": "recordings/test_outliers.py",
    **{f"recordings.{name}": "recordings/test_replay.py" for name in ("compare", "measures", "results", "starts")},
    **dict.fromkeys(("recordings.choice", "recordings.methods"), "recordings/test_split.py"),
    "recordings.replay_table": "cli/test_tables.py",
    **{
        f"plotting.{name}": "plotting/test_figures.py"
        for name in ("animation", "episode_data", "replay_figure", "scene", "snapshot")
    },
    "plotting.track_data": "plotting/test_undetected.py",
    **dict.fromkeys(("plotting.render", "plotting.replay"), "cli/test_cli.py"),
    **{
        f"plotting.live.{name}": "plotting/live/test_server.py"
        for name in ("chart", "mates", "player", "primitives", "scene", "sources")
    },
    **dict.fromkeys(("study.jobs", "study.methods", "study.study"), "study/test_run.py"),
    "io.tables": "study/test_tables.py",
    "study.publish": "cli/test_reproduce.py",
}
"""Test files, within tests, of modules that have none of their own name."""


def modules(source: Path) -> dict[str, Path]:
    """The files of the package by their name within it: "geometry.lie", "geometry.__init__", "__init__"."""
    return {".".join(path.relative_to(source).with_suffix("").parts): path for path in source.rglob("*.py")}


def resolve(name: str, known: dict[str, Path]) -> str:
    """The module that an import of `name`, within the package, reaches: itself, or what holds it."""
    while name not in known:
        package = f"{name}.__init__".lstrip(".")
        if package in known:
            return package
        name = name.rpartition(".")[0]
    return name


def imports(module: str, known: dict[str, Path]) -> set[str]:
    """The modules of the package that a file imports, at its top or inside of functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(known[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = ["foveate", *module.split(".")][: -node.level] if node.level else []
            base = ".".join([*package, *([node.module] if node.module else [])])
            names |= {f"{base}.{alias.name}" for alias in node.names}
    inside = {name.partition(".")[2] for name in names if name.partition(".")[0] == "foveate"}
    return {resolve(name, known) for name in inside} - {"__init__"}


def violations(source: Path, order: list[str]) -> list[str]:
    """One line for every folder without a place, import that does not lead down, and cycle."""
    known = modules(source)
    graph = {module: imports(module, known) for module in sorted(known) if module != "__init__"}
    folders = {module: module.partition(".")[0] for module in graph}
    found = [f"{module} has no place in ORDER" for module in graph if folders[module] not in order]
    for module, targets in graph.items():
        for target in sorted(targets):
            here, there = folders[module], folders[target]
            if here in order and there in order and order.index(there) > order.index(here):
                found.append(f"{module} imports {target}, which is not below it")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append(f"cycle: {' -> '.join(error.args[1])}")
    return found


def oversized(source: Path) -> list[str]:
    """One line for every file and function that is longer, or nested deeper, than the limits."""
    found = []
    for name, path in sorted(modules(source).items()):
        text = path.read_text(encoding="utf-8")
        if (count := len(text.splitlines())) > FILE_LINES:
            found.append(f"{name}: {count} lines")
        found += [f"{name}.{what}" for what in _long_functions(ast.parse(text), 0)]
    return found


def _long_functions(node: ast.AST, depth: int) -> list[str]:
    found = []
    for child in ast.iter_child_nodes(node):
        is_function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
        if is_function:
            length = child.end_lineno - child.lineno + 1
            found += [f"{child.name}: {length} lines"] * (length > FUNCTION_LINES)
            found += [f"{child.name}: nested {depth + 1} deep"] * (depth + 1 > NESTED_FUNCTIONS)
        found += _long_functions(child, depth + is_function)
    return found


def test_imports_point_to_lower_folders():
    assert violations(SOURCE, ORDER) == []


def test_every_place_in_the_order_exists():
    folders = {module.partition(".")[0] for module in modules(SOURCE)} - {"__init__"}
    assert set(ORDER) == folders
    assert len(ORDER) == len(set(ORDER))


def test_the_root_holds_few_modules():
    assert len([path for path in SOURCE.glob("*.py") if path.name != "__init__.py"]) <= ROOT_MODULES


def untested(source: Path, tests: Path, elsewhere: dict[str, str]) -> list[str]:
    """One line for every module without a test file, and for every entry of `elsewhere` that is out of date."""
    known = {name for name in modules(source) if name.rpartition(".")[2] not in ("__init__", "__main__")}
    own = {name: tests.joinpath(*name.split(".")[:-1], f"test_{name.split('.')[-1]}.py") for name in known}
    found = [f"{name}: no {own[name].relative_to(tests)}" for name in known - set(elsewhere) if not own[name].exists()]
    for name, file in elsewhere.items():
        if name not in known:
            found.append(f"{name} is no module")
        elif own[name].exists():
            found.append(f"{name} has its own test file")
        elif not (tests / file).exists():
            found.append(f"{name}: no {file}")
    return sorted(found)


def test_every_module_has_a_test_file():
    assert untested(SOURCE, TESTS, TESTED_ELSEWHERE) == []


def test_a_module_without_a_test_file_is_caught(tmp_path: Path):
    source, tests = build(tmp_path / "src", {}), tmp_path / "tests"
    (tests / "rooms").mkdir(parents=True)
    for name in ("test_ground.py", "rooms/test_one.py", "rooms/test_two.py"):
        (tests / name).write_text("", encoding="utf-8")
    elsewhere = {"rooms.one": "test_ground.py", "doors.a": "test_doors.py", "attic": "test_ground.py"}
    assert untested(source, tests, elsewhere) == [
        "attic is no module",
        "doors.a: no test_doors.py",
        "doors.b: no doors/test_b.py",
        "rooms.one has its own test file",
    ]


def test_files_and_functions_are_short():
    assert oversized(SOURCE) == []


SAMPLE_ORDER = ["ground", "rooms", "doors"]
SAMPLE = {
    "__init__": "",
    "ground": "import os\nfrom numpy import array\nimport foveatee.doors.main",
    "rooms.__init__": "",
    "rooms.one": "from foveate.ground import name\nfrom foveate import __version__",
    "rooms.two": "from . import one\nfrom ..ground import name",
    "doors.__init__": "from foveate.doors.a import run",
    "doors.a": "def run():\n    import foveate.rooms.two as two\n    from foveate.doors import b",
    "doors.b": "from foveate.rooms import one",
}


def build(folder: Path, changes: dict[str, str]) -> Path:
    for module, text in {**SAMPLE, **changes}.items():
        path = folder.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def test_a_sound_layout_passes(tmp_path: Path):
    sample = build(tmp_path, {"doors.a": "def run():\n    import foveate.rooms.two as two"})
    assert violations(sample, SAMPLE_ORDER) == []
    assert oversized(sample) == []


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"ground": "import foveate.rooms.one"}, "ground imports rooms.one, which is not below it"),
        ({"ground": "from foveate.rooms import one"}, "ground imports rooms.one, which is not below it"),
        ({"ground": "from foveate.rooms.one import name"}, "ground imports rooms.one, which is not below it"),
        ({"ground": "def f():\n    from .rooms import one"}, "ground imports rooms.one, which is not below it"),
        (
            {"ground": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from foveate.rooms import one"},
            "ground imports rooms.one, which is not below it",
        ),
        ({"rooms.__init__": "from ..doors.a import name"}, "rooms.__init__ imports doors.a, which is not below it"),
        ({"ground": "import foveate.ground"}, "cycle: ground -> ground"),
        ({"doors.b": "from . import a"}, "cycle: doors.a -> doors.b -> doors.a"),
        ({"attic": ""}, "attic has no place in ORDER"),
        ({"attic.__init__": "", "attic.box": ""}, "attic.box has no place in ORDER"),
    ],
)
def test_an_unsound_layout_is_caught(tmp_path: Path, changes: dict[str, str], complaint: str):
    base = {"doors.__init__": ""}
    assert complaint in violations(build(tmp_path, {**base, **changes}), SAMPLE_ORDER)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x = 1\n" * (FILE_LINES + 1), f"ground: {FILE_LINES + 1} lines"),
        ("def f():\n" + "    x = 1\n" * FUNCTION_LINES, f"ground.f: {FUNCTION_LINES + 1} lines"),
        ("def f():\n def g():\n  def h():\n   pass\n", "ground.h: nested 3 deep"),
    ],
)
def test_oversize_is_caught(tmp_path: Path, text: str, complaint: str):
    assert complaint in oversized(build(tmp_path, {"ground": text}))
