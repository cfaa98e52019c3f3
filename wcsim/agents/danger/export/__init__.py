"""A danger network for machines that have no wcsim: as one ONNX model a tick; how it is made, checked and measured."""
