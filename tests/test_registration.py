"""The environments are in Gymnasium's registry, whichever a program imports first; nothing else is loaded."""

import subprocess
import sys

import pytest

MAKE = "import foveate; print(gymnasium.spec('foveate/Tracking-v0').entry_point, 'jax' in sys.modules)"


def output(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("imports", ["foveate, gymnasium", "gymnasium, foveate", "gymnasium", "foveate.gym, gymnasium"])
def test_registered_in_either_order(imports: str):
    assert output(f"import sys, {imports}\n{MAKE}") == "foveate.gym:TrackingEnv False\n"


def test_gymnasium_is_not_loaded_for_others():
    assert output("import sys, foveate, numpy\nprint('gymnasium' in sys.modules)") == "False\n"


def test_without_gymnasium_the_import_fails_as_ever():
    code = "import foveate, sys\nsys.path[:] = []\ntry:\n    import gymnasium\nexcept ModuleNotFoundError as error:\n"
    assert output(code + "    print(error)") == "No module named 'gymnasium'\n"
