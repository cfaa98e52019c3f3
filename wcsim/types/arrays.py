"""Names for NumPy arrays, and equality for dataclasses that hold arrays."""

from dataclasses import fields

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]


class ComparesArrays:
    """Base with an equality that works for arrays: same type, equal fields, equal elements."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return False
        for item in fields(self):  # type: ignore[arg-type]
            value, other_value = getattr(self, item.name), getattr(other, item.name)
            is_array = isinstance(value, np.ndarray)
            if not (np.array_equal(value, other_value) if is_array else value == other_value):
                return False
        return True
