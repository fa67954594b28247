"""Exact dynamics of a rigid body that rolls without slipping, in JAX.

The public names stand in ``__init__.pyi``. They are imported when first used, so that
``rollkane --help`` need not wait for JAX. Importing rollkane changes no global setting.
"""

import typing as _typing

import lazy_loader  # pyright: ignore[reportMissingTypeStubs]

from . import moved_modules as _moved_modules

__version__ = "0.2.0"

_public, __dir__, __all__ = _typing.cast(
    tuple[
        _typing.Callable[[str], _typing.Any],
        _typing.Callable[[], list[str]],
        list[str],
    ],
    lazy_loader.attach_stub(__name__, __file__),
)
_moved_modules.install()


def __getattr__(name: str) -> _typing.Any:
    """A public name, or a module by the name that it had before."""
    if name in _moved_modules.NEW:
        return _moved_modules.module(name)
    if name in __all__:
        return _public(name)
    raise AttributeError(f"module 'rollkane' has no attribute {name!r}")
