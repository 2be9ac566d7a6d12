"""Opening a study and its folder, begun or not, for a run."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lierb.errors import StudyError, StudyWarning
from lierb.runs.provenance import machine
from lierb.studies.description.batches import check_draws
from lierb.studies.description.changes import written
from lierb.studies.description.messages import Given, at_lines
from lierb.studies.description.sources import STUDY, as_file, path_given
from lierb.studies.description.study import Study
from lierb.studies.storage.files import part_named
from lierb.studies.storage.manifest import file_of
from lierb.studies.storage.parts import Parts
from lierb.studies.storage.store import Store

MOST_DIFFERENCES = 5  # most differences between two studies that are listed


def loaded(
    study: Study | str | Path, changes: Mapping[str, Any] | None = None
) -> tuple[Study, str]:
    """Load and change a study; return it with the text of its file.

    Without changes this is the file's own text, comments included. Raises StudyError for draws
    that make no body.
    """
    if isinstance(study, Study):
        given = study.changed(changes or {})
        with at_lines(Given("study", "", changes or {})):
            check_draws(given)
        return given, given.to_toml()
    with as_file(path_given(study)) as path:
        given, text = Study.load(path, changes), path.read_text(encoding="utf-8")
    with at_lines(Given(path.name, text, changes or {})):
        check_draws(given)
    if not changes:
        return given, text
    return given, f"# {path.name} with {', '.join(written(changes))}\n{given.to_toml()}"


def opened(
    store: Store, study: Study, text: str, changes: Mapping[str, Any], resume: bool,
    overwrite: bool,
) -> Parts:  # fmt: skip
    """Begin or resume a study in its folder, and check the finished parts; return all parts.

    Raises StudyError for a folder that is not the study's; see `lierb.studies.dataset`.
    """
    parts = Parts(study)
    if store.exists():
        store.read()
    if overwrite:  # what would refuse the run afterwards does so before anything is deleted
        unentered(store, parts if store.manifest.get("digest") == study.digest() else None)
        store.require_place(study)
        store.clear()
    adds_bodies = _adds_bodies(store, study, parts)
    if resume and adds_bodies:
        store.begin(study, text, parts.total, changes, _whole_parts(store, parts))
    is_same = store.manifest.get("digest") == study.digest()
    if store.parts and not is_same:
        begun = ", ".join(written(store.changes))
        raise StudyError(
            f"{store.folder} has the results of another study: {_differences(store, study)}"
            + (f"; it was run with {begun}" if begun else "")
            + ("; --resume (resume=True) adds bodies to them" if adds_bodies else "")
            + "; --overwrite (overwrite=True) deletes them"
        )
    if store.parts and not resume:
        raise StudyError(
            f"{store.folder} has results of this study already; --resume (resume=True) computes "
            "missing parts, --overwrite (overwrite=True) deletes them, or choose another folder"
        )
    unentered(store, parts if is_same else None)
    if not store.parts:
        store.begin(study, text, parts.total, changes)
        store.drop_unfinished()
    else:
        _resume(store, study, text)
    store.drop(unentered(store, parts))
    return parts


def _adds_bodies(store: Store, study: Study, parts: Parts) -> bool:
    """Return True if a study differs from the folder's by a larger number of bodies alone."""
    before = store.manifest["study"]["sample"]["n"] if store.parts else None
    if before is None or before >= len(study.design):
        return False
    sample = study.sample.model_copy(update={"n": before})
    is_same = study.model_copy(update={"sample": sample}).digest() == store.manifest["digest"]
    return is_same and None not in map(parts.named, store.parts)


def _whole_parts(store: Store, parts: Parts) -> dict[str, Any]:
    """Return the parts of a folder that get no further bodies."""
    return {
        name: files
        for name, files in store.parts.items()
        if (part := parts.named(name)) and files[file_of("summary", name)]["rows"] == part.count
    }


def _resume(store: Store, study: Study, text: str) -> None:
    """Drop damaged parts, and write what is missing of the study's text and code."""
    if store.manifest["machine"] != machine():
        _warn(
            f"{store.folder} was begun with other versions or on another machine; new parts "
            "may differ from the others in the last bits"
        )
    if store.study_text() is None:
        _warn(f"{store.folder / STUDY} was missing; it is written again")
        store.write(STUDY, text.encode())
    for file in store.restore_code(study.code):
        _warn(f"{store.folder / file} was missing; it is written again")
    store.drop_damaged()


def _warn(message: str) -> None:
    warnings.warn(message, StudyWarning, stacklevel=5)  # in the caller of `run`


def unentered(store: Store, own: Parts | None = None) -> list[str]:
    """Parquet files of parts that a killed run has stored and not entered.

    own : parts of the study that was run there; None if it was another study.
    Raises StudyError for any other Parquet file that a reader of the folder would open.
    """
    files = store.strays()
    for file in files:
        name = part_named(file)
        if own is None or name is None or own.named(name) is None:
            raise StudyError(
                f"{store.folder / file} would be read with this study's parts, but no manifest "
                "lists it; move it elsewhere, or choose another folder"
            )
    return files


def _differences(store: Store, study: Study) -> str:
    """List the settings and files in which a study differs from the folder's."""
    there, here = dict(_leaves(store.manifest["study"])), dict(_leaves(study.model_dump()))
    keys = [k for k in there | here if there.get(k) != here.get(k) and k != "name"]
    lines = [f"{k} = {there.get(k)} there, {here.get(k)} here" for k in keys[:MOST_DIFFERENCES]]
    before = store.manifest.get("code", {})
    lines += [
        f"{file} was edited since, or is another file"
        for file, digest in study.code_digests.items()
        if before.get(file, digest) != digest
    ]
    return ", ".join(lines)


def _leaves(tables: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted key and value of every entry of nested tables."""
    if not isinstance(tables, dict):
        yield path, tables
        return
    for key, inner in tables.items():
        yield from _leaves(inner, f"{path}.{key}" if path else key)
