"""Policies as ONNX graphs (extra `onnx`)."""
