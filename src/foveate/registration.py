"""Register the environments in Gymnasium, as names only: nothing else is loaded before one of them is made."""

import importlib.util
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

ID = "foveate/Tracking-v0"
"""Name of the environments in Gymnasium's registry."""


def register() -> None:
    """Register the environments, unless they are registered."""
    import gymnasium

    if ID not in gymnasium.registry:
        single, several = "foveate.gym:TrackingEnv", "foveate.gym:TrackingVectorEnv"
        gymnasium.register(id=ID, entry_point=single, vector_entry_point=several)


def register_with_gymnasium() -> None:
    """Register the environments now if Gymnasium is loaded, else as soon as a program loads it.

    So `gymnasium.make("foveate:foveate/Tracking-v0")` works in either order of the imports, as sorters of imports
    choose it, and Gymnasium, which reads no entry points, is not loaded for programs that do not use it.
    """
    if sys.modules.get("gymnasium") is not None:
        register()
    elif not any(isinstance(finder, _Registrar) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Registrar())


class _Registrar(MetaPathFinder):
    """Registers the environments after the import of Gymnasium, which it leaves to the usual finders."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Spec of Gymnasium, once, whose execution ends with the registration; None for all else."""
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                register()

            spec.loader.exec_module = execute_and_register
        return spec
