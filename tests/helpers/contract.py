"""The JSON files that programs read and write: `faults` lists what breaks the documented contract (docs/files.md).

Independent of foveate: it knows the files' keys and kinds of values, and nothing of the code that writes them.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

Predicate = Callable[[Any], bool]


def is_text(value: Any) -> bool:
    return isinstance(value, str)


def is_name(value: Any) -> bool:
    return isinstance(value, str) and value != ""


def is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def is_number(value: Any) -> bool:
    # `json` reads NaN and Infinity, which are no JSON: other languages' parsers reject the file.
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_share(value: Any) -> bool:
    return is_number(value) and 0 <= value <= 1


def is_size(value: Any) -> bool:
    return is_number(value) and value >= 0


def is_interval(value: Any) -> bool:
    return is_vector(value, 2) and value[0] <= value[1]


def is_vector(value: Any, *lengths: int) -> bool:
    return isinstance(value, list) and len(value) in lengths and all(map(is_number, value))


def one_of(*words: str) -> Predicate:
    return lambda value: value in words


def or_null(predicate: Predicate) -> Predicate:
    return lambda value: value is None or predicate(value)


PROTOCOL, MOTION = one_of("surrogate", "true"), one_of("unbiased", "biased")
SEEN = {"seen_fraction": is_share, "longest_unseen_s": is_size}
ERRORS = {"rmse_m": is_size, "nees": is_size, "step_time_s": is_size}
EVALUATION_ROW = {
    "scene": is_name,
    "seed": is_count,
    "method": is_name,
    "protocol": PROTOCOL,
    "targets": is_count,
    "score": or_null(is_number),
    "entropy": or_null(is_number),
    "objective": or_null(is_number),
    "seen_step_fraction": is_share,
    **SEEN,
    **ERRORS,
}
SUMMARY_ROW = {
    "method": is_name,
    "protocol": PROTOCOL,
    "motion": MOTION,
    "targets": is_count,
    "episodes": is_count,
    "mean": is_number,
    "std": is_size,
    "ci95": is_interval,
    "seen_fraction": is_share,
}
REPLAY_ROW = {
    "method": is_name,
    "seed": is_count,
    "targets": is_count,
    "lost": is_count,
    "log_det_mean": is_number,
    "seen_time_fraction": is_share,
    **SEEN,
    **ERRORS,
}
VERDICT_ROW = {"method": is_name, "mean": is_number, "se": is_size, "episodes": is_count}
METRIC = {"key": is_name, "value": is_number, "unit": is_text, "better": one_of("lower", "higher")}
METRIC_KEYS = (
    *("train_step_over_limit_60", "train_step_over_limit_1024", "train_epoch_s_60", "train_compile_s"),
    *("decision_onnx_us_8", "decision_jax_us_8", "rollout_target_steps_per_s", "env_steps_per_s_1024"),
    *("actor_critic_over_limit", "actor_critic_env_steps_per_s", "evaluate_over_limit"),
)


def record_faults(place: str, record: Any, fields: dict[str, Predicate]) -> list[str]:
    """One line for every field that is missing or has a wrong value."""
    if not isinstance(record, dict):
        return [f"{place}: expected an object"]
    missing = [f"{place}: no '{key}'" for key in fields if key not in record]
    wrong = [
        f"{place}: {key} = {record[key]!r}" for key, holds in fields.items() if key in record and not holds(record[key])
    ]
    return missing + wrong


def list_faults(data: dict, name: str, check: Callable[[str, Any], list[str]]) -> list[str]:
    """The faults of each item of a list that must not be empty."""
    items = data.get(name)
    if not isinstance(items, list) or not items:
        return [f"no {name}"]
    return [fault for i, item in enumerate(items) for fault in check(f"{name}[{i}]", item)]


def rows_of(fields: dict[str, Predicate]) -> Callable[[str, Any], list[str]]:
    return lambda place, row: record_faults(place, row, fields)


def scene_faults(place: str, scene: Any) -> list[str]:
    """A pose of 3 or 7 numbers, and a target and its drift of as many numbers as that space has dimensions."""
    pose = scene.get("agent") if isinstance(scene, dict) else None
    dimension = 3 if isinstance(pose, list) and len(pose) == 7 else 2

    def is_matrix(value: Any) -> bool:
        return isinstance(value, list) and all(is_vector(row, dimension) for row in value)

    required = {"id": is_name, "agent": lambda value: is_vector(value, 3, 7), "targets": is_matrix}
    faults = record_faults(place, scene, required)
    if faults:
        return faults
    targets = len(scene["targets"])
    optional = {
        "drift": lambda value: is_matrix(value) and len(value) == targets,
        "horizon": lambda value: is_count(value) and value > 0,
    }
    return record_faults(place, scene, {key: holds for key, holds in optional.items() if key in scene})


def scenes_faults(data: dict) -> list[str]:
    header = record_faults("file", data, {"format": one_of("foveate-scenes"), "version": lambda value: value == 1})
    ids = [scene.get("id") for scene in data.get("scenes") or [] if isinstance(scene, dict)]
    twice = sorted({str(name) for name in ids if ids.count(name) > 1})
    return header + list_faults(data, "scenes", scene_faults) + [f"id {name!r} is given twice" for name in twice]


def evaluation_faults(data: dict) -> list[str]:
    faults = list_faults(data, "rows", rows_of(EVALUATION_ROW)) + list_faults(data, "summary", rows_of(SUMMARY_ROW))
    if faults:
        return faults
    return [
        f"rows[{i}]: score = {row['score']} of {row['targets']} targets: a number, and null only where there is none"
        for i, row in enumerate(data["rows"])
        if (row["score"] is None) != (row["targets"] == 0)
    ]


def replay_faults(data: dict) -> list[str]:
    return list_faults(data, "rows", rows_of(REPLAY_ROW))


def verdict_faults(data: dict) -> list[str]:
    faults = record_faults("file", data, {"objective": one_of("terminal", "mean", "seen", "gospa")})
    faults += list_faults(data, "rows", rows_of(VERDICT_ROW))
    if not faults and data["rows"][0]["method"] != "policy":
        return ["rows[0]: expected the policy"]
    return faults


def bench_faults(data: dict) -> list[str]:
    faults = list_faults(data, "metrics", rows_of(METRIC))
    keys = [metric["key"] for metric in data["metrics"]] if not faults else METRIC_KEYS
    return faults + [f"no metric {key!r}" for key in METRIC_KEYS if key not in keys]


CHECKS = {
    "scenes": scenes_faults,
    "evaluate": evaluation_faults,
    "verdict": verdict_faults,
    "replay": replay_faults,
    "bench": bench_faults,
}


def faults(kind: str, path: Path) -> list[str]:
    """One line for each fault of a file of one kind: "scenes", "evaluate", "verdict", "replay" or "bench"."""
    data = json.loads(path.read_text(encoding="utf-8"))
    return CHECKS[kind](data) if isinstance(data, dict) else ["expected an object"]
