"""Eight floats that a compiled loop handles as one number: a vector of the processor.

Numba leaves it to the compiler to find vectors, which it does over long arrays and not over a
pixel's seven patterns. `Lanes` inside an njit function knows + - *, the sum and the largest; the
patterns of a pixel lie in its lanes. Half floats are turned by the processor's own conversion.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

LANES = 8
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_ANY_ORDER = ("reassoc", "contract", "nsz")
"""Sums may be taken in any order; NaN and infinities stay what they are."""


class LanesType(types.Type):
    """Numba's type of eight float32."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes{LANES}")


LANES_TYPE = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


def _place(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Pointer to eight floats of a flat array, from an index on."""
    array = context.make_array(signature.args[0])(context, builder, args[0])
    first = builder.gep(array.data, [args[1]])
    return builder.bitcast(first, _VECTOR.as_pointer())


@intrinsic
def load(typing_context: Any, array: Any, first: Any) -> Any:
    """The eight numbers of a flat float32 array from an index on (not checked)."""
    del typing_context

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_place(context, builder, signature, args), align=4)

    return LANES_TYPE(array, types.intp), code


@intrinsic
def store(typing_context: Any, array: Any, first: Any, value: Any) -> Any:
    """Write eight numbers into a flat float32 array from an index on (not checked)."""
    del typing_context

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[2], _place(context, builder, signature, args), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES_TYPE), code


@intrinsic
def every(typing_context: Any, value: Any) -> Any:
    """One number in all lanes."""
    del typing_context

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        single = builder.insert_element(
            ir.Constant(_VECTOR, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0)
        )
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), zeros)

    return LANES_TYPE(types.float32), code


@intrinsic
def total(typing_context: Any, lanes: Any) -> Any:
    """The sum over the lanes."""
    del typing_context

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        kind = ir.FunctionType(ir.FloatType(), [ir.FloatType(), _VECTOR])
        name = f"llvm.vector.reduce.fadd.v{LANES}f32"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        start = ir.Constant(ir.FloatType(), 0.0)
        return builder.call(function, [start, args[0]], fastmath=_ANY_ORDER)

    return types.float32(LANES_TYPE), code


@intrinsic
def largest(typing_context: Any, lanes: Any) -> Any:
    """The largest of the lanes; a NaN among them may be passed over."""
    del typing_context

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        kind = ir.FunctionType(ir.FloatType(), [_VECTOR])
        name = f"llvm.vector.reduce.fmax.v{LANES}f32"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [args[0]])

    return types.float32(LANES_TYPE), code


@intrinsic
def as_float(typing_context: Any, reading: Any) -> Any:
    """float32 of a reading: a half float's 16 bits (uint16), or float32 as it is."""
    del typing_context
    if reading not in (types.uint16, types.float32):
        return None

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context
        if signature.args[0] == types.float32:
            return args[0]
        return builder.fpext(builder.bitcast(args[0], ir.HalfType()), ir.FloatType())

    return types.float32(reading), code


def _pairwise(build: Callable[[Any, Any, Any], Any]) -> Any:
    """An intrinsic of two Lanes."""

    @intrinsic
    def apply(typing_context: Any, left: Any, right: Any) -> Any:
        del typing_context

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            del context, signature
            return build(builder, args[0], args[1])

        return LANES_TYPE(LANES_TYPE, LANES_TYPE), code

    return apply


_plus = _pairwise(lambda builder, a, b: builder.fadd(a, b, flags=_ANY_ORDER))
_minus = _pairwise(lambda builder, a, b: builder.fsub(a, b, flags=_ANY_ORDER))
_times = _pairwise(lambda builder, a, b: builder.fmul(a, b, flags=_ANY_ORDER))
_larger = _pairwise(
    lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b)
)


def at_least(left: Any, right: Any) -> Any:
    """The larger of two Lanes, lane by lane; the second where one is NaN. For compiled code."""
    raise NotImplementedError


def _spread(named: Any, apply: Any) -> None:
    """Let a function or an operator take two Lanes."""

    @overload(named)
    def chosen(left: Any, right: Any) -> Any:
        if not left == right == LANES_TYPE:
            return None

        def code(left: Any, right: Any) -> Any:
            return apply(left, right)

        return code


for _named, _apply in (
    (operator.add, _plus),
    (operator.sub, _minus),
    (operator.mul, _times),
    (at_least, _larger),
):
    _spread(_named, _apply)
