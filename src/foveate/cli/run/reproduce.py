"""Work of `foveate reproduce`."""

from foveate.cli.reproduce import Reproduce


def run(options: Reproduce) -> int:
    """Do what is not done yet, write the files, print the tables."""
    return options.run_command()
