"""Package contents: the wheel and the sdist as hatchling builds them, the trained presets in them, the citation."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import foveate
from foveate.experiment.checkpoint import load_run
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import TRAINED, experiment_of, run_folder, with_initial_error
from foveate.experiment.run_folder import BEST, VERDICT

ROOT = Path(__file__).parents[1]
SHIPPED = ("config.toml", "record.json", BEST.as_posix())
CODE = """
import foveate
from importlib.metadata import version
policy = foveate.load("paper")
print(foveate.__file__)
print(version("foveate"))
print(policy(foveate.Belief([[1, 2]], covariance=[[1, 0], [0, 1]]), [0, 0, 0]).tolist())
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with wheel and sdist, built from a copy of what is under version control, without any network."""
    folder = tmp_path_factory.mktemp("build")
    unwanted = shutil.ignore_patterns("__pycache__", ".*", "runs", "dist", "docs", "tests", "experiments")
    shutil.copytree(ROOT, folder / "copy", ignore=unwanted)
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    done = subprocess.run(command, cwd=folder / "copy", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_wheel_is_whole_and_runs(built: Path):
    """Types, stub, trained presets and nothing else; unpacked, it decides as the source does."""
    (wheel,) = built.glob("*.whl")
    assert wheel.name == f"foveate-{foveate.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(built / "site")
    code = {f"foveate/{path.relative_to(ROOT / 'src' / 'foveate').as_posix()}" for path in files_of_the_package()}
    assert {name for name in names if ".dist-info/" not in name} == code
    assert {"foveate/py.typed", "foveate/__init__.pyi"} <= names
    for preset in PRESETS:
        assert {f"foveate/experiment/trained/{preset}/{name}" for name in SHIPPED} <= names
    metadata = (built / "site" / f"foveate-{foveate.__version__}.dist-info" / "METADATA").read_text(encoding="utf-8")
    for line in ("License-Expression: Apache-2.0", "License-File: LICENSE", "Requires-Python: >=3.11"):
        assert line in metadata
    environment = {**os.environ, "PYTHONPATH": str(built / "site")}
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=built, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    place, number, command = done.stdout.splitlines()
    assert Path(place).is_relative_to(built)
    assert number == foveate.__version__
    here = foveate.load("paper")(foveate.Belief([[1, 2]], covariance=[[1, 0], [0, 1]]), [0, 0, 0])
    assert json.loads(command) == pytest.approx(here.tolist(), abs=1e-5)


def files_of_the_package() -> list[Path]:
    kinds = {".py", ".pyi", ".typed", ".toml", ".json", ".npz"}
    package = ROOT / "src" / "foveate"
    return [path for path in package.rglob("*") if path.name == "py.typed" or path.suffix in kinds]


@pytest.mark.slow
def test_the_sdist_has_all_files_of_a_build(built: Path):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "constraints.txt", "Makefile"}
    wanted |= {"CONTRIBUTING.md", "CODE_OF_CONDUCT.md"}
    assert wanted <= names
    assert {"src/foveate/experiment/trained/paper/record.json", "examples/python_api.py"} <= names


def test_the_trained_presets_are_small_and_of_their_presets():
    assert sorted(path.name for path in TRAINED.iterdir()) == sorted(PRESETS)
    sizes = 0
    for name, preset in PRESETS.items():
        experiment, _, facts = load_run(TRAINED / name)
        assert experiment == experiment_of(name) == preset
        record = json.loads((TRAINED / name / "record.json").read_text(encoding="utf-8"))
        assert (record["preset"], record["seed"], record["epoch"]) == (name, facts["seed"], facts["epoch"])
        files = [path for path in (TRAINED / name).rglob("*") if path.is_file()]
        assert {path.relative_to(TRAINED / name).as_posix() for path in files} - {VERDICT} == set(SHIPPED)
        sizes += sum(path.stat().st_size for path in files)
    assert sizes < 1_500_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "preset", [pytest.param(name, marks=pytest.mark.exhaustive) if name == "pan-tilt" else name for name in PRESETS]
)
def test_a_trained_preset_has_its_recorded_score_and_decides_as_the_simulation(preset: str):
    """Every third decision of a scene, from the beliefs before it and the known inputs, as a user would ask for it.

    Pan-tilt, which takes longest, is quadrotor with the camera of pan.
    """
    script = runpy.run_path(str(ROOT / "experiments" / "trained_presets.py"))
    suite, trace = script["played"](preset)
    record = json.loads((TRAINED / preset / "record.json").read_text(encoding="utf-8"))
    assert script["scores"](suite, trace) == pytest.approx(record["scores"], abs=0.01)
    policy, K, n = foveate.load(preset), suite.scenes[0].horizon, len(suite.scenes[0].targets)
    number = None if policy.problem.obstacles is None else suite.scenes[0].map
    control, commands = policy.problem.agent.control, []
    for k in range(0, K, 3):
        now = foveate.Belief(trace.mean[0, k, :n], information=trace.information[0, k, :n])
        coming = policy.predict(now, suite.episodes.inputs[0, k, :n], k)
        commands.append(policy(coming, trace.pose[0, k], K - k, map_number=number))
        np.testing.assert_allclose(commands[-1], control(jnp.asarray(trace.action[0, k])), rtol=0, atol=1e-6)
    assert (np.ptp(commands, axis=0) > 1e-3).all(), "decisions must differ, or nothing was compared"
    assert len(policy.axes) == commands[0].size


def test_a_run_of_a_presets_name_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("paper").mkdir()  # a manuscript, say
    assert run_folder("paper") == TRAINED / "paper"
    foveate.load("paper").save("best")
    assert run_folder("best") == Path("best")
    assert foveate.load("best").experiment == PRESETS["paper"]


def test_an_initial_error_that_is_asked_for_replaces_the_scenario_s_own():
    """`evaluate --initial-error` of a scenario with deviations of its own; without the option these stay."""
    scenes = foveate.SceneSettings(first_error_std=(2.0,))
    own = foveate.Experiment(scenario=foveate.Scenario(scenes=scenes))
    assert with_initial_error(own, None) == own
    changed = with_initial_error(own, "consistent").scenario.scenes
    assert (changed.initial_error, changed.first_error_std) == ("consistent", None)


def test_the_citation_is_of_this_version_and_of_the_paper():
    found = yaml_of(ROOT / "CITATION.cff")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (found["cff-version"], found["version"]) == ("1.2.0", foveate.__version__)
    assert found["license"] == project["license"]
    (paper,) = found["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Yang", "Koga", "Asgharivaskasi", "Atanasov"]
    assert f"## {foveate.__version__}\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def yaml_of(path: Path) -> Any:
    """The content of a YAML file."""
    yaml = pytest.importorskip("ruamel.yaml", reason="comes with the extra stonesoup")
    return yaml.YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def test_the_continuous_integration_runs_existing_targets():
    """Targets of the Makefile, every Python of the metadata, and torch in one job alone."""
    jobs = yaml_of(ROOT / ".github" / "workflows" / "ci.yml")["jobs"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pythons = [line.rpartition(" ")[2] for line in project["classifiers"] if " :: Python :: " in line]
    assert jobs["tests"]["strategy"]["matrix"]["python"] == pythons
    lines = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    targets = {line.split()[1] for line in lines if line.startswith("make ")}
    assert targets == {"lint", "test-all", "docs", "package"}
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert [name for name in targets if not re.search(rf"^{name}:", makefile, re.MULTILINE)] == []
    assert [line for line in lines if "ppo" in line] == ["make test-all EXTRA=ppo"]
    actions = [step["uses"] for job in jobs.values() for step in job["steps"] if "uses" in step]
    assert all(re.fullmatch(r"actions/[\w-]+@v\d+", action) for action in actions), "official ones, by major tag"


def test_hooks_before_a_commit_are_local():
    """They run tools of the development environment, and fetch nothing."""
    config = yaml_of(ROOT / ".pre-commit-config.yaml")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert [repository["repo"] for repository in config["repos"]] == ["local"]
    hooks = config["repos"][0]["hooks"]
    assert {hook["language"] for hook in hooks} == {"system"}
    tools = {Path(hook["entry"].split()[0]).name for hook in hooks}
    assert tools == {"ruff", "pyright"}
    assert tools <= {re.split("[<>=]", line)[0] for line in project["optional-dependencies"]["dev"]}


FORMS = sorted(set((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml")) - {ROOT / ".github/ISSUE_TEMPLATE/config.yml"})


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_issue_forms_have_their_required_fields(form: Path):
    found = yaml_of(form)
    assert found["name"]
    assert found["description"]
    fields = [part for part in found["body"] if part["type"] != "markdown"]
    assert len({part["id"] for part in fields}) == len(fields) > 0
    assert all(part["attributes"]["label"] for part in fields)
