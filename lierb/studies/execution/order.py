"""Order in which the parts of a study are run and entered."""

from __future__ import annotations

from collections.abc import Iterator

from lierb.studies.description.settings import Setting
from lierb.studies.description.stopping import Bodies
from lierb.studies.description.study import Study
from lierb.studies.storage.files import Stored
from lierb.studies.storage.parts import Part, Parts
from lierb.studies.storage.store import Store


class InTurn:
    """Parts of a study that are left to run, and the order in which finished ones are entered.

    With a stopping rule (`lierb.studies.description.stopping`) parts are entered in their order, so
    that nothing is left of parts beyond the last one of a setting that workers have finished.

    pending : files of finished parts that wait for earlier ones.
    last : the last part of each setting that needs no more.
    """

    def __init__(self, study: Study, parts: Parts, store: Store) -> None:
        self.parts, self.store, self.rule = parts, store, study.stopping_rule
        self.design = study.design
        self.pending: dict[str, list[Stored]] = {}
        self.last: dict[Setting, str] = {}
        self.waiting = iter(parts)
        self.next = next(self.waiting, None)
        self.bodies = Bodies(self.rule, self.design) if self.rule else None

    @property
    def is_complete(self) -> bool:
        if self.rule is None:
            return len(self.store.parts) == self.parts.total
        return self.next is None

    def left(self) -> Iterator[Part]:
        """Parts to run, by what is known when the next one is taken."""
        for part in self.parts:
            is_there = part.name in self.store.parts or part.name in self.pending
            if not is_there and part.setting not in self.last:
                yield part

    def enter(self, finished: dict[str, list[Stored]]) -> list[str]:
        """Enter finished parts, and those that waited for them; return their names."""
        if self.rule is None:
            for name, files in finished.items():
                self.store.enter(name, files)
            return list(finished)
        self.pending |= finished
        entered = []
        while self.next is not None:
            part = self.next
            if part.name not in self.store.parts:
                if part.name not in self.pending:
                    break
                self.store.enter(part.name, self.pending.pop(part.name))
                entered.append(part.name)
            self._count(part)
        self._drop()
        return entered

    def _count(self, part: Part) -> None:
        """Apply the rule to all bodies up to a part, and advance to the next part."""
        assert self.rule is not None
        assert self.bodies is not None
        self.bodies.add(self.store.part_of("summary", part.name, self.bodies.columns))
        is_enough = self.rule.holds(self.bodies)
        self.next = next(self.waiting, None)
        while is_enough and self.next is not None and self.next.setting == part.setting:
            self.next = next(self.waiting, None)
        if self.next is None or self.next.setting != part.setting:
            self.last[part.setting] = part.name
            self.bodies = Bodies(self.rule, self.design)

    def _drop(self) -> None:
        """Delete the files of finished parts beyond the last one of their setting."""
        for name in list(self.pending):
            part = self.parts.named(name)
            if part is not None and part.setting in self.last:
                self.store.drop([file.aside for file in self.pending.pop(name)])

    def end(self) -> None:
        """Enter the last part of each setting in the manifest, where some were left out."""
        if len(self.store.parts) < self.parts.total:
            self.store.end_with(list(self.last.values()))
