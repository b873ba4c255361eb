"""Animate two methods side by side on one scene, with the same noise:

    python examples/side_by_side.py side_by_side.gif

Left a heuristic, right the shipped policy true-view. It draws with matplotlib alone, from the arrays of an episode:
begin here for an animation of your own.
"""

import sys
from collections.abc import Iterator

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

import foveate

METHODS = {"uncertain": "Heuristic: drives to the least known target", "true-view": "Trained: the policy true-view"}
SCENE = "biased-5-00"
FRAMES_PER_STEP, FRAMES_PER_SECOND, HOLD_FRAMES = 3, 10, 20
SEEN, UNSEEN, AGENT, VIEW, GREY = "#009E73", "#D55E00", "#0072B2", "#56B4E955", "#8C8C8C"
CIRCLE = np.stack([np.cos(angles := np.linspace(0, 2 * np.pi, 60)), np.sin(angles)])
CHI2_95 = 5.991
"""95 % of a Gaussian in the plane are within this squared Mahalanobis distance."""


def episodes() -> Iterator[foveate.SimulatedEpisode]:
    """Simulate each method on the scene."""
    policy = foveate.load("true-view")
    (scene,) = [scene for scene in foveate.table1(policy.problem) if scene.id == SCENE]
    for name in METHODS:
        method = policy if name == policy.name else foveate.heuristic(name, policy.scenario)
        yield method.simulate(scene)


def blended(values: np.ndarray, time: float) -> np.ndarray:
    """Interpolate between two instants; `time` in steps."""
    k = min(int(time), len(values) - 2)
    return values[k] + (time - k) * (values[k + 1] - values[k])


def draw(axes: Axes, episode: foveate.SimulatedEpisode, time: float) -> None:
    """Draw the agent, its view, the targets and the 95 % ellipses of the beliefs; `time` in steps."""
    k = int(time)
    poses = episode.arc()
    moments = (len(poses) - 1) // episode.steps
    x, y, yaw = poses[round(time * moments)]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    for outline in episode.outline:
        axes.add_patch(Polygon(outline @ turn.T + [x, y], fc=VIEW, ec=AGENT, lw=0.7))
    axes.plot(*poses[: round(time * moments) + 1, :2].T, color=AGENT, lw=1.5)
    axes.plot(x, y, "o", color=AGENT, ms=6)
    truth, estimate, seen = blended(episode.truth, time), blended(episode.estimate, time), episode.seen_at(k)
    for j in range(episode.targets):
        color, style = (SEEN, "-") if seen[j] else (UNSEEN, "--")
        axes.plot(*np.vstack([episode.truth[: k + 1, j], truth[j]]).T, color=GREY, lw=0.9)
        ellipse = estimate[j] + (np.sqrt(CHI2_95) * np.linalg.cholesky(episode.covariance[k, j]) @ CIRCLE).T
        axes.add_patch(Polygon(ellipse, fc=f"{color}22", ec=color, ls=style, lw=1.3))
        axes.plot(*truth[j], "s", color="black", ms=4)
    found = episode.visible[:k].any(axis=0).sum()
    std_m = np.sqrt(np.linalg.eigvalsh(episode.covariance[k])[:, -1])
    caption = f"{found} of {episode.targets} detected · the worst known to ±{std_m.max():.1f} m"
    axes.set_xlabel(caption, fontsize=11)


def animation(shown: list[foveate.SimulatedEpisode]) -> FuncAnimation:
    """Build the animation."""
    figure = Figure(figsize=(8.0, 4.6), dpi=100, layout="constrained")
    panels = figure.subplots(1, len(shown))
    points = np.concatenate([np.concatenate([e.truth.reshape(-1, 2), e.pose[:, :2]]) for e in shown])
    middle, half = (points.min(0) + points.max(0)) / 2, 0.56 * np.ptp(points, axis=0).max()

    def show(time: float) -> None:
        for axes, episode, title in zip(panels, shown, METHODS.values(), strict=True):
            axes.clear()
            axes.set(aspect="equal", xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
            axes.set(xticks=[], yticks=[])
            axes.set_title(title, fontsize=11, fontweight="bold")
            draw(axes, episode, time)
        figure.suptitle(f"{episode.times_s[-1] * time / episode.steps:.0f} s", fontsize=10, color=GREY)

    last = shown[0].steps
    times = [*np.arange(0, last, 1 / FRAMES_PER_STEP), *[last] * HOLD_FRAMES]
    return FuncAnimation(figure, show, times)


def main(path: str = "side_by_side.gif") -> None:
    """Simulate, draw and write."""
    shown = list(episodes())
    animation(shown).save(path, PillowWriter(FRAMES_PER_SECOND))
    print(f"{path}: " + ", ".join(f"{episode.title} {episode.score:.2f} nat per target" for episode in shown))


if __name__ == "__main__":
    main(*sys.argv[1:2])
