"""LLVM instructions that process the rows of a work array in SIMD vectors."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

FUSED = ("contract",)  # LLVM flag that lets a multiplication and an addition become one instruction
_INT32 = ir.IntType(32)


def splat(builder: Any, value: Any, width: int) -> Any:
    """Return a vector of `width` lanes that all contain `value`."""
    vector = ir.VectorType(value.type, width)
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, _INT32(0))
    zeros = ir.Constant(ir.VectorType(_INT32, width), [0] * width)
    return builder.shuffle_vector(first, undefined, zeros)


def add_pairwise(builder: Any, terms: list[Any], flags: tuple[str, ...] = ()) -> Any:
    """Return the sum of terms, added as a balanced tree."""
    while len(terms) > 1:
        pairs = [builder.fadd(*terms[i : i + 2], flags=flags) for i in range(0, len(terms) - 1, 2)]
        terms = pairs + terms[2 * len(pairs) :]
    return terms[0]


class VectorRows:
    """The rows of a work array (rows, stride) as LLVM instructions address them.

    Attributes:
        stride: LLVM value: distance between the starts of successive rows, in floats.
        vector: LLVM type of `width` float64 numbers.
    """

    def __init__(self, context: Any, builder: Any, array_type: Any, work: Any, width: int) -> None:
        """Store numba's context and builder, and the type and value of the work array."""
        array = context.make_array(array_type)(context, builder, work)
        self._data, self._builder, self._width = array.data, builder, width
        self.stride = builder.extract_value(array.shape, 1)
        self.vector = ir.VectorType(ir.DoubleType(), width)

    def at(self, row: Any, index: Any = None) -> Any:
        """Return a pointer to an entry of a row; without an index, to the first entry.

        Args:
            row: Row, a Python integer or an LLVM value.
            index: Index within the row, an LLVM value.
        Returns:
            The pointer.
        """
        start = self.stride.type(row) if isinstance(row, int) else row
        position = self._builder.mul(self.stride, start)
        if index is not None:
            position = self._builder.add(position, index)
        return self._builder.gep(self._data, [position])

    def splat(self, value: Any) -> Any:
        """Return a vector that contains the same number in all lanes."""
        return splat(self._builder, value, self._width)

    def number(self, row: Any, index: Any) -> Any:
        """Return a vector that contains one entry of a row in all lanes."""
        return self.splat(self._builder.load(self.at(row, index), align=8))

    def load(self, row: Any, index: Any) -> Any:
        """Return the vector that starts at an index of a row."""
        return self._builder.load(self._vector_at(row, index), align=8)

    def store(self, value: Any, row: Any, index: Any) -> None:
        """Store a vector at an index of a row."""
        self._builder.store(value, self._vector_at(row, index), align=8)

    def _vector_at(self, row: Any, index: Any) -> Any:
        return self._builder.bitcast(self.at(row, index), self.vector.as_pointer())
