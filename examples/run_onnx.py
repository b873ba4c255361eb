"""Run an exported policy with NumPy and onnxruntime only:

    foveate export runs/first policy.onnx
    python examples/run_onnx.py policy.onnx

Copy `OnnxPolicy` to your robot: it converts beliefs (means and covariances in the world frame) into the inputs of the
network, and returns the command.
"""

import hashlib
import json
import re
import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime


class OnnxPolicy:
    """Policy from a file of `foveate export`."""

    def __init__(self, path: str) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # a network this small is slower on several threads
        data = self.intact(path)
        try:
            self.session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
            self.facts = self.session.get_modelmeta().custom_metadata_map
            if (self.facts.get("format"), self.facts.get("format_version")) != ("foveate-policy", "1"):
                raise ValueError("not a foveate-policy of version 1")
            self.wanted = [each.name for each in self.session.get_inputs()]
            self.output, self.model = json.loads(self.facts["output"]), json.loads(self.facts["model"])
            self.rays = json.loads(self.facts.get("rays", "null"))
        except Exception as error:  # of many classes of onnxruntime, without the file's name
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ValueError(f"{path}: {reason:.200}: export it with the foveate of this example") from error

    @staticmethod
    def intact(path: str) -> bytes:
        """Bytes of a file whose digest fits: another byte may be another command, which nothing else would tell."""
        data = Path(path).read_bytes()
        digests = re.findall(rb"sha256\x12\x40([0-9a-f]{64})", data)  # key and value of the metadata
        if not digests or hashlib.sha256(data.replace(digests[-1], b"0" * 64)).hexdigest().encode() != digests[-1]:
            raise ValueError(f"{path}: damaged, or of an earlier foveate: export it with the foveate of this example")
        return data

    def predict(self, mean, covariance, known_input=None, step=0):
        """Predict the beliefs at the end of the coming step: A mean + B xi, A P A^T + W."""
        now = self.model["steps"][step % len(self.model["steps"])]
        A, B, W = (np.array(now[name]) for name in ("A", "B", "W"))
        if known_input is None:
            known_input = np.zeros((len(mean), B.shape[1]))
        return mean @ A.T + known_input @ B.T, A @ covariance @ A.T + W, known_input

    @staticmethod
    def rotation(pose):
        """Rotation from body to world of [x, y, yaw], or of a 4 x 4 transform."""
        if np.ndim(pose) == 2:
            return pose[:3, :3]
        return np.array([[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]])

    def around(self, pose, positions, ranges=None):
        """What a policy with rays is told of obstacles, from measured ranges alone; without them all is free.

        Ways are straight, without a planner of the robot's own, and a target is seen if the ray next to it is free.
        """
        offset = positions - (pose[:3, 3] if np.ndim(pose) == 2 else pose[:2])
        away = np.linalg.norm(offset, axis=1)
        directions, longest = np.array(self.rays["directions"]), self.rays["longest_m"]
        ranges = np.full(len(directions), longest) if ranges is None else np.minimum(ranges, longest)
        nearest = np.argmax(offset @ self.rotation(pose) @ directions.T, axis=1)
        is_seen = (away <= ranges[nearest]) | (ranges[nearest] >= longest)
        told = {"ranges": ranges, "way_place": positions, "way_length": away}
        told = {name: np.asarray(value, np.float32) for name, value in told.items()}
        return {**told, "is_straight": np.ones(len(away), bool), "is_seen": is_seen}

    def __call__(self, pose, mean, covariance, known_input=None, steps_left=None, step=0, ranges=None):
        """Return the command by axis [m/s, rad/s] at a pose, for CURRENT beliefs, shapes (n, n_y) and (n, n_y, n_y).

        The pose is [x, y, yaw], or in space the 4 x 4 transform from body to world. n may be 0. Without `steps_left`,
        for a task without an end, the policy acts as in the middle of an episode. `ranges` [m] are those along the rays
        of a policy that has any.
        """
        mean, covariance, known_input = self.predict(mean, covariance, known_input, step)
        inputs = {
            "pose": np.asarray(pose, np.float32),
            "mean": mean.astype(np.float32),
            "information": np.linalg.inv(covariance).astype(np.float32),
            "present": np.ones(len(mean), bool),
            "known_input": known_input.astype(np.float32),
            "steps_left": np.array(steps_left or self.facts["steps_left"], np.int64),
            "step": np.array(step, np.int64),
        }
        if self.rays:
            inputs |= self.around(np.asarray(pose, float), mean @ np.array(self.model["Z"]).T, ranges)
        (control,) = self.session.run(["control"], {name: inputs[name][None] for name in self.wanted})
        return dict(zip(self.output["axes"], control[0].tolist(), strict=True))


def main(path: str) -> None:
    """Decide for three example targets around the origin, and measure the decision time."""
    policy = OnnxPolicy(path)
    size, d = len(policy.model["Z"][0]), len(policy.model["Z"])
    mean = np.zeros((3, size))
    mean[:, :2] = [[3.0, 1.0], [-2.0, 4.0], [5.0, -3.0]]
    covariance = np.array([0.04, 1.0, 4.0])[:, None, None] * np.eye(size)
    pose = np.zeros(3) if d == 2 else np.eye(4)
    for axis, value in policy(pose, mean, covariance).items():
        print(f"{axis} = {value:+.4f} {dict(zip(policy.output['axes'], policy.output['units'], strict=True))[axis]}")
    began = time.perf_counter()
    for _ in range(200):
        policy(pose, mean, covariance)
    print(f"{(time.perf_counter() - began) / 200 * 1e6:.0f} us a decision, one every {policy.facts['tau_s']} s")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("run_onnx.py POLICY.onnx: expected one file, as `foveate export` writes it")
    main(sys.argv[1])
