"""`foveate bench`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Bench(Command):
    """Measure how fast training, deciding, simulating, planning and starting are on this machine.

    A training step is told beside its limit: the arithmetic of its network alone, at the rate of a large matrix product
    that is measured in the same run. Times are medians of repeats after a warm-up. Each stands beside a ratio to the
    machine's own speed; with a baseline, an earlier --json FILE, ratios that are worse than there by more than the
    tolerance make the command end with status 1.

      foveate bench --quick
      foveate bench --json bench.json --baseline benchmarks/baseline.json
    """

    quick: bool = False
    """Few repeats, and no whole training: a minute or two."""
    episodes: tuple[int, ...] = (60, 1024)
    """Episodes of the training steps that are measured; on a GPU up to a million."""
    baseline: Annotated[Path | None, option("FILE.json")] = None
    """Report of an earlier run to be compared with."""
    tolerance: float = 0.5
    """By what share a ratio may be worse than in the baseline."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the metrics for programs."""

    def prepare(self) -> None:
        """Take nothing from the cache of compiled programs, so that compilation is timed, and use every core."""
        import jax

        from foveate.learning.devices import use_cores

        jax.config.update("jax_enable_compilation_cache", False)
        use_cores()
