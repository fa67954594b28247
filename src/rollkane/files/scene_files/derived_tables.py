"""Tables whose fields are the arguments of a constructor.

Names, order and defaults are those of its signature, types those of the attributes of
its class, descriptions the first sentences of its docstring. They are read from the
source, which is not run: the schema and the checks of a file should not wait for JAX.
"""

import ast
import functools
import importlib
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Union, cast

from pydantic import Field, GetCoreSchemaHandler, create_model
from pydantic_core import CoreSchema

from .table_types import Matrix, Quaternion, Table, Vector

# how a file writes what an attribute is to JAX
_TYPES: dict[str, Any] = {
    "Float[Array, '']": float,
    "Float[Array, '3']": Vector,
    "Float[Array, '4']": Quaternion,
    "Float[Array, '3 3']": Matrix,
    "bool": bool,
}
_PACKAGE = Path(__file__).parents[2]


class DerivedTable(Table):
    """A table of what a constructor makes.

    Attributes:
        constructor: Dotted name of its class, from the package.
        arguments: The fields that are its arguments as they stand in the file.
    """

    constructor: ClassVar[str]
    arguments: ClassVar[tuple[str, ...]]

    @classmethod
    def made_by(cls) -> Callable[..., Any]:
        """The class itself, imported."""
        module, _, name = cls.constructor.rpartition(".")
        return getattr(importlib.import_module(f"rollkane.{module}"), name)


def table_of(
    name: str,
    summary: str,
    constructor: str,
    own: type[Table] = Table,
    instead: Mapping[str, tuple[str, ...]] | None = None,
    *,
    kind: str | None = None,
    narrower: Mapping[str, Any] | None = None,
    first: tuple[str, ...] = (),
) -> type[DerivedTable]:
    """The table of a class.

    Args:
        name: Of the table, in the schema.
        summary: What it describes, in a sentence.
        constructor: Dotted name of the class, from the package.
        own: Fields of the file's own; they take the place of arguments of their names.
        instead: Argument -> those in its place where names differ; none, where a file
            has no place for it.
        kind: Its ``kind``; None, where nothing else may stand there.
        narrower: Argument -> its type, where that of the attribute allows too much.
        first: Fields that come first, where the constructor has another order.

    Raises:
        TypeError: an argument that a file cannot give, and nothing in its place.
    """
    types = narrower or {}
    replaced = {name: (name,) for name in own.model_fields} | dict(instead or {})
    fields: dict[str, Any] = {} if kind is None else {"kind": (Literal[kind], ...)}
    derived: list[str] = []
    for argument in _arguments(constructor):
        if argument.name in replaced:
            for key in replaced[argument.name]:
                fields[key] = own.model_fields[key].annotation, own.model_fields[key]
        else:
            wanted = types.get(argument.name) or argument.type_in(constructor)
            fields[argument.name] = wanted, argument.field
            derived.append(argument.name)
    fields = {key: fields[key] for key in (*first, *fields)}
    made = create_model(name, __base__=DerivedTable, __doc__=summary, **fields)
    made.constructor, made.arguments = constructor, tuple(derived)
    return made


def tables_of(kinds: Mapping[str, tuple[Any, ...]]) -> dict[str, type[DerivedTable]]:
    """Tables by their ``kind``, which names them.

    Args:
        kinds: Kind -> the next arguments of :func:`table_of`, from the summary on.
    """
    return {
        kind: table_of(kind.title().replace("-", "") + "Table", *given, kind=kind)
        for kind, given in kinds.items()
    }


class OneOf(NamedTuple):
    """Beside the type of a field: which tables it may hold, by their ``kind``."""

    tables: tuple[type[Table], ...]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """The schema of their union, or of the only one."""
        del source
        either = cast(Any, Union)[self.tables]
        if len(self.tables) > 1:
            either = cast(Any, Annotated)[either, Field(discriminator="kind")]
        return handler.generate_schema(either)


class _Argument(NamedTuple):
    """An argument of a constructor, as the source has it."""

    name: str
    attribute: str  # type of the attribute of that name
    default: ast.expr | None
    description: str

    def type_in(self, constructor: str) -> Any:
        """How a file writes it."""
        kind, _, none = self.attribute.partition(" | ")
        if kind not in _TYPES:
            problem = "has no type in a scene file: say what stands instead"
            raise TypeError(f"argument {self.name} of {constructor} {problem}")
        return _TYPES[kind] | None if none == "None" else _TYPES[kind]

    @property
    def field(self) -> Any:
        """Pydantic's field."""
        if self.default is None:
            return Field(description=self.description)
        value = ast.literal_eval(self.default)
        if isinstance(value, tuple):
            value = list(cast(tuple[Any, ...], value))
        return Field(default=value, description=self.description)


def _arguments(constructor: str) -> Iterator[_Argument]:
    """Arguments of a class, its own or of a base in the same module."""
    module, _, name = constructor.rpartition(".")
    classes = _classes(module)
    bases = [ast.unparse(base) for base in classes[name].bases]
    owners = [classes[owner] for owner in (name, *bases) if owner in classes]
    parts = [part for owner in owners for part in owner.body]
    attributes = {
        ast.unparse(part.target): ast.unparse(part.annotation)
        for part in parts
        if isinstance(part, ast.AnnAssign)
    }
    for make in parts:
        if isinstance(make, ast.FunctionDef) and make.name == "__init__":
            told = _descriptions(ast.get_docstring(make) or "")
            given = make.args.args[1:]
            required = [None] * (len(given) - len(make.args.defaults))
            defaults = [*required, *make.args.defaults, *make.args.kw_defaults]
            given += make.args.kwonlyargs
            for argument, default in zip(given, defaults, strict=True):
                known = attributes.get(argument.arg, "")
                yield _Argument(
                    argument.arg, known, default, told.get(argument.arg, "")
                )
            return


@functools.cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """The classes of a module."""
    path = _PACKAGE.joinpath(*module.split(".")).with_suffix(".py")
    parts = ast.parse(path.read_text(encoding="utf-8")).body
    return {part.name: part for part in parts if isinstance(part, ast.ClassDef)}


def _descriptions(docstring: str) -> dict[str, str]:
    """Argument -> its first sentence, in the words that follow "give"."""
    section = docstring.partition("Args:\n")[2].partition("\n\n")[0]
    told: dict[str, str] = {}
    for name, text in re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", section, re.M):
        sentence = re.split(r"\.(?=\s|$)", " ".join(text.split()))[0]
        told[name] = sentence[:1].lower() + sentence[1:]
    return told
