"""What a robot runs: belief, tracker, trained policy, ONNX."""
