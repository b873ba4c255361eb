"""Model cards of the trained policies in the package: data, scores, limits, size and licence, read from their files."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import metadata
from pathlib import Path
from typing import Any, Literal

from foveate.errors import InputError
from foveate.evaluation.metrics import DIGITS
from foveate.evaluation.verdict import Verdict, read_verdict
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import PPOSettings
from foveate.experiment.resolve import TRAINED
from foveate.experiment.run_folder import BEST, CONFIG
from foveate.io.files import read_json
from foveate.io.npz import load_arrays
from foveate.io.records import suggestion, to_table
from foveate.io.tables import Table
from foveate.io.toml import load_toml
from foveate.names import Objective, ProtocolName

OBJECTIVES: dict[Objective, str] = {"terminal": "score at the end", "mean": "mean score", "seen": "time in view"}
LIMITS = {
    "own": "made for this robot, view, sensor, period and motion of targets, and for beliefs with these initial "
    "errors; for others train again.",
    "random": "for robots of this space, whose scenario it is told; a training for one robot scores more.",
}
LEFT_OUT = ("kind", "shape", "algorithm", "policy", "initial_error")


@dataclass(frozen=True, kw_only=True)
class Card:
    """A trained policy of the package.

    `robot`, `view`, `sensor`, `targets` and `obstacles` (empty without) are settings of its scenario, which it is
    limited to, in the words and units of TOML files. `held_out` is its mean score by the `objective` under the
    `protocol`, in `episodes` that selected it but did not train it. `verdict`: its place beside heuristics and a
    planner, in words; empty where it was not judged. `worlds`: where it was trained, in its own scenario or in those
    of random robots.
    """

    name: str
    robot: str
    view: str
    sensor: str
    targets: str
    obstacles: str
    targets_min: int
    targets_max: int
    steps: str
    initial_error: str
    network: str
    weights: int
    size_bytes: int
    learner: str
    iterations: int
    trained_s: float
    seed: int
    version: str
    objective: Objective
    protocol: ProtocolName
    held_out: float
    episodes: int
    verdict: tuple[str, ...]
    worlds: Literal["own", "random"]
    licence: str


def cards(names: Sequence[str] = ()) -> list[Card]:
    """Read the cards of presets, of all by default. Raises InputError for a preset that the package does not have."""
    known = sorted(path.name for path in TRAINED.iterdir() if (path / CONFIG).is_file())
    for name in names:
        if name not in known:
            raise InputError(f"{name}: no such preset; {suggestion(name, known)}")
    return [_card(TRAINED / name) for name in dict.fromkeys(names or known)]


def _card(run: Path) -> Card:
    experiment = load_toml(Experiment, run / CONFIG)
    record: Any = read_json(run / "record.json", "record of a trained preset")
    _, arrays = load_arrays(run / BEST, "policy", 1)
    scenario, scenes, training = experiment.scenario, experiment.scenario.scenes, experiment.training
    verdict = read_verdict(run)
    least, most = scenes.horizon(scenes.targets_min), scenes.horizon(scenes.targets_max)
    return Card(
        name=run.name,
        robot=settings_text(scenario.agent),
        view=settings_text(scenario.view),
        sensor=settings_text(scenario.sensor),
        targets=settings_text(scenario.target),
        obstacles="" if scenario.obstacles is None else settings_text(scenario.obstacles),
        targets_min=scenes.targets_min,
        targets_max=scenes.targets_max,
        steps=f"{least if least == most else f'{least} to {most}'} steps of {float(scenario.tau_s):g} s",
        initial_error=scenes.initial_error,
        network=experiment.policy.kind,
        weights=sum(array.size for array in arrays.values()),
        size_bytes=(run / BEST).stat().st_size,
        learner=getattr(training, "algorithm", "policy-gradient"),
        iterations=record["epoch"],
        trained_s=float(record["trained_s"]),
        seed=record["seed"],
        version=record["foveate"],
        objective="terminal" if isinstance(training, PPOSettings) else training.objective,
        protocol=training.select,
        held_out=record["held_out"],
        episodes=training.held_out,
        verdict=() if verdict is None else (_ranking(verdict), *verdict.sentences),
        worlds=getattr(training, "worlds", "own"),
        licence=metadata("foveate")["License-Expression"],
    )


def _ranking(verdict: Verdict) -> str:
    """The policy, the best heuristic and the planner with their scores."""
    digits = DIGITS[verdict.objective]
    best = {row.kind: row for row in reversed(verdict.rows)}  # the first of each kind
    shown = [(kind, best[kind]) for kind in ("policy", "heuristic", "planner") if kind in best]
    notes = {
        "policy": "",
        "heuristic": " (best heuristic)",
        "planner": f" (planner, {verdict.rows[-1].episodes} episodes)",
    }
    return ", ".join(f"{row.method} {row.mean:.{digits}f}{notes[kind]}" for kind, row in shown) + "."


def settings_text(settings: Any) -> str:
    """Settings of one kind in words: "triangle (depth_m 2, angle_deg 120)"."""
    table = to_table(settings)
    kind = table.get("kind", table.get("shape", ""))
    values = [f"{name} {_value(value)}" for name, value in table.items() if name not in LEFT_OUT]
    return f"{kind} ({', '.join(values)})" if kind else ", ".join(values)


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_value(item)}" for name, item in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def facts(card: Card) -> dict[str, str]:
    """The card in words, by subject."""
    own = f"{card.targets_min} to {card.targets_max} targets, {card.steps}, initial errors: {card.initial_error}"
    data = {
        "own": f"simulated episodes of this scenario alone: {own}. No recordings.",
        "random": "simulated episodes of random worlds, also those that selected it: each has another robot, view, "
        f"sensor and targets. No recordings. Below is the scenario of its verdict: {own}.",
    }
    hidden = "are obstacles that hide targets," if card.obstacles else "are no occlusion,"
    return {
        "Data": data[card.worlds],
        "Robot": card.robot,
        "View": card.view,
        "Sensor": card.sensor,
        "Targets": card.targets,
        **({"Obstacles": card.obstacles} if card.obstacles else {}),
        "Training": f"{card.learner}, {card.iterations} iterations, {card.trained_s:.0f} s on 2 cores, seed "
        f"{card.seed}, foveate {card.version}. Again: foveate train --preset {card.name}",
        "Score": f"{card.held_out:.2f}: {OBJECTIVES[card.objective]}, {card.protocol} protocol, mean of "
        f"{card.episodes} held-out episodes",
        "Verdict": f"{' '.join(card.verdict)} In full: foveate evaluate {card.name} --scenes own --method all".lstrip(),
        "Limits": f"{LIMITS[card.worlds]} Simulated {hidden} no false alarms and no confused identities.",
        "Size": f"{card.network} network of {card.weights:,} weights, {card.size_bytes / 1024:.0f} KiB",
        "Licence": f"{card.licence}, as foveate",
    }


def cards_table(found: Sequence[Card]) -> Table:
    """One line a card."""
    rows = [
        (
            card.name,
            *(text.partition(" (")[0] if card.worlds == "own" else "any" for text in (card.robot, card.view)),
            f"{card.targets_min}-{card.targets_max}" if card.worlds == "own" else "any",
            f"{card.protocol} {OBJECTIVES[card.objective].removesuffix(' at the end')}",
            f"{card.held_out:.2f}",
        )
        for card in found
    ]
    return Table(
        title="Presets: experiments whose trained policy comes with the package",
        note="foveate presets NAME prints the model card, foveate config NAME the settings. Score: by what it was "
        "trained for, in held-out episodes; not comparable between scenarios.",
        header=("preset", "robot", "view", "targets", "trained for", "score"),
        rows=tuple(rows),
    )
