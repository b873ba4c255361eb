"""A file of foveate imports only from floors below it, or from files listed above it on its own floor."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "foveate"

FLOORS = [
    ["types", "linalg", "checks", "files", "configuration", "arrays", "published", "statistics"],
    ["geometry.lie", "geometry.space", "geometry.safe", "geometry.fov", "geometry.fov_spatial"],
    ["models.agent", "models.target", "models.sensor", "models.belief", "models.absence", "models.gate"],
    [
        *("problem", "agent_settings", "view_settings", "target_settings", "scenario"),
        *("scenes", "rollout", "episodes", "lifting", "environment"),
    ],
    [
        *(
            "policies.inputs",
            "policies.layers",
            "policies.attention",
            "policies.pointer",
            "policies.handmade",
        ),
        *("planning.information", "planning.tours", "planning.shooting", "planning.receding"),
    ],
    [
        *(
            "learner_settings",
            "settings",
            "provenance",
            "checkpoint",
            "measures",
            "evaluation",
            "summary",
            "planned",
            "yardstick",
            "poses",
            "film",
        ),
        *("closeness", "comparison", "methods", "robustness", "units", "study"),
        *("recorded", "motion_fit", "fit", "replay", "runs"),
    ],
    [
        *(
            "learning.sensitivity",
            "learning.devices",
            "learning.gradient",
            "learning.policy_gradient",
            "learning.actor_critic",
            "learning.events",
            "learning.judging",
            "learning.training",
        ),
        *(
            "learning.batch",
            "learning.torch_attention",
            "learning.vec_env",
            "learning.ppo",
            "learning.learner",
            "reproduction",
        ),
    ],
    [
        "drawing",
        "solids",
        "drawing_spatial",
        "stages",
        "figures",
        "figures_comparison",
        "figures_robustness",
        "animation",
        "pages",
        "progress",
        "results",
        "report",
        "publication",
        "gym_task",
        "gym_screen",
        "gym",
        "beliefs",
        "tracker",
        "onnx_graph",
        "onnx_networks",
        "export",
        "trained_policy",
        "api",
        "stonesoup_parts",
        "stonesoup",
        "view_stage",
        "view_chart",
        "view",
        "timing",
        "benchmarks",
        "cli.*",
    ],
]
"""From the ground up; files may be missing. "cli.*" is any module of that package, in any order, acyclic.

An `__init__` that is not listed stands under the ground: all may import it, it may import nothing of ours.
"""


def place(module: str, floors: list[list[str]]) -> tuple[int, int] | None:
    """The floor of a module and its position there; None if it has no place."""
    package = module.rpartition(".")[0]
    for number, floor in enumerate(floors):
        for position, entry in enumerate(floor):
            if entry == module or (package and entry == f"{package}.*"):
                return number, position
    return (-1, 0) if module.rpartition(".")[2] == "__init__" else None


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
    return {resolve(name, known) for name in inside}


def violations(source: Path, floors: list[list[str]]) -> list[str]:
    """One line for every file without a place, import that does not lead down, and cycle."""
    known = modules(source)
    graph = {module: imports(module, known) for module in sorted(known)}
    homeless = [module for module in graph if place(module, floors) is None]
    found = [f"{module} has no place in the list of floors" for module in homeless]
    for module, targets in graph.items():
        for target in sorted(targets):
            here, there = place(module, floors), place(target, floors)
            siblings = here == there and not module.endswith("__init__")
            if here and there and there >= here and not siblings:
                found.append(f"{module} imports {target}, which is not below it")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append(f"cycle: {' -> '.join(error.args[1])}")
    return found


def test_imports_lead_down() -> None:
    assert violations(SOURCE, FLOORS) == []


def test_the_list_names_every_module_once() -> None:
    entries = [entry for floor in FLOORS for entry in floor]
    assert len(entries) == len(set(entries))


MADE_UP_FLOORS = [["ground", "above"], ["rooms.one", "rooms.two"], ["doors.*"]]
MADE_UP = {
    "__init__": "",
    "ground": "import os\nfrom numpy import array\nimport foveatee.doors.main",
    "above": "from foveate import ground, __version__",
    "rooms.__init__": "",
    "rooms.one": "from foveate.above import name",
    "rooms.two": "from . import one\nfrom ..ground import name",
    "doors.__init__": "",
    "doors.a": "def run():\n    import foveate.rooms.two as two\n    from foveate.doors import b",
    "doors.b": "from foveate.rooms import one",
}


def build(folder: Path, changes: dict[str, str]) -> Path:
    for module, text in {**MADE_UP, **changes}.items():
        path = folder.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def test_a_sound_house_passes(tmp_path: Path) -> None:
    assert violations(build(tmp_path, {}), MADE_UP_FLOORS) == []


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"ground": "import foveate.rooms.one"}, "ground imports rooms.one, which is not below it"),
        ({"ground": "from foveate.rooms import one"}, "ground imports rooms.one, which is not below it"),
        ({"ground": "from foveate.rooms.one import name"}, "ground imports rooms.one, which is not below it"),
        (
            {"ground": "def f():\n    from .rooms import one"},
            "ground imports rooms.one, which is not below it",
        ),
        ({"ground": "from .above import name"}, "ground imports above, which is not below it"),
        ({"rooms.one": "from .two import name"}, "rooms.one imports rooms.two, which is not below it"),
        (
            {"rooms.__init__": "from foveate import ground"},
            "rooms.__init__ imports ground, which is not below it",
        ),
        ({"rooms.one": "from ..doors.a import name"}, "rooms.one imports doors.a, which is not below it"),
        ({"ground": "import foveate.ground"}, "cycle: ground -> ground"),
        ({"doors.b": "from . import a"}, "cycle: doors.a -> doors.b -> doors.a"),
        ({"attic": ""}, "attic has no place in the list of floors"),
        ({"rooms.three": ""}, "rooms.three has no place in the list of floors"),
    ],
)
def test_an_unsound_house_is_caught(tmp_path: Path, changes: dict[str, str], complaint: str) -> None:
    assert complaint in violations(build(tmp_path, changes), MADE_UP_FLOORS)
