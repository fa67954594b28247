"""Digests of programs: what they compute, not what their functions are called."""

import hashlib
import re
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.extend as jex
import jax.numpy as jnp
import numpy as np

from .checks import is_traced

# where an object lies in memory says nothing of what it is
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")
# of an equation, what is for people only
_NAMES = ("name", "debug_info", "source_info", "call_name")


def digest_of_program(function: Callable[..., Any], *arguments: Any) -> str:
    """Digest of the program that JAX makes of a function.

    It depends on operations, their order and every number that the function closes
    over; not on the names of functions, on comments, or on where something is kept.
    What a callback to Python computes is not seen.

    Args:
        function: That JAX can trace.
        arguments: Arrays of the shapes and types for which it is traced.
    """
    return digest_of_traced(jax.make_jaxpr(function)(*arguments))


def digest_of_traced(program: jex.core.ClosedJaxpr) -> str:
    """The same of a program that JAX made; traced numbers count by shape and type."""
    return _Walk().closed(program)


def digest_of_bytes(parts: Iterable[bytes]) -> str:
    """SHA-256 of parts, in hexadecimal digits; each with its length."""
    found = hashlib.sha256()
    for part in parts:
        found.update(f"{len(part)}:".encode() + part)
    return found.hexdigest()


def bytes_of_array(number: Any) -> bytes:
    """Type, shape and numbers of an array; of a traced one no numbers."""
    if is_traced(number):
        return f"{number.dtype}{number.shape}".encode()
    keys = isinstance(number, jax.Array) and jnp.issubdtype(
        number.dtype, jax.dtypes.prng_key
    )
    array = np.asarray(jax.random.key_data(number) if keys else number)
    return f"{array.dtype}{array.shape}".encode() + array.tobytes()


class _Walk:
    """One program and those inside of it, each looked at once."""

    def __init__(self):
        # with the programs, so that none makes place for another at its address
        self._known: dict[int, tuple[Any, str]] = {}

    def closed(self, program: Any) -> str:
        """Digest of a program with the numbers that it closes over."""
        numbers: Callable[[], Iterable[bytes]] = lambda: map(
            bytes_of_array, program.consts
        )
        parts = lambda: [self.open(program.jaxpr).encode(), *numbers()]
        return self._once(program, lambda: digest_of_bytes(parts()))

    def open(self, jaxpr: Any) -> str:
        """Digest of a program without them."""
        return self._once(jaxpr, lambda: digest_of_bytes(self._equations(jaxpr)))

    def _once(self, one: Any, digest: Callable[[], str]) -> str:
        if id(one) not in self._known:
            self._known[id(one)] = one, digest()
        return self._known[id(one)][1]

    def _equations(self, jaxpr: Any) -> Iterable[bytes]:
        numbers: dict[Any, int] = {}

        def place(x: Any) -> bytes:
            if isinstance(x, jex.core.Literal):
                return bytes_of_array(x.val)
            return f"{numbers.setdefault(x, len(numbers))}:{x.aval}".encode()

        yield b" ".join(map(place, [*jaxpr.constvars, *jaxpr.invars]))
        for equation in jaxpr.eqns:
            yield str(equation.primitive).encode()
            yield from map(place, equation.invars)
            for name in sorted(set(equation.params) - {*_NAMES}):
                yield name.encode()
                yield from self._parameter(equation.params[name])
            yield b" ".join(map(place, equation.outvars))
        yield b" ".join(map(place, jaxpr.outvars))

    def _parameter(self, value: Any) -> Iterable[bytes]:
        if isinstance(value, jex.core.ClosedJaxpr):
            yield self.closed(value).encode()
        elif isinstance(value, jex.core.Jaxpr):
            yield self.open(value).encode()
        elif isinstance(value, (np.ndarray, jax.Array)):
            yield bytes_of_array(value)
        elif type(value) in (tuple, list):
            yield f"{len(value)}".encode()
            for part in value:
                yield from self._parameter(part)
        elif callable(value) and type(value) is not type:
            yield type(value).__name__.encode()  # a rule, or a callback, by a name
        else:
            yield _ADDRESS.sub("", str(value)).encode()
