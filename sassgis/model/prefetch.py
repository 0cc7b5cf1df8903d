"""A hint to the processor to fetch what will be touched soon.

What blocks leave in cells lies scattered over tables that no inner cache holds. Which cells a block
has touched is known before they are written to: so they can be on their way meanwhile.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from sassgis.model.jit import loaded_numba

#: Of a line of the cache, which is fetched as a whole, in common processors.
LINE_BYTES = 64

_numba: Any = loaded_numba()


def _typed(_: Any, array: Any, row: Any, byte: Any) -> Any:
    types = _numba.types
    return types.void(array, types.intp, types.intp), _lowered


def _lowered(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    from llvmlite import ir

    array, row, byte = given
    own = _numba.np.arrayobj.make_array(signature.args[0])(context, builder, array)
    step = _numba.core.cgutils.unpack_tuple(builder, own.strides)[0]
    char, number = ir.IntType(8).as_pointer(), ir.IntType(32)
    offset = builder.add(builder.mul(row, step), byte)
    place = builder.gep(builder.bitcast(own.data, char), [offset])
    kind = ir.FunctionType(ir.VoidType(), [char, number, number, number])
    hint = builder.module.declare_intrinsic("llvm.prefetch", [char], kind)
    # To be written to; to stay in all caches; data.
    builder.call(hint, [place, number(1), number(3), number(1)])
    return context.get_dummy_value()


def _nothing(array: NDArray[Any], row: int, byte: int) -> None:
    """Plain Python knows no such hint."""


#: ``prefetch(array, row, byte)``: the line of the cache with the byte of a row; changes nothing.
prefetch: Any = _nothing if _numba.config.DISABLE_JIT else _numba.extending.intrinsic(_typed)
