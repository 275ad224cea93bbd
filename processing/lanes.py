"""Eight floats that a compiled loop handles as one number: a vector of the processor.

Numba leaves it to the compiler to find vectors, which it does over long arrays and not over a
pixel's seven patterns. `Lanes` inside an njit function knows + - * /, roots, sums and the largest;
its lanes hold the patterns of a pixel, or eight pixels. Half floats are converted by the
processor's own conversion.
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
    """The eight numbers of a C-contiguous float32 array from a flat index on (not checked)."""
    del typing_context, first

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_place(context, builder, signature, args), align=4)

    return LANES_TYPE(array, types.intp), code


@intrinsic
def store(typing_context: Any, array: Any, first: Any, value: Any) -> Any:
    """Write eight numbers into a C-contiguous float32 array from a flat index on (not checked)."""
    del typing_context, first, value

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[2], _place(context, builder, signature, args), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES_TYPE), code


@intrinsic
def every(typing_context: Any, value: Any) -> Any:
    """One number in all lanes."""
    del typing_context, value

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        single = builder.insert_element(
            ir.Constant(_VECTOR, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0)
        )
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), zeros)

    return LANES_TYPE(types.float32), code


@intrinsic
def largest(typing_context: Any, lanes: Any) -> Any:
    """The largest of the lanes; a NaN among them may be passed over."""
    del typing_context, lanes

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        kind = ir.FunctionType(ir.FloatType(), [_VECTOR])
        name = f"llvm.vector.reduce.fmax.v{LANES}f32"
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [args[0]])

    return types.float32(LANES_TYPE), code


@intrinsic
def lane(typing_context: Any, lanes: Any, index: Any) -> Any:
    """One of the lanes."""
    del typing_context, lanes, index

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        return builder.extract_element(args[0], args[1])

    return types.float32(LANES_TYPE, types.intp), code


@intrinsic
def load_row(typing_context: Any, array: Any, first: Any) -> Any:
    """Eight numbers of a flat array of float32, or of half floats' bits (uint16), from an index on.

    Halves are turned by the processor; NaN and infinities stay what they are. Not checked.
    """
    del typing_context, first
    if not isinstance(array, types.Array) or array.dtype not in (types.uint16, types.float32):
        return None

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        place = _place(context, builder, signature, args)
        if kind.dtype == types.float32:
            return builder.load(place, align=4)
        halves = ir.VectorType(ir.HalfType(), LANES)
        found = builder.load(builder.bitcast(place, halves.as_pointer()), align=2)
        return builder.fpext(found, _VECTOR)

    return LANES_TYPE(array, types.intp), code


@intrinsic
def load_bytes(typing_context: Any, array: Any, first: Any) -> Any:
    """Eight whole numbers of a C-contiguous uint8 array from a flat index on (not checked)."""
    del typing_context, first

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = builder.gep(array.data, [args[1]])
        kind = ir.VectorType(ir.IntType(8), LANES)
        found = builder.load(builder.bitcast(place, kind.as_pointer()), align=1)
        return builder.uitofp(found, _VECTOR)

    return LANES_TYPE(array, types.intp), code


@intrinsic
def numbered(typing_context: Any) -> Any:
    """The lanes' numbers: 0 to 7."""
    del typing_context

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, builder, signature, args
        return ir.Constant(_VECTOR, [float(k) for k in range(LANES)])

    return LANES_TYPE(), code


@intrinsic
def between(typing_context: Any, table: Any, place: Any, steps: Any) -> Any:
    """Interpolate a float32 table linearly, lane by lane.

    Args:
        table: flat, of steps + 1 numbers.
        place: Lanes from 0 to `steps`, no NaN (not checked).
        steps: between the table's numbers, at least 1.
    """
    del typing_context, place, steps

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        whole, pair = ir.VectorType(ir.IntType(32), LANES), ir.VectorType(ir.FloatType(), 2)
        array = context.make_array(signature.args[0])(context, builder, args[0])
        last = builder.sub(builder.trunc(args[2], ir.IntType(32)), ir.Constant(ir.IntType(32), 1))
        ends = builder.insert_element(
            ir.Constant(whole, ir.Undefined), last, ir.Constant(ir.IntType(32), 0)
        )
        nothing = ir.Constant(whole, [0] * LANES)
        ends = builder.shuffle_vector(ends, ir.Constant(whole, ir.Undefined), nothing)
        # At the table's end the last step is interpolated to its own end.
        below = builder.fptosi(args[1], whole)
        below = builder.select(builder.icmp_signed("<", below, ends), below, ends)
        rest = builder.fsub(args[1], builder.sitofp(below, _VECTOR))
        joined = []
        for k in range(LANES):
            start = builder.extract_element(below, ir.Constant(ir.IntType(32), k))
            first = builder.gep(array.data, [builder.sext(start, ir.IntType(64))])
            # Both ends of a step at once.
            joined.append(builder.load(builder.bitcast(first, pair.as_pointer()), align=4))
        while len(joined) > 1:
            size = 2 * LANES // len(joined)
            places = ir.Constant(ir.VectorType(ir.IntType(32), 2 * size), list(range(2 * size)))
            joined = [
                builder.shuffle_vector(one, other, places)
                for one, other in zip(joined[::2], joined[1::2], strict=True)
            ]
        low, high = (
            builder.shuffle_vector(
                joined[0],
                joined[0],
                ir.Constant(whole, list(range(side, 2 * LANES, 2))),
            )
            for side in range(2)
        )
        step = builder.fsub(high, low)
        return builder.fadd(low, builder.fmul(rest, step, flags=_ANY_ORDER), flags=_ANY_ORDER)

    return LANES_TYPE(table, LANES_TYPE, types.intp), code


