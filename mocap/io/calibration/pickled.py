"""Arrays and plain values out of a pickle, without running it.

A pickle is a program, and running one of a stranger's runs whatever the stranger likes. This reads its instructions and
follows those alone that put together maps, lists, tuples, text, numbers and numpy arrays of numbers; every other one,
and every other name that the pickle asks for, is refused. Nothing is imported and nothing called.
"""

from __future__ import annotations

import pickletools
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mocap.errors import MocapError
from mocap.files import read_bytes

LIMIT_BYTES = 1_000_000  # a calibration of one camera takes a thousand
_MOST_NUMBERS = 10_000
_DTYPES = {kind + size for kind in "fiu" for size in ("2", "4", "8")} | {"i1", "u1", "b1"}
_MOST_VALUES = 10_000
# What numpy calls its own makers of arrays, today and in versions past.
_GLOBALS = {
    **{(f"numpy.{core}.multiarray", "_reconstruct"): "reconstruct" for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): "scalar" for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): "frombuffer" for core in ("core", "_core")},
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    ("_codecs", "encode"): "encode",
}


class _Refused(Exception):
    """The pickle wants what it does not get."""


@dataclass(frozen=True)
class _Global:
    """A name that the pickle asks for; only its meaning here is kept."""

    word: str


@dataclass
class _Dtype:
    """Kind and size of numbers, with their order of bytes."""

    name: str
    order: str = "<"

    def of_numpy(self) -> np.dtype[Any]:
        return np.dtype(("" if self.name[-1] == "1" else self.order) + self.name)


@dataclass
class _Array:
    """An array that is being put together; value : once it is."""

    value: np.ndarray | None = None


@dataclass
class _Machine:
    """Stack, marks and memory of a pickle."""

    stack: list[Any] = field(default_factory=list)
    marks: list[int] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)

    def pop(self) -> Any:
        if not self.stack:
            raise _Refused("it ends too early")
        return self.stack.pop()

    def to_mark(self) -> list[Any]:
        if not self.marks:
            raise _Refused("a mark is missing")
        at = self.marks.pop()
        taken = self.stack[at:]
        del self.stack[at:]
        return taken


def read_pickled(path: Path, what: str) -> Any:
    """Maps, lists, tuples, text, numbers and arrays of a pickle.

    what : the file in words.  Raises MocapError for a pickle of anything else, too large a file, and no pickle at all.
    """
    data = read_bytes(path, what, limit=LIMIT_BYTES)
    try:
        # Texts of the oldest protocol may hold escapes that Python warns of.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _followed(data)
    except _Refused as refused:
        raise MocapError(
            f"{what} is a pickle with {refused}; only numbers, text and arrays are read",
            path=path,
            remedy="a pickle can run programs: use the file as its tool wrote it, or another format",
        ) from refused
    except RecursionError as error:
        raise MocapError(
            f"{what} is nested too deeply", path=path, remedy="use the file of the tool"
        ) from error
    except (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        OverflowError,
        AttributeError,
        UnicodeError,
    ) as error:
        raise MocapError(
            f"{what} cannot be read as a pickle", path=path, remedy="copy the file again"
        ) from error


def _followed(data: bytes) -> Any:
    """The value that the instructions put together."""
    machine = _Machine()
    for code, argument, _ in pickletools.genops(data):
        if code.name == "STOP":
            break
        step = _STEPS.get(code.name)
        if step is None:
            raise _Refused(f"the instruction {code.name}")
        step(machine, argument)
    return _plain(machine.pop())


