"""A trained policy for machines without wcsim: its ONNX model of a tick, checked and measured."""