@intrinsic
def where_above(typing_context: Any, left: Any, right: Any, yes: Any, no: Any) -> Any:
    """Lanes of the third where the first is above the second; of the fourth elsewhere and where
    one of the two is NaN.
    """
    del typing_context, left, right, yes, no

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        return builder.select(builder.fcmp_ordered(">", args[0], args[1]), args[2], args[3])

    return LANES_TYPE(*[LANES_TYPE] * 4), code


@intrinsic
def store_turned(
    typing_context: Any,
    array: Any,
    first: Any,
    a: Any,
    b: Any,
    c: Any,
    d: Any,
    e: Any,
    f: Any,
    g: Any,
    h: Any,
) -> Any:
    """Write eight Lanes as the columns of an 8 x 8 table into a flat array: first lanes first."""
    del typing_context, first, a, b, c, d, e, f, g, h

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rows = _turned(builder, list(args[2:]))
        start = _place(context, builder, signature, args)
        for k, row in enumerate(rows):
            index = ir.Constant(ir.IntType(64), k)
            builder.store(row, builder.gep(start, [index]), align=4)
        return context.get_dummy_value()

    eight = [LANES_TYPE] * LANES
    return types.void(array, types.intp, *eight), code


@intrinsic
def totals(
    typing_context: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any
) -> Any:
    """The sums over the lanes of eight Lanes, as Lanes: cheaper than eight sums."""
    del typing_context, a, b, c, d, e, f, g, h

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        rows = list(args)
        while len(rows) > 1:
            pairs = zip(rows[::2], rows[1::2], strict=True)
            rows = [_beside(builder, one, other) for one, other in pairs]
        return rows[0]

    return LANES_TYPE(*[LANES_TYPE] * LANES), code


def _mixed(builder: Any, one: Any, other: Any, places: list[int]) -> Any:
    """Lanes of two vectors; places from 8 on are the second's."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), places)
    return builder.shuffle_vector(one, other, mask)


def _beside(builder: Any, one: Any, other: Any) -> Any:
    """Sums of neighbouring lanes, those of the first vector in the first half."""
    even = _mixed(builder, one, other, list(range(0, 2 * LANES, 2)))
    odd = _mixed(builder, one, other, list(range(1, 2 * LANES, 2)))
    return builder.fadd(even, odd, flags=_ANY_ORDER)


def _turned(builder: Any, rows: list[Any]) -> list[Any]:
    """An 8 x 8 table's columns, by three rounds that swap ever larger squares."""
    for size in (1, 2, 4):
        low = [i if i % (2 * size) < size else i - size + LANES for i in range(LANES)]
        high = [i + size if i % (2 * size) < size else i + LANES for i in range(LANES)]
        out = list(rows)
        for k in range(LANES):
            if k % (2 * size) < size:
                out[k] = _mixed(builder, rows[k], rows[k + size], low)
                out[k + size] = _mixed(builder, rows[k], rows[k + size], high)
        rows = out
    return rows


def _pairwise(build: Callable[[Any, Any, Any], Any]) -> Any:
    """An intrinsic of two Lanes."""

    @intrinsic
    def apply(typing_context: Any, left: Any, right: Any) -> Any:
        del typing_context, left, right

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            del context, signature
            return build(builder, args[0], args[1])

        return LANES_TYPE(LANES_TYPE, LANES_TYPE), code

    return apply


_plus = _pairwise(lambda builder, a, b: builder.fadd(a, b, flags=_ANY_ORDER))
_minus = _pairwise(lambda builder, a, b: builder.fsub(a, b, flags=_ANY_ORDER))
_times = _pairwise(lambda builder, a, b: builder.fmul(a, b, flags=_ANY_ORDER))
_over = _pairwise(lambda builder, a, b: builder.fdiv(a, b, flags=_ANY_ORDER))
at_least = _pairwise(lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b))
"""The larger of two Lanes, lane by lane; the second where one is NaN. For compiled code."""
at_most = _pairwise(lambda builder, a, b: builder.select(builder.fcmp_ordered("<", a, b), a, b))
"""The smaller of two Lanes, lane by lane; the second where one is NaN. For compiled code."""
above = _pairwise(
    lambda builder, a, b: builder.uitofp(builder.fcmp_ordered(">", a, b), _VECTOR),
)
"""1 where the first of two Lanes is the larger, 0 elsewhere and for NaN. For compiled code."""


@intrinsic
def root(typing_context: Any, value: Any) -> Any:
    """Square roots, lane by lane; NaN below 0."""
    del typing_context, value

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        name = f"llvm.sqrt.v{LANES}f32"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)

    return LANES_TYPE(LANES_TYPE), code


def _spread(named: Any, apply: Any) -> None:
    """Let an operator take two Lanes."""

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
    (operator.truediv, _over),
):
    _spread(_named, _apply)
