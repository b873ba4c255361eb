"""Names that users write: of methods, learners, presets, protocols. Without imports of foveate, so that help is fast.

Each list is written here alone; `tests/test_names.py` holds that the tables of what they stand for have these keys.
"""

from typing import Literal, get_args

Heuristic = Literal["random", "still", "nearest", "uncertain", "lawnmower", "price", "window", "post"]
"""A policy without training."""

Searcher = Literal["explore", "alternate", "lookahead"]
"""A policy without training that looks for targets never detected, where detections have no ids."""

Method = Literal["policy", Heuristic]
"""The trained policy, or a heuristic."""

Assignment = Literal["greedy", "hungarian", "auction"]
"""Rule by which the robots of a team share the targets: a method is NAME+RULE."""

Learner = Literal["policy-gradient", "actor-critic", "ppo", "ppo-tuned"]
"""A training algorithm with its settings."""

Preset = Literal["paper", "best", "true-view", "search", "quadrotor", "any", "pan", "pan-tilt", "rooms", "forest"]
"""An experiment of the package, which also ships its trained policy."""

ProtocolName = Literal["surrogate", "true"]
"""Source of information: the paper's soft view, or real measurements."""

Objective = Literal["terminal", "mean", "seen", "gospa"]
"""Return of the actor-critic: score at the horizon, its mean over the steps, share of time in view, or minus GOSPA."""

Goal = Literal["seen", "information"]
"""Aim of a fitted experiment: targets in view, or all of them well known."""

Part = Literal["train", "choose", "judge"]
"""Part of a recording: to train on, to choose the best of several policies on, to judge that one on."""

InitialError = Literal["paper", "consistent"]
"""Error of the initial means: that of a measurement, or as large as the initial belief claims."""

FirstVelocity = Literal["zero", "truth"]
"""Mean velocity of a new belief: 0, as a tracker begins one, or the true velocity with an error."""

HEURISTICS: tuple[Heuristic, ...] = get_args(Heuristic)
SEARCHERS: tuple[Searcher, ...] = get_args(Searcher)
METHODS: tuple[Method, ...] = get_args(Method)
ASSIGNMENTS: tuple[Assignment, ...] = get_args(Assignment)
LEARNER_NAMES: tuple[Learner, ...] = get_args(Learner)
PRESET_NAMES: tuple[Preset, ...] = get_args(Preset)
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
PARTS: tuple[Part, ...] = get_args(Part)

GATE = 0.9999
"""Default probability of the chi-square gate: it rejects one valid measurement in ten thousand."""
