"""Fuzz recordings, scenes, configurations, checkpoints, ONNX files and arguments of the command line: `make fuzz`.

Examples of each format are mutated byte by byte; half of the files with a digest get a right one again, and checkpoints
are also made by hand (`endurance.hostile`). Arguments are sampled from the existing options and from odd values. Each
input must be taken, or rejected in one line: no other exception, at most SLOWEST_S and MEMORY. Inputs that break this
are printed.
"""

import argparse
import contextlib
import importlib
import io
import os
import pkgutil
import re
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from endurance import hostile

import foveate
from foveate.cli.main import COMMANDS, main
from foveate.errors import InputError
from foveate.experiment.checkpoint import load_tree
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.io.toml import digest, dumps_toml, load_toml
from foveate.recordings.formats import load_recording
from foveate.recordings.recording import resample
from foveate.scenario.scenes import read_scenes

FORMATS = Path(__file__).parents[1] / "formats"
LARGEST = 1 << 20
SLOWEST_S = 1.0
"""Processor time of one input [s], on a core with nothing else to do."""
MEMORY = 300 << 20
"""What all inputs may take together [bytes], beside what a first valid one of each kind takes."""
TOKENS = [
    *(b"nan", b"inf", b"-inf", b"1e999", b"-0.0", b"1e-320", b"9" * 400, b"0x10", b"1_000", b"true", b"null", b'""'),
    *(
        b"\x00",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\r",
        b"\n",
        b"\n\n",
        b",",
        b",,",
        b'"',
        b"'",
        b"[",
        b"]",
        b"{",
        b"}",
        b"#",
        b"=",
    ),
    *(
        b"[[",
        b"..",
        b"../../x",
        b"/etc/passwd",
        b"\\u0000",
        b"\\ud800",
        b"\xf0\x9f\x8e\xaf",
        b"\xc2\xa0",
        b"\xe2\x80\xa8",
    ),
    *(b"__import__('os')", b"!!python/object", b"time_s,track_id,x_m,y_m\n", b'{"id": "a"}', b"1979-05-27T07:32:00Z"),
]
NUMBER = re.compile(rb"-?\d+(\.\d+)?(e-?\d+)?")
NUMBERS = (
    *(b"0", b"-1", b"1", b"2", b"3", b"7", b"64", b"1000", b"100000", b"4294967296", b"0.0", b"-0.5", b"0.1", b"2.5"),
    *(b"1e-3", b"1e-9", b"1e-30", b"1e5", b"1e9", b"1e20", b"1e160", b"1e308", b"89.999", b"180.0", b"360.0"),
)
SHARES = (0.2, 0.03, 0.07, 0.07, 0.08, 0.05, 0.05, 0.05, 0.05, 0.35)
"""Probabilities of the kinds of mutation; gentle ones are more frequent, as gross damage is rejected at the surface."""
HEAVY = (
    *("cli.run.train.train", "api.evaluate_all", "api.evaluate_plans", "recordings.compare.prepare_replay"),
    *("plotting.render.prepare", "plotting.live.sources.prepare", "plotting.live.sources.prepare_replay"),
    *("study.run.reproduce", "cli.run.view.serve", "cli.run.view.record", "cli.run.export.export"),
    *("bench.workloads.measurements", "bench.timing.measure_references"),
)
"""Functions that do the work of a command once its arguments and files are read; they are not run here."""
ODD = (
    *("", " ", "-1", "0", "1", "3", "nan", "inf", "1e400", "9" * 30, "-", "--", "None", "True", "a b", "\n", "é\udc80"),
    *(".", "..", "/", "/dev/null", "/proc/self/mem", "r.csv", "s.json", "e.toml", "run", "none.csv", "paper", "best"),
    *(
        "table1",
        "own",
        "policy",
        "all",
        "true",
        "both",
        "0,0,0",
        "0,0",
        "x.html",
        "x.png",
        "x.toml",
        "x.json",
        "x" * 300,
    ),
)


