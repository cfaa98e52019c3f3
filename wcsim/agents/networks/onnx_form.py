"""Networks in ONNX's form: https://onnx.ai; the extra `train` brings what is needed."""

import io
import warnings
from collections.abc import Sequence

import torch
from torch import nn

from wcsim.errors import PolicyError, check_installed

OPSET = 18


def require_onnx_installed() -> None:
    """Raise PolicyError where the extra `train` is not installed."""
    check_installed("exporting needs ONNX", "train", "onnx", error=PolicyError)


def network_to_onnx(
    net: nn.Module, given: tuple[torch.Tensor, ...], inputs: Sequence[str], outputs: Sequence[str]
) -> bytes:
    """A network as an ONNX model, for inputs of these very shapes.

    Args:
        net: Called with tensors alone.
        given: An example of each.
        inputs: Their names.
        outputs: Names of what it returns.

    Raises:
        PolicyError: ONNX is not installed, or the network cannot be expressed in it.
    """
    held = io.BytesIO()
    require_onnx_installed()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # tracing warns of every shape that is a Python number
            names = {"input_names": list(inputs), "output_names": list(outputs)}
            torch.onnx.export(net, given, held, opset_version=OPSET, dynamo=False, **names)  # type: ignore[arg-type]
    except (RuntimeError, torch.onnx.errors.OnnxExporterError) as error:
        raise PolicyError(
            f"the network cannot be exported to ONNX: {str(error).splitlines()[0][:200]}"
        ) from None
    return held.getvalue()
