"""Tags: values whose Numba type says everything."""

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
    """A hashable description that compiled code is specialised on.

    Its `repr` and the stamp of the package's sources make up the name of its Numba type, and so the
    key of the disk cache: an edited source, another number of lanes or another tableau can never
    find each other's machine code. (Module globals, by contrast, are not in Numba's key.)
    """


class TagType(types.Type):
    """The type of a tag: a name, which is all of it that goes to the disk.

    A tag may hold functions of the user's, whose modules no other process need have.
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
    """Modules of the classes that a tag is made of, and those of its `modules`."""
    if isinstance(described, tuple):
        for member in described:
            yield from _modules(member)
    elif is_dataclass(described):
        yield type(described).__module__
        yield from getattr(described, "modules", ())
        for field in fields(described):
            if field.compare:
                yield from _modules(getattr(described, field.name))


_tags: dict[str, Tag] = {}  # of this process, by their types' names


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
