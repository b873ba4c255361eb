"""Work of `foveate presets`."""

from dataclasses import asdict

from foveate.cli.common import check_output, print_tables
from foveate.cli.presets import Presets
from foveate.evaluation.cards import cards, cards_table, facts
from foveate.io.files import write_json
from foveate.io.tables import console_of_output, draw_facts


def run(options: Presets) -> int:
    """Print the table of all presets, or the cards of some."""
    check_output(options.json)
    found = cards(options.preset)
    if options.json is not None:
        write_json(options.json, [asdict(card) for card in found])
    if not options.preset:
        print_tables(cards_table(found))
    console = console_of_output()
    for card in found if options.preset else ():
        draw_facts(card.name, facts(card), console)
    return 0
