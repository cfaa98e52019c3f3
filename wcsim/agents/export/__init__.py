"""A trained policy for machines without wcsim: as one ONNX model a tick; how it is made, checked and measured."""
