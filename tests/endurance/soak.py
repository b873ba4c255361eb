"""Run a robot's loop for hours of its own time, and a live view with many visitors: `make soak`.

100 steps a second: predict, decide, move, detect, update. Every few seconds a target appears and another disappears,
each with a new id. Reported: memory, decision time, consistency of the beliefs (NEES), rejected outliers. Then tabs of
a real browser, if there is one, are opened and closed on a live view.
"""

import argparse
import gc
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
from scipy.stats import chi2

from foveate.deploy.tracker import Tracker
from foveate.policies.attention import AttentionSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.target import DriftTarget

RATE_HZ = 100
MOST = 16
"""Number of targets that the decision is compiled for, once."""
ALIVE, LIFE_S, DETECTED, OUTLIERS = 8, 20.0, 0.8, 1e-3
SCENARIO = Scenario(
    tau_s=1 / RATE_HZ,
    target=DriftTarget(process_std_m=0.005),
    view=SectorView(depth_m=1000.0, angle_deg=360.0),
)


@dataclass(frozen=True, kw_only=True)
class Soaked:
    """Results of a loop: times of decisions [s], resident memory [MiB] along the way, NEES, and rejections."""

    steps: int
    ids: int
    median_s: float
    p99_s: float
    memory_mib: list[float]
    nees: float
    nees_band: tuple[float, float]
    outliers: int
    rejected: int
    restarts: int

    @property
    def growth_mib(self) -> float:
        """Growth of memory [MiB] from a tenth of the way to the end."""
        return self.memory_mib[-1] - self.memory_mib[len(self.memory_mib) // 10]


def resident_mib() -> float:
    """Memory of this process [MiB]: current, or the peak where the current one cannot be read."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def soak(seconds: float, seed: int = 0, decide_every: int = 1, report: Callable[[str], None] = print) -> Soaked:
    """Run the loop for this long, in the robot's own time, deciding at every `decide_every`-th step."""
    problem, rng, steps = SCENARIO.problem(), np.random.default_rng(seed), round(seconds * RATE_HZ)
    policy = AttentionSettings().policy(problem, jax.random.key(seed))
    decide = eqx.filter_jit(lambda seen: problem.agent.control(policy(seen, (), jax.random.key(0))[0]))
    tracker, pose = Tracker(SCENARIO, forget_after_s=1.0), np.zeros(3)
    alive: dict[int, np.ndarray] = {}
    born = outliers = rejected = restarts = 0
    times, memory, squares, (v, w) = np.full(steps, np.nan), [], [], np.zeros(2)  # all its memory at once
    decide(tracker.observation(pose, 10, MOST))
    gc.collect()
    for k in range(steps):
        for name in [name for name in alive if rng.random() < 1 / (LIFE_S * RATE_HZ)]:
            del alive[name]
        while len(alive) < ALIVE and rng.random() < 0.05:
            alive[born] = rng.uniform(-20, 20, 2)
            born += 1
        began = time.process_time()
        tracker.predict()
        if k % decide_every == 0:
            v, w = np.asarray(decide(tracker.observation(pose, 10, MOST)), float)
        times[k] = time.process_time() - began
        pose = pose + np.array([v * np.cos(pose[2]), v * np.sin(pose[2]), w]) / RATE_HZ
        for name in alive:
            alive[name] = alive[name] + rng.normal(0, 0.005, 2)
        detections = {name: y + rng.normal(0, 0.2, 2) for name, y in alive.items() if rng.random() < DETECTED}
        for name in detections:
            if name in tracker.ids and rng.random() < OUTLIERS:
                detections[name] = detections[name] + 100 * 0.25
                outliers += 1
        seen = tracker.update(pose, detections)
        rejected += len(seen.rejected)
        restarts += sum(name in tracker.rejected for name in seen.appeared)
        if k % (5 * RATE_HZ) == 5 * RATE_HZ - 1:
            squares += errors(tracker, alive)
            memory.append(resident_mib())
        if (k + 1) % max(1, steps // 10) == 0:
            report(f"{k + 1} steps: {resident_mib():.1f} MiB, {time.process_time():.0f} s of a core")
    count = 2 * len(squares)
    band = tuple(float(x) / len(squares) for x in chi2.interval(0.999, count))
    return Soaked(
        steps=steps,
        ids=born,
        median_s=float(np.median(times[::decide_every])),
        p99_s=float(np.quantile(times[::decide_every], 0.99)),
        memory_mib=memory,
        nees=float(np.mean(squares)),
        nees_band=(band[0], band[1]),
        outliers=outliers,
        rejected=rejected,
        restarts=restarts,
    )


def errors(tracker: Tracker, alive: dict[int, np.ndarray]) -> list[float]:
    """e^T P^-1 e of every target that exists and is tracked."""
    found = []
    for name, mean, covariance in zip(tracker.ids, tracker.mean, tracker.covariance, strict=True):
        if name in alive:
            error = mean - alive[name]
            found.append(float(error @ np.linalg.solve(covariance, error)))
    return found


def faults(found: Soaked) -> list[str]:
    """Describe the expectations that the results violate."""
    said = []
    if found.growth_mib > 8.0:
        said.append(f"memory grew by {found.growth_mib:.1f} MiB")
    if found.p99_s > 3 * found.median_s:
        said.append(f"p99 of a decision is {found.p99_s / found.median_s:.1f} times its median")
    if not found.nees_band[0] <= found.nees <= found.nees_band[1]:
        said.append(f"NEES {found.nees:.3f} is outside of {found.nees_band[0]:.3f} .. {found.nees_band[1]:.3f}")
    if not found.outliers <= found.rejected <= found.outliers + 20 + 2e-4 * found.steps * ALIVE:
        said.append(f"{found.rejected} rejected, of {found.outliers} outliers")
    return said


def tabs(count: int) -> str:
    """Open and close N tabs on a live view, which must keep running; return a report."""
    from helpers.browser import CHROMIUM, Browser, wait_for
    from helpers.episode_data import late_sightings

    from foveate.plotting.live import server as view

    if CHROMIUM is None:
        return "no chromium here: the live view was not looked at"
    data = late_sightings(steps=400, n=4)
    source = view.EpisodeSource(scenes=("one",), methods=("still",), episode=lambda scene, method: data)
    with tempfile.TemporaryDirectory() as folder, view._server(0) as server:
        player = view.Player(server, source)
        player.tick(0.0)
        browser = Browser(Path(folder))
        before = resident_mib()
        try:
            for _ in range(count):
                target = browser.ask("Target.createTarget", url=f"http://127.0.0.1:{server.get_port()}")["targetId"]
                wait_for(lambda: len(server.get_clients()) == 1)
                player.tick(0.1)
                browser.ask("Target.closeTarget", targetId=target)
                wait_for(lambda: not server.get_clients())
        finally:
            browser.close()
    return f"{count} tabs opened and closed; memory of the view grew by {resident_mib() - before:.1f} MiB"


def main() -> int:
    """Run both and report; return exit status 1 if an expectation is violated."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seconds", type=float, default=3600.0)
    options.add_argument("--decide-every", type=int, default=1, help="steps; more for a long run in less time")
    options.add_argument("--tabs", type=int, default=20)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    found = soak(given.seconds, given.seed, given.decide_every)
    print(f"{found.steps} steps, {found.ids} ids, {found.outliers} outliers, {found.rejected} rejected", end=", ")
    print(f"{found.restarts} restarted")
    print(f"predict and decide: median {1e6 * found.median_s:.0f} us, p99 {1e6 * found.p99_s:.0f} us", end=", ")
    print(f"{found.p99_s / found.median_s:.2f} times the median")
    print(f"memory {found.memory_mib[0]:.1f} MiB at first, {found.memory_mib[-1]:.1f} at the end", end=", ")
    print(f"{found.growth_mib:+.1f} from a tenth of the way on")
    print(f"NEES {found.nees:.3f}, band {found.nees_band[0]:.3f} .. {found.nees_band[1]:.3f}")
    if given.tabs:
        print(tabs(given.tabs))
    for line in faults(found):
        print(f"NOT AS IT SHOULD BE: {line}")
    return bool(faults(found))


if __name__ == "__main__":
    sys.exit(main())