def grow(rng: np.random.Generator, data: bytes) -> bytes:
    """Insert up to a mebibyte of repetitions of a part of the data, or of brackets."""
    part = [data[: 1 + int(rng.integers(max(1, len(data))))], b"[", b'{"a":', b"a.", b"9", b"[[a]]\n"][rng.integers(6)]
    size = int(2.0 ** rng.uniform(8, 20))
    place = int(rng.integers(len(data) + 1))
    return (data[:place] + part * (size // max(1, len(part))) + data[place:])[:LARGEST]


def mutate(rng: np.random.Generator, data: bytes, other: bytes) -> bytes:
    """Change a few bytes, slices, lines and numbers."""
    for _ in range(int(rng.geometric(0.6))):
        kind, place = int(rng.choice(10, p=SHARES)), int(rng.integers(len(data) + 1))
        end = min(len(data), place + int(rng.geometric(0.1)))
        token = TOKENS[rng.integers(len(TOKENS))]
        if kind == 0 and place < len(data):
            data = data[:place] + bytes([data[place] ^ (1 << int(rng.integers(8)))]) + data[place + 1 :]
        elif kind == 1:
            data = data[:place] + bytes(rng.integers(0, 256, end - place, np.uint8)) + data[end:]
        elif kind == 2:
            data = data[:place] + data[end:]
        elif kind == 3:
            data = data[:place] + token + data[place:]
        elif kind == 4:
            data = data[:place] + token + data[end:]
        elif kind == 5:
            data = data[:end] + data[place:]
        elif kind == 6:
            lines = data.splitlines(keepends=True)
            rng.shuffle(lines)
            data = b"".join(lines[: int(rng.integers(len(lines) + 1))]) if rng.random() < 0.5 else b"".join(lines)
        elif kind == 7:
            data = data[:place] + other[int(rng.integers(len(other) + 1)) :]
        elif kind == 8:
            data = data[:place]
        elif numbers := list(NUMBER.finditer(data)):
            chosen = numbers[rng.integers(len(numbers))]
            data = data[: chosen.start()] + NUMBERS[rng.integers(len(NUMBERS))] + data[chosen.end() :]
    return data if rng.random() > 0.01 else grow(rng, data)


def seeds() -> dict[str, list[bytes]]:
    """Valid examples to mutate; some without a digest, since a wrong digest would hide all other errors."""
    scenes = (FORMATS / "scenes.json").read_bytes()
    plain = b"\n".join(line for line in scenes.splitlines() if b'"digest"' not in line)
    table = [dumps_toml(experiment).encode() for experiment in PRESETS.values()]
    recording = (FORMATS / "recording.csv").read_bytes()
    space = b"time_s,track_id,x_m,y_m,z_m\n" + b"".join(
        b"%d.5,t%d,%d,2e-1,-3\n" % (i // 3, i % 3, i) for i in range(30)
    )
    examples = {
        "recording": [recording, space],
        "scenes": [scenes, plain, plain],
        "toml": [*table, (FORMATS / "preset-paper.toml").read_bytes()],
        "checkpoint": [hostile.packed(*hostile.checkpoint_parts())],
    }
    return examples | ({"onnx": [hostile.onnx_policy()]} if hostile.onnx_reader() else {})


def readers() -> dict[str, Callable[[Path], object]]:
    """The reader of each kind of file."""
    scenario = PRESETS["paper"].scenario
    space = scenario.problem().agent.space

    def recording(path: Path) -> object:
        return resample(load_recording(path), 0.5)

    return {
        "recording": recording,
        "scenes": lambda path: read_scenes(path, space, scenario.scenes),
        "toml": lambda path: load_toml(Experiment, path).scenario.problem(),
        "checkpoint": lambda path: load_tree(path, hostile.shape(), "policy", {digest(hostile.SMALL)}),
        "onnx": lambda path: hostile.onnx_reader()(str(path)),
    }


def arguments(rng: np.random.Generator) -> list[str]:
    """Sample a command with some of its options, and odd values."""
    name = list(COMMANDS)[rng.integers(len(COMMANDS))]
    options = [f"--{field.name.replace('_', '-')}" for field in fields(COMMANDS[name])]
    said = [name] if rng.random() < 0.98 else []
    for _ in range(int(rng.integers(0, 3))):
        said.append(str(ODD[rng.integers(len(ODD))]))
    for _ in range(int(rng.integers(0, 5))):
        said.append(options[rng.integers(len(options))])
        said += [str(ODD[rng.integers(len(ODD))]) for _ in range(int(rng.integers(0, 3)))]
    return said


@contextlib.contextmanager
def light() -> Iterator[None]:
    """Commands that end where their work would begin."""
    # A module that is first imported while a patch holds would keep the patched function.
    for module in pkgutil.walk_packages(foveate.__path__, "foveate."):
        with contextlib.suppress(ImportError):  # an extra that is not installed
            importlib.import_module(module.name)
    heavy = [pkgutil.resolve_name(f"foveate.{name}") for name in HEAVY]
    modules = [module for name, module in sys.modules.items() if name.partition(".")[0] == "foveate"]
    with contextlib.ExitStack() as stack:
        for module, name, value in [(m, name, value) for m in modules for name, value in vars(m).items()]:
            if any(value is function for function in heavy):
                started = InputError("its work would begin here")
                stack.enter_context(mock.patch.object(module, name, side_effect=started))
        yield


def require(holds: bool, what: str) -> None:
    """Raise AssertionError unless it holds."""
    if not holds:
        raise AssertionError(what)


def run_command(said: list[str]) -> str:
    """Run a command and return its status. Raises AssertionError if it shows a traceback."""
    with contextlib.redirect_stderr(io.StringIO()) as err, contextlib.redirect_stdout(io.StringIO()):
        try:
            status = main(said)
        except SystemExit as exit_:
            status = exit_.code
    require("Traceback" not in err.getvalue(), "shows a traceback")
    require(status in (0, 1, 2), f"exit status {status}")
    return f"status {status}"


def read(reader: Callable[[Path], object], path: Path) -> str:
    """Read a file: taken or rejected. Raises AssertionError unless a rejection is one line that names the file."""
    try:
        reader(path)
    except ValueError as error:
        said, kind = str(error), type(error)
        fine = kind in (InputError, ValueError) and len(said.splitlines()) == 1 and str(path) in said
        require(fine, f"not one line that names the file: {kind.__name__}: {said}")
        return "rejected"
    return "taken"


def inputs(count: int, seed: int, folder: Path) -> Iterator[tuple[str, Callable[[], str], Any]]:
    """Generate `count` inputs: kind, function that tries it, and data to print if it breaks something."""
    rng, examples, read_by = np.random.default_rng(seed), seeds(), readers()
    kinds = list(examples)
    # Configurations, which take ten times as long as the others, are tried half as often.
    shares = np.array([0.5 if kind == "toml" else 1.0 for kind in kinds])
    for _ in range(count):
        if rng.random() < 0.02:
            said = arguments(rng)
            yield "arguments", lambda said=said: run_command(said), repr(said).encode()
            continue
        kind = str(rng.choice(kinds, p=shares / shares.sum()))
        pair = [examples[kind][i] for i in rng.integers(0, len(examples[kind]), 2)]
        data, path = resealed(rng, kind, mutate(rng, *pair)), folder / f"input.{kind}"
        path.write_bytes(data)
        yield kind, lambda kind=kind, path=path: read(read_by[kind], path), data


def resealed(rng: np.random.Generator, kind: str, data: bytes) -> bytes:
    """Half of the files with a right digest, so that what is wrong beyond it is reached."""
    if rng.random() < 0.5:
        return data
    if kind == "checkpoint":
        return hostile.checkpoint(rng)
    return {"toml": hostile.toml, "onnx": hostile.onnx}.get(kind, bytes)(data)


def warm_up(folder: Path) -> None:
    """Read a valid file of each kind: what that compiles and imports stays for all others."""
    for kind, examples in seeds().items():
        for example in examples:
            (folder / "warm").write_bytes(example)
            readers()[kind](folder / "warm")


def furnish(folder: Path) -> None:
    """Write the files that arguments name."""
    for name, source in {"r.csv": "recording.csv", "s.json": "scenes.json", "e.toml": "preset-paper.toml"}.items():
        (folder / name).write_bytes((FORMATS / source).read_bytes())


def fuzz(
    count: int, seed: int, report: Callable[[str], None] = print, slowest_s: float = SLOWEST_S
) -> tuple[Counter, list[str]]:
    """Try `count` inputs of `slowest_s` at most; return the counts of outcomes, and descriptions of the failures."""
    counts, broken, slowest = Counter(), [], 0.0
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, light():
        furnish(Path(folder))
        warm_up(Path(folder))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        os.chdir(folder)
        try:
            for kind, attempt, data in inputs(count, seed, Path(folder)):
                began = time.process_time()
                try:
                    counts[f"{kind} {attempt()}"] += 1
                except Exception as error:
                    broken.append(f"{kind}: {type(error).__name__}: {str(error)[:300]}: {data[:300]!r}")
                    report(broken[-1])
                took = time.process_time() - began
                if (done := sum(counts.values()) + len(broken)) % 10_000 == 0:
                    report(f"{done} inputs, {len(broken)} broken, {time.process_time():.0f} s of a core")
                slowest = max(slowest, took)
                if took > slowest_s:
                    broken.append(f"{kind}: took {took:.1f} s: {len(data)} bytes, {data[:200]!r}")
                    report(broken[-1])
        finally:
            os.chdir(home)
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    if more * 2**20 > MEMORY:
        broken.append(f"memory grew by {more:.0f} MiB")
    report(f"{count} inputs: {dict(sorted(counts.items()))}; slowest {slowest:.2f} s, memory grew by {more:.0f} MiB")
    return counts, broken


def cli() -> int:
    """Fuzz, report and return the exit status."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--inputs", type=int, default=200_000)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    _, broken = fuzz(given.inputs, given.seed)
    print(f"{len(broken)} broken")
    return min(1, len(broken))


if __name__ == "__main__":
    sys.exit(cli())
