"""Generate the page of all presets, with the model cards of their trained policies, from the package's files."""

from foveate.evaluation.cards import cards, cards_table, facts
from foveate.io.tables import literal

INTRODUCTION = """# Presets

The experiments that come with foveate, each with a trained policy: use one by its name wherever a command or function
takes a run, as in `foveate evaluate true-view` or `foveate.load("true-view")`. `foveate presets` prints this list,
`foveate presets NAME` a model card, and `foveate config NAME > mine.toml` the settings, to change and train with.

"""
AFTER = """
The score is that by which the policy was trained, in held-out episodes of its own scenario: it says nothing about
another scenario, and does not compare presets. [Choosing a method](choosing.md) compares them where they can be
compared, and [Limitations](limits.md) says what happens outside the scenario of training.
"""


def page() -> str:
    """Return the whole page as Markdown."""
    found = cards()
    table = cards_table(found)
    lines = [
        _row(table.header),
        "|---|---|---|---|---|---:|",
        *(_row([f"[`{row[0]}`](#{row[0]})", *row[1:]]) for row in table.rows),
    ]
    return "\n".join([INTRODUCTION + "\n".join(lines), AFTER, *map(_card, found)])


def _card(card) -> str:
    lines = [f"| **{name}** | {literal(value)} |" for name, value in facts(card).items()]
    return "\n".join([f"## {card.name}", "", "| | |", "|---|---|", *lines, ""])


def _row(cells) -> str:
    return f"| {' | '.join(cells)} |"
