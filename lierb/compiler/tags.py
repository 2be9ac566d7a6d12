"""Tags are arguments that are compile-time constants, each with a Numba type of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from numba import types
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

from lierb.compiler.stamp import source_stamp


class Tag:
    """A tag is a hashable description for which code is specialised.

    The name of a tag's Numba type contains digests of its `repr` and of the package's sources, and
    is part of the key of the disk cache. Hence an edited source, another number of lanes or another
    tableau has another key. (Numba's own key does not cover globals of modules.)
    """


class TagType(types.Type):
    """The Numba type of a tag is stored on the disk by its name alone.

    A tag may contain a user's functions, whose modules another process may lack.
    """

    def __init__(self, tag: Tag) -> None:
        digest = hashlib.sha256(repr(tag).encode()).hexdigest()[:16]
        stamp = source_stamp(*sorted(set(_modules(tag))))
        super().__init__(name=f"{type(tag).__name__}<{stamp},{digest}>")
        _tags.setdefault(self.name, tag)

    @property
    def tag(self) -> Tag:
        return _tags[self.name]


def _modules(described: Any) -> Iterator[str]:
    """Yield the modules of the classes in a tag, and those that its `modules` list."""
    if isinstance(described, tuple):
        for member in described:
            yield from _modules(member)
    elif is_dataclass(described):
        yield type(described).__module__
        yield from getattr(described, "modules", ())
        for field in fields(described):
            if field.compare:
                yield from _modules(getattr(described, field.name))


_tags: dict[str, Tag] = {}  # tags of this process, by the names of their types


register_model(TagType)(models.OpaqueModel)


@cache
def _tag_type(tag: Tag) -> TagType:
    return TagType(tag)


@typeof_impl.register(Tag)
def _typeof_tag(tag: Tag, context: Any) -> TagType:
    return _tag_type(tag)


@unbox(TagType)
def _unbox_tag(ty: TagType, obj: Any, context: Any) -> NativeValue:
    return NativeValue(context.context.get_dummy_value())
