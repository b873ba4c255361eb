"""Work of `foveate config`."""

from foveate.cli.config import Config
from foveate.experiment.overrides import with_changes
from foveate.experiment.resolve import experiment_from
from foveate.io.toml import document

HEADER = "foveate: an experiment, from {source}. Train it: foveate train --config FILE. Keys: docs/configuration.md"


def run(options: Config) -> int:
    """Print the experiment, without the digest that would reject changes."""
    experiment = with_changes(
        experiment_from(options.experiment), [change for changes in options.set for change in changes]
    )
    print(document(experiment, HEADER.format(source=options.experiment), sealed=False), end="")
    return 0
