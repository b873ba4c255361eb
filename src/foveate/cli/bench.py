"""`foveate bench`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Bench(Command):
    """Measure the speed of training, decisions, simulation, planning and start-up on this machine.

    Times are medians of repeats after a warm-up, each with its ratio to the machine's own speed. A training step and an
    iteration of the actor-critic are compared with their limit: the arithmetic of their networks at the rate of a
    large matrix product in the same run; an evaluation with its bare simulation. With a baseline (an earlier --json
    FILE), ratios that are worse by more than the tolerance give exit status 1.

      foveate bench --quick
      foveate bench --json bench.json --baseline benchmarks/baseline.json
    """

    quick: bool = False
    """Few repeats and no whole training: one or two minutes."""
    episodes: Annotated[tuple[int, ...], option("N ..")] = (60, 1024)
    """Batch sizes of the measured training steps; on a GPU up to a million."""
    baseline: Annotated[Path | None, option("FILE.json")] = None
    """Report of an earlier run to compare with."""
    tolerance: Annotated[float, option("SHARE")] = 0.5
    """Fraction by which a ratio may be worse than in the baseline."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the metrics as JSON."""

    def prepare(self) -> None:
        """Disable the cache of compiled programs, so that compilation is timed, and use every core."""
        import jax

        from foveate.learning.devices import use_cores

        jax.config.update("jax_enable_compilation_cache", False)
        use_cores()
