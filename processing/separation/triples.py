"""Eight pixels' red, green and blue, which are interleaved in a picture, as three `Lanes`."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from processing.lanes import LANES, LANES_TYPE

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_ANY_ORDER = ("reassoc", "contract", "nsz")


def _mixed(builder: Any, one: Any, other: Any, places: list[int | None]) -> Any:
    """Lanes of two vectors; places from 8 on are the second's, None is any."""
    kind = ir.IntType(32)
    chosen = [ir.Constant(kind, 0 if p is None else p) for p in places]
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(kind, LANES), chosen))


def _chunks(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> list[Any]:
    """Pointers to three times eight numbers of a flat array, from an index on."""
    data = context.make_array(kind)(context, builder, array).data
    item = ir.HalfType() if kind.dtype == types.uint16 else ir.FloatType()
    whole = ir.VectorType(item, LANES).as_pointer()
    out = []
    for chunk in range(3):
        index = builder.add(first, ir.Constant(ir.IntType(64), chunk * LANES))
        out.append(builder.bitcast(builder.gep(data, [index]), whole))
    return out


@intrinsic
def load_triples(typing_context: Any, array: Any, first: Any) -> Any:
    """Red, green and blue of eight pixels of a flat array, from an index on (not checked).

    The array holds half floats' bits (uint16), which the processor turns.
    """
    del typing_context, first
    if not isinstance(array, types.Array) or array.dtype != types.uint16:
        return None

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        found = [
            builder.fpext(builder.load(place, align=2), _VECTOR)
            for place in _chunks(context, builder, signature.args[0], args[0], args[1])
        ]
        colours = []
        for colour in range(3):
            places = [3 * pixel + colour for pixel in range(LANES)]
            two: list[int | None] = [p if p < 2 * LANES else None for p in places]
            part = _mixed(builder, found[0], found[1], two)
            last: list[int | None] = [
                pixel if p < 2 * LANES else p - LANES for pixel, p in enumerate(places)
            ]
            colours.append(_mixed(builder, part, found[2], last))
        return context.make_tuple(builder, signature.return_type, colours)

    return types.UniTuple(LANES_TYPE, 3)(array, types.intp), code


@intrinsic
def store_triples(
    typing_context: Any, array: Any, first: Any, red: Any, green: Any, blue: Any
) -> Any:
    """Write eight pixels' colours interleaved into a flat float32 array from an index on."""
    del typing_context, first, red, green, blue
    if not isinstance(array, types.Array) or array.dtype != types.float32:
        return None

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        colours = args[2:]
        places = _chunks(context, builder, signature.args[0], args[0], args[1])
        for chunk, place in enumerate(places):
            numbers = [divmod(chunk * LANES + lane, 3) for lane in range(LANES)]
            two: list[int | None] = [
                None if colour == 2 else pixel + LANES * colour for pixel, colour in numbers
            ]
            part = _mixed(builder, colours[0], colours[1], two)
            last: list[int | None] = [
                pixel + LANES if colour == 2 else lane
                for lane, (pixel, colour) in enumerate(numbers)
            ]
            builder.store(_mixed(builder, part, colours[2], last), place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES_TYPE, LANES_TYPE, LANES_TYPE), code


@intrinsic
def over_root(typing_context: Any, value: Any) -> Any:
    """1 / sqrt of each lane: infinite for 0, NaN below."""
    del typing_context, value

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        del context, signature
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.sqrt.v{LANES}f32")
        one = ir.Constant(_VECTOR, [1.0] * LANES)
        return builder.fdiv(one, builder.call(function, [args[0]]), flags=_ANY_ORDER)

    return LANES_TYPE(LANES_TYPE), code
