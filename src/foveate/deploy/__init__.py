"""Deployment on a robot: belief, tracker, trained policy, ONNX."""