def _plain(value: Any) -> Any:
    """Arrays in place of what stood for them; what refers to itself has no end and is refused."""
    left = [_MOST_VALUES]

    def plain(value: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise _Refused("values without end")
        if isinstance(value, _Array):
            if value.value is None:
                raise _Refused("an array without content")
            return value.value
        if isinstance(value, dict):
            return {key: plain(own) for key, own in value.items()}
        if isinstance(value, (list, tuple)):
            return type(value)(plain(own) for own in value)
        if isinstance(value, (_Global, _Dtype)):
            raise _Refused("a name in place of a value")
        return value

    return plain(value)


def _global(module: str, name: str) -> _Global:
    word = _GLOBALS.get((module, name))
    if word is None:
        raise _Refused(f"the name {module}.{name}"[:120])
    return _Global(word)


def _stack_global(machine: _Machine, _: Any) -> None:
    name, module = machine.pop(), machine.pop()
    machine.stack.append(_global(str(module), str(name)))


def _reduce(machine: _Machine, _: Any) -> None:
    arguments, maker = machine.pop(), machine.pop()
    if not isinstance(maker, _Global) or not isinstance(arguments, tuple):
        raise _Refused("a call")
    machine.stack.append(_made(maker.word, arguments))


def _made(word: str, arguments: tuple[Any, ...]) -> Any:
    """What numpy would make of the arguments."""
    if word == "dtype" and arguments:
        name = str(arguments[0])
        if name not in _DTYPES:
            raise _Refused(f"numbers of the kind {name!r}"[:60])
        return _Dtype(name)
    if word == "reconstruct":
        return _Array()
    if word == "scalar" and len(arguments) == 2:
        return _filled(arguments[0], (), arguments[1], "C")[()].item()
    if word == "frombuffer" and len(arguments) == 4:
        buffer, dtype, shape, order = arguments
        return _Array(_filled(dtype, shape, buffer, order))
    if word == "encode" and arguments and isinstance(arguments[0], str):
        return arguments[0].encode("latin1")
    raise _Refused(f"a call of {word}")


def _filled(dtype: Any, shape: Any, content: Any, order: str) -> np.ndarray:
    """An array from its bytes."""
    if not isinstance(dtype, _Dtype) or not isinstance(content, (bytes, bytearray)):
        raise _Refused("an array of objects")
    sizes = tuple(int(n) for n in shape)
    count = 1
    for n in sizes:
        count *= n
        if n < 0 or count > _MOST_NUMBERS:
            raise _Refused(f"an array of the shape {sizes}"[:60])
    own = dtype.of_numpy()
    if len(content) != count * own.itemsize:
        raise _Refused("an array that does not fit its bytes")
    return np.frombuffer(bytes(content), own).reshape(sizes, order="F" if order == "F" else "C").copy()


def _build(machine: _Machine, _: Any) -> None:
    state, owner = machine.pop(), machine.stack[-1] if machine.stack else None
    if not isinstance(state, tuple):
        raise _Refused("an object")
    if isinstance(owner, _Dtype) and len(state) > 1 and state[1] in ("<", ">", "|", "="):
        owner.order = "<" if state[1] in "|=" else state[1]
    elif isinstance(owner, _Array) and len(state) == 5:
        owner.value = _filled(state[2], state[1], state[4], "F" if state[3] else "C")
    else:
        raise _Refused("an object")


def _set_items(machine: _Machine, pairs: list[Any]) -> None:
    owner = machine.stack[-1] if machine.stack else None
    if not isinstance(owner, dict) or len(pairs) % 2:
        raise _Refused("an object")
    for key, value in zip(pairs[::2], pairs[1::2], strict=True):
        if not isinstance(key, (str, int, float, bytes)):
            raise _Refused("a key that is no text")
        owner[key] = value


def _append(machine: _Machine, values: list[Any]) -> None:
    owner = machine.stack[-1] if machine.stack else None
    if not isinstance(owner, list):
        raise _Refused("an object")
    owner.extend(values)


def _two(machine: _Machine, _: Any) -> None:
    value, key = machine.pop(), machine.pop()
    _set_items(machine, [key, value])


def _tuple_of(n: int) -> Callable[[_Machine, Any], None]:
    def step(machine: _Machine, _: Any) -> None:
        values = [machine.pop() for _ in range(n)]
        machine.stack.append(tuple(reversed(values)))

    return step


def _get(machine: _Machine, at: Any) -> None:
    if int(at) not in machine.memo:
        raise _Refused("a memory that is empty")
    machine.stack.append(machine.memo[int(at)])


def _put(machine: _Machine, at: Any) -> None:
    if not machine.stack:
        raise _Refused("nothing to remember")
    machine.memo[int(at)] = machine.stack[-1]


def _push(machine: _Machine, value: Any) -> None:
    machine.stack.append(value)


def _nothing(machine: _Machine, _: Any) -> None:
    """Versions and frames say nothing of values."""


def _drop(machine: _Machine, _: Any) -> None:
    machine.pop()


def _constant(make: Callable[[], Any]) -> Callable[[_Machine, Any], None]:
    return lambda machine, _: machine.stack.append(make())


# Instructions that bring a value of their own.
_VALUES = (
    *("BININT", "BININT1", "BININT2", "INT", "LONG", "LONG1", "LONG4", "BINFLOAT", "FLOAT"),
    *("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "UNICODE"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
)
_STEPS: dict[str, Callable[[_Machine, Any], None]] = {
    **dict.fromkeys(("PROTO", "FRAME"), _nothing),
    **dict.fromkeys(_VALUES, _push),
    "NONE": _constant(lambda: None),
    "NEWTRUE": _constant(lambda: True),
    "NEWFALSE": _constant(lambda: False),
    "EMPTY_DICT": _constant(dict),
    "EMPTY_LIST": _constant(list),
    "EMPTY_TUPLE": _constant(tuple),
    "TUPLE1": _tuple_of(1),
    "TUPLE2": _tuple_of(2),
    "TUPLE3": _tuple_of(3),
    "TUPLE": lambda machine, _: machine.stack.append(tuple(machine.to_mark())),
    "LIST": lambda machine, _: machine.stack.append(machine.to_mark()),
    "MARK": lambda machine, _: machine.marks.append(len(machine.stack)),
    "SETITEM": _two,
    "SETITEMS": lambda machine, _: _set_items(machine, machine.to_mark()),
    "APPEND": lambda machine, _: _append(machine, [machine.pop()]),
    "APPENDS": lambda machine, _: _append(machine, machine.to_mark()),
    "POP": _drop,
    "MEMOIZE": lambda machine, _: _put(machine, len(machine.memo)),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _put),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), _get),
    "GLOBAL": lambda machine, names: machine.stack.append(_global(*str(names).split(" ", 1))),
    "STACK_GLOBAL": _stack_global,
    "REDUCE": _reduce,
    "BUILD": _build,
}
