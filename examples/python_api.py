# pyright: strict
"""Use foveate from Python: a trained policy, a belief, a command, a loop with a tracker, an evaluation.

    python examples/python_api.py [RUN|PRESET]

The default is the trained policy of the preset `true-view`, which is in the package.
"""

import sys

import numpy as np

import foveate


def main(run: str = "true-view") -> foveate.Evaluation:
    """Show each part of the API once, in the plane."""
    policy = foveate.load(run)
    print(policy)

    # One decision. Beliefs may come from any source; the policy expects them predicted by one control period.
    now = foveate.Belief(mean=[[3.0, 1.0], [-2.0, 4.0]], covariance=[0.2 * np.eye(2), 1.5 * np.eye(2)])
    pose = np.array([0.0, 0.0, np.pi / 2])
    command = policy(policy.predict(now), pose)
    print(", ".join(f"{axis} {value:+.2f}" for axis, value in zip(policy.axes, command, strict=True)), "[m/s, rad/s]")

    # A loop with a tracker that maintains the beliefs: predict, decide, move, detect, update. Here the only target
    # stands still and is detected within 2 m.
    target, tracker, tau = np.array([4.0, 2.0]), foveate.Tracker(policy.scenario), policy.scenario.tau_s
    tracker.add("somebody", [3.0, 3.0])
    for _ in range(12):
        tracker.predict()
        v, w = policy(tracker.belief(), pose)
        pose = pose + tau * np.array([v * np.cos(pose[2]), v * np.sin(pose[2]), w])
        near = float(np.linalg.norm(target - pose[:2])) < 2.0
        tracker.update(pose, {"somebody": target} if near else {})
    print(f"the tracker has {tracker.belief()}")

    # Scores on the paper's scenes. method=["policy", "uncertain"] adds a heuristic for comparison.
    found = foveate.evaluate(policy, "table1", protocol="true")
    print(found)
    hardest = min(found.summary, key=lambda cell: cell.mean)
    print(f"{hardest.targets} targets, {hardest.motion}: {hardest.mean:.2f}, the least; of {len(found.rows)} episodes")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:2])
