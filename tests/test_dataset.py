"""Result folders: what a run touches, what it refuses, and what damage of any kind comes to."""

from __future__ import annotations

import errno
import itertools
import json
import os
import pickle
import random
import shutil
import subprocess
import sys
from pathlib import Path

import filelock
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cases import long_but
from command import invoke
from studies import TEXT, hashes, study

import lierb
from lierb.errors import ArgumentError, StudyError, StudyFileError, StudyWarning
from lierb.studies.dataset import Dataset
from lierb.studies.storage import results as results_module
from lierb.studies.storage.files import parquet_files
from lierb.studies.storage.manifest import sealed
from lierb.studies.storage.parts import Parts
from lierb.studies.storage.store import Store
from lierb.support.files import folder_of, write_whole

SMALL = {"sample": {"n": 20}, "integrate": {"cspace": ["SE3"], "dt": [1e-3], "save_every": 10}}
PARTS = 3  # of SMALL
FIRST = "summary/part-00-0000000000.parquet"


def small(**changes):
    return study(**{name: SMALL.get(name, {}) | changes.get(name, {}) for name in SMALL | changes})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The small study run without a break."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    lierb.run(small(), folder)
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    """A copy of its folder."""
    return Path(shutil.copytree(whole, tmp_path / "copy"))


def refused(*arguments, **options):
    """Output of a command that ends with one sentence."""
    done = invoke(*arguments, **options)
    assert done.exit_code == 1, done.output
    assert isinstance(done.exception, SystemExit)
    assert done.stderr.count("Error: ") == 1
    return done.stderr


def table_of(rows=3):
    return pa.table({"trajectory": np.arange(rows)})


def begun(folder, text="", parts=2):
    """A folder of two parts that are not integrated, the second one missing."""
    given, dataset = small(), Store(folder)
    with dataset.locked():
        dataset.begin(given, text, parts)
        for name in itertools.islice((part.name for part in Parts(given)), parts - 1):
            files = parquet_files(name, {"summary": table_of(), "history": table_of(9)}, "snappy")
            dataset.enter(name, dataset.store(files))
    return dataset


def rewrite(folder, edit):
    """Edit a manifest, and seal it again."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    edit(manifest)
    path.write_bytes(sealed(manifest))


def test_a_table_that_the_study_lacks_is_not_called_unfinished(tmp_path):
    begun(tmp_path)
    for name in ("events", "energy"):
        with pytest.raises(ArgumentError, match=f"name='{name}'; expected .* of a problem with ev"):
            Dataset(tmp_path).table(name)
    with pytest.raises(StudyError, match="has no finished part with history"):
        begun(tmp_path / "new", parts=1).table("history")


# ---- other people's files ----------------------------------------------------------------------

OURS = [
    ".manifest.json.0123abcd.unfinished", ".study.toml.0123abcd.unfinished",
    f"summary/.{Path(FIRST).name}.0123abcd.unfinished",
    "history/.part-00-0000000008.parquet.ffffffff.unfinished",
]  # fmt: skip
THEIRS = [
    "chapter.unfinished", "thesis/chapter.unfinished", ".notes.txt.0123abcd.unfinished",
    "manifest.json.unfinished", "summary/notes.unfinished", "summary/.part-x.parquet.unfinished",
    f".{Path(FIRST).name}.0123abcd.unfinished", *(f"sub/{name}" for name in OURS),
]  # fmt: skip


def test_a_run_deletes_what_runs_have_left_and_nothing_else(tmp_path):
    for name in (*OURS, *THEIRS):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    folder = tmp_path / "summary" / ".part-00-0000000016.parquet.0123abcd.unfinished"
    (folder / "inner").mkdir(parents=True)
    lierb.run(small(), tmp_path)
    assert [name for name in OURS if (tmp_path / name).exists()] == []
    assert {name: (tmp_path / name).read_text() for name in THEIRS} == {n: n for n in THEIRS}
    assert (folder / "inner").is_dir()


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_links_of_unfinished_names_are_not_followed(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    for name in OURS[2:]:
        (elsewhere / name).parent.mkdir(parents=True)
        (elsewhere / name).write_text("under way")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "history").symlink_to(elsewhere / "history")
    (folder / "summary").mkdir()
    (folder / OURS[2]).symlink_to(elsewhere / OURS[2])
    Store(folder).drop_unfinished()
    assert all((elsewhere / name).exists() for name in OURS[2:])


def test_a_study_of_the_users_is_not_written_over(tmp_path):
    """`lierb run study.toml --out .`: it is the folder's study as well, if nothing is changed."""
    file = tmp_path / "study.toml"
    file.write_text(f"# mine\n{TEXT}")
    error = refused("run", file, "--n", 4, "--out", tmp_path)
    assert "study.toml says another study than" in error
    assert file.read_text() == f"# mine\n{TEXT}"
    assert not (tmp_path / "manifest.json").exists()
    assert invoke("run", file, "--out", tmp_path).exit_code == 0
    assert file.read_text() == f"# mine\n{TEXT}"


# ---- what may be in a folder -------------------------------------------------------------------


def left_by_a_kill(folder, given, *, entered):
    """Folder after a kill between a part's renames and the manifest: one part is not entered."""
    lierb.run(given, folder)

    def forget(manifest):
        names = list(manifest["parts"])
        for name in names[entered:]:
            del manifest["parts"][name]
            if name != names[entered]:
                for table in ("summary", "history"):
                    (folder / table / f"part-{name}.parquet").unlink()

    rewrite(folder, forget)


@pytest.mark.parametrize("entered", [0, 1])
def test_parts_that_a_kill_left_are_done_again(entered, whole, tmp_path):
    left_by_a_kill(tmp_path, small(), entered=entered)
    changed = sorted((tmp_path / "summary").glob("*.parquet"))[entered]
    changed.write_bytes(b"not what was entered")
    lierb.run(small(), tmp_path, resume=bool(entered))
    assert hashes(tmp_path) == hashes(whole)


@pytest.mark.parametrize("manifest", ["of another study", "deleted"])
def test_parts_of_another_study_are_refused(manifest, tmp_path):
    """Whoever reads the folder would have read rows of two studies."""
    left_by_a_kill(tmp_path, small(sample={"n": 50, "seed": 9}), entered=0)
    if manifest == "deleted":
        (tmp_path / "manifest.json").unlink()
        (tmp_path / "study.toml").unlink()
    before = hashes(tmp_path)
    for resume in (False, True):
        with pytest.raises(StudyError, match=r"00-0000000000\.parquet would be read.*move it"):
            lierb.run(small(), tmp_path, resume=resume)
    assert hashes(tmp_path) == before


@pytest.mark.parametrize(
    "name",
    ["part-00-0000000000 (copy).parquet", "part-07-0000000000.parquet", "sub/mine.parquet",
     "part-00-0000000003.parquet", "old.parquet.bak"],
)  # fmt: skip
def test_other_parquet_in_a_folder_is_refused(name, copy):
    mine = copy / "summary" / name
    mine.parent.mkdir(exist_ok=True)
    pq.write_table(table_of(), mine)
    before = hashes(copy)
    with pytest.raises(StudyError, match="would be read with this study's parts, but no"):
        lierb.run(small(), copy, resume=True)
    assert hashes(copy) == before


def test_parquet_that_comes_meanwhile_is_told(tmp_path):
    def put(done, total):
        if done == total:
            pq.write_table(table_of(), tmp_path / "summary" / "mine.parquet")

    with pytest.raises(StudyError, match=r"mine\.parquet would be read with"):
        lierb.run(small(), tmp_path, progress=put)
    (tmp_path / "summary" / "mine.parquet").unlink()
    lierb.run(small(), tmp_path, resume=True)


@pytest.mark.parametrize("reason", ["threads", "stray", "study", "code"])
def test_what_refuses_a_run_does_so_before_its_folder_is_overwritten(reason, copy, tmp_path):
    given, options = small(sample={"seed": 7}), {}
    if reason == "threads":
        options["threads"] = 1000
    elif reason == "stray":
        pq.write_table(table_of(), copy / "summary" / "mine.parquet")
    elif reason == "study":
        (copy / "study.toml").write_text(study(sample={"n": 3}).to_toml())
    else:
        (tmp_path / "own.py").write_text(
            "import lierb\n\n\n@lierb.observable\ndef height(r):\n    return r[2]\n"
        )
        (tmp_path / "s.toml").write_text(
            given.to_toml() + '\n[[problem.observables]]\ntype = "python:own.py:height"\n'
        )
        (copy / "own.py").write_text("mine")
        given = tmp_path / "s.toml"
    before = hashes(copy)
    with pytest.raises((ArgumentError, StudyError)):
        lierb.run(given, copy, overwrite=True, **options)
    assert hashes(copy) == before


def test_errors_about_files_reach_the_process_that_waits_for_a_worker():
    """`distributed` unpickles exceptions by the __new__ of their class."""
    made = StudyFileError.__new__(StudyFileError, "no room")
    assert isinstance(made, OSError)
    assert str(pickle.loads(pickle.dumps(StudyFileError("no room")))) == "no room"


def test_files_that_readers_skip_are_no_concern(copy, whole):
    for name in ("notes.txt", ".hidden.parquet", "_metadata"):
        (copy / "summary" / name).write_bytes(b"")
    lierb.run(small(), copy, resume=True)
    assert (copy / "summary" / "notes.txt").exists()


def test_a_begun_folder_without_parts_takes_another_study(whole, tmp_path):
    begun(tmp_path, text="# begun", parts=1)
    lierb.run(small(), tmp_path)
    assert hashes(tmp_path) == hashes(whole)


@pytest.mark.parametrize("text", ["", TEXT.replace("seed = 3", "seed = 4"), "[body"])
def test_an_edited_study_is_noticed(text, copy):
    (copy / "study.toml").write_text(text)
    for run in (lambda: lierb.run(small(), copy, resume=True), lambda: report_of(copy)):
        with pytest.raises(StudyError, match=r"study\.toml says another study than .*move it"):
            run()
    assert (copy / "study.toml").read_text() == text


def report_of(folder):
    pytest.importorskip("plotly")
    from lierb.studies.pages.report import write_report

    dataset = Dataset(folder)
    dataset.read()
    write_report(dataset, folder / "report.html")


def test_a_study_in_other_words_is_kept(copy):
    text = f"# a note\n{(copy / 'study.toml').read_text()}"
    (copy / "study.toml").write_text(text)
    lierb.run(small(), copy, resume=True)
    assert (copy / "study.toml").read_text() == text


def test_a_study_that_is_gone_is_written_again(copy, whole):
    (copy / "study.toml").unlink()
    with pytest.warns(StudyWarning, match=r"study\.toml was missing; it is written again") as told:
        lierb.run(small(), copy, resume=True)
    assert told[0].filename == __file__
    assert hashes(copy) == hashes(whole)


# ---- damage ------------------------------------------------------------------------------------

EDITS = {
    "parts": lambda m: m.update(parts={}),
    "rows": lambda m: m["parts"]["00-0000000000"][FIRST].update(rows=99),
    "checksum": lambda m: m.update(checksum="0" * 64),
    "more": lambda m: m.update(more=1),
}


@pytest.mark.parametrize("name", EDITS)
def test_an_edited_manifest_is_refused(name, copy):
    """By who reads it and who resumes; the parts stay as they are."""
    path = copy / "manifest.json"
    manifest = json.loads(path.read_text())
    EDITS[name](manifest)
    path.write_text(json.dumps(manifest))
    before = hashes(copy)
    with pytest.raises(StudyError, match="edited or damaged: its checksum is wrong; restore it"):
        Dataset(copy).read()
    with pytest.raises(StudyError, match="edited or damaged"):
        lierb.run(small(), copy, resume=True)
    assert hashes(copy) == before


@pytest.mark.parametrize("file", ["../x.parquet", "summary/../x.parquet", "summary/part-x.parquet"])
def test_a_manifest_names_no_part_outside_its_folder(file, tmp_path):
    """Even one that has been sealed again."""
    begun(tmp_path)
    part = {file: {"rows": 3, "sha256": "0" * 64}}
    rewrite(tmp_path, lambda manifest: manifest["parts"].update({"00-0000000000": part}))
    with pytest.raises(StudyError, match=r"manifest\.json is damaged \(parts.*restore it"):
        Dataset(tmp_path).read()


def test_a_manifest_of_another_format_is_named(tmp_path):
    (tmp_path / "manifest.json").write_text('{"format": 2, "parts": {}}')
    with pytest.raises(StudyError, match=r"of this version .* its format is 2, expected 3"):
        Dataset(tmp_path).read()


def test_any_damage_of_a_manifest_is_told(tmp_path, damages):
    begun(tmp_path)
    path = tmp_path / "manifest.json"
    content = path.read_bytes()
    said = json.loads(content)
    rng = random.Random(4)
    told = 0
    for _ in range(damages * 10):
        path.write_bytes(damaged(content, rng) if rng.random() < 0.5 else edited(content, rng))
        try:
            dataset = Dataset(tmp_path)
        except StudyError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert "manifest" in str(error)  # noqa: PT017
            told += 1
        else:
            assert sealed(dataset.manifest) == sealed(said)  # but for spaces
    assert told > damages * 9


@pytest.fixture(params=[30, pytest.param(500, marks=pytest.mark.slow)])
def damages(request):
    """Number of them to try."""
    return request.param


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Cut off, flipped, mixed up, or filled with zeros, as file systems do after a power cut."""
    changed = bytearray(content)
    at = rng.randrange(len(content))
    how = rng.choice(["cut", "flip", "mix", "zeros", "nothing"])
    if how == "cut":
        del changed[at:]
    elif how == "flip":
        changed[at] ^= 1 << rng.randrange(8)
    elif how == "mix":
        changed[at : at + 8] = rng.randbytes(8)
    elif how == "zeros":
        changed[at:] = bytes(len(content) - at)
    else:
        changed.clear()
    return bytes(changed)


VALUES = [None, True, -1, 0, 2**70, 1e400, "", "../x", "\ud800", [], {}, [{}], "ok", 3]


def edited(content: bytes, rng: random.Random) -> bytes:
    """JSON in which a value is changed, deleted or added."""
    whole = place = json.loads(content)
    while True:
        key = rng.choice(list(place))
        inner = place[key]
        if not (isinstance(inner, dict) and inner) or rng.random() < 0.2:
            break
        place = inner
    how = rng.choice(["set", "delete", "add"])
    if how == "set":
        old = place[key]
        place[key] = rng.choice([value for value in VALUES if value != old])
    elif how == "delete":
        del place[key]
    else:
        place[rng.choice(["x", "../x", ""])] = inner
    return json.dumps(whole).encode()


def test_any_damage_of_a_part_is_told_and_done_again(copy, damages):
    """Read the results in every way; none shows a wrong number."""
    rng = random.Random(6)
    files = sorted(copy.rglob("*.parquet"))
    contents = {file: file.read_bytes() for file in files}
    for _ in range(damages):
        file = rng.choice(files)
        if (changed := damaged(contents[file], rng)) == contents[file]:
            continue
        file.write_bytes(changed)
        dataset = Dataset(copy)
        dataset.read()
        with pytest.raises(StudyError, match=rf"{file} is damaged or missing; --resume") as caught:
            dataset.table(file.parent.name)
        assert "\n" not in str(caught.value)
        file.write_bytes(contents[file])
    dataset.table()
    assert hashes(copy)


def test_damage_is_told_by_every_command_and_mended(copy, whole):
    pytest.importorskip("plotly")
    file = copy / FIRST
    for change in (lambda b: b[:-7], lambda b: b"PAR1" + b[8:], lambda b: b"", None):
        if change:
            file.write_bytes(change(file.read_bytes()))
        else:
            file.unlink()
        for name in ("show", "report", "plot"):
            assert f"{FIRST} is damaged or missing; --resume" in refused(name, copy)
        lierb.run(small(), copy, resume=True)
        assert {name: text for name, text in hashes(copy).items() if "part" in name} == {
            name: text for name, text in hashes(whole).items() if "part" in name
        }


def test_a_file_is_read_for_its_checksum_once(copy, monkeypatch):
    dataset = Dataset(copy)
    dataset.read()
    read = []
    digest = results_module.sha256_of
    monkeypatch.setattr(
        results_module, "sha256_of", lambda path: (read.append(path), digest(path))[1]
    )
    for _ in range(2):
        assert dataset.table().count_rows() == 20
    assert len(read) == PARTS
    os.utime(copy / FIRST, ns=(0, 0))
    dataset.table()
    assert len(read) == PARTS + 1
    os.truncate(copy / FIRST, 9)
    with pytest.raises(StudyError, match="damaged"):
        dataset.table()
    unchecked = dataset.table("history", check=False)
    assert unchecked.count_rows() == 20 * 6


# ---- what the system refuses -------------------------------------------------------------------


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES])
@pytest.mark.parametrize("call", ["fsync", "open", "replace"])
def test_what_cannot_be_written_is_named(code, call, tmp_path, monkeypatch):
    """Wherever it happens, and the folder is as it was before."""
    dataset = begun(tmp_path)
    before = hashes(tmp_path)

    def fails(*_args, **_options):
        raise OSError(code, os.strerror(code))

    place = {"fsync": os, "open": Path, "replace": Path}[call]
    for name in (FIRST, "manifest.json", "study.toml", "report.html"):
        with monkeypatch.context() as patched:
            patched.setattr(place, call, fails)
            with pytest.raises(StudyFileError) as caught:
                dataset.write(name, b"x")
        said = f"{tmp_path / name} cannot be written: {os.strerror(code)}; finished parts are kept"
        assert str(caught.value).startswith(said)
        assert "--resume" in str(caught.value)
        assert caught.value.__cause__.errno == code
        assert hashes(tmp_path) == before


@pytest.mark.parametrize("name", ["report", "plot"])
def test_a_full_disk_ends_a_command_in_a_sentence(name, copy, monkeypatch):
    pytest.importorskip("plotly")

    def full(*_args, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("lierb.studies.pages.figures.figures", lambda _: iter([("time", None)]))
    monkeypatch.setattr("lierb.studies.pages.figures.picture", lambda *_: b"drawn")
    monkeypatch.setattr("lierb.studies.pages.report.sheets", lambda *_: iter(()))
    monkeypatch.setattr(os, "fsync", full)
    file = {"report": "report.html", "plot": "figures/time.png"}[name]
    said = refused(name, copy)
    assert f"{copy / file} cannot be written: No space left on device; make room there" in said
    assert "--resume" not in said  # which neither of them has
    assert not list(copy.rglob("*.unfinished"))


@pytest.mark.skipif(os.name == "nt", reason="no such files there")
def test_what_is_no_plain_file_is_written_to(tmp_path):
    """`lierb report DIR --out /dev/stdout` puts no file in the device's stead."""
    (tmp_path / "link").symlink_to(tmp_path / "page.html")
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDWR)
    for name in ("page.html", "link", "pipe"):
        write_whole(tmp_path / name, f"for {name}".encode())
    assert (tmp_path / "page.html").read_text() == "for link"
    assert (tmp_path / "link").is_symlink()
    assert os.read(reader, 99) == b"for pipe"
    os.close(reader)


def test_a_folder_is_opened_by_its_name(whole, tmp_path):
    """The message does not mention reading."""
    assert Dataset(whole).table().count_rows() == Dataset(whole).table(check=False).count_rows() > 0
    assert Dataset(whole).plot().axes
    with pytest.raises(StudyError, match="holds no results of a study"):
        Dataset(tmp_path).table()


def test_a_folder_that_is_none_is_named(tmp_path):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        with pytest.raises(StudyFileError, match=rf"{out} is no folder; choose another"):
            lierb.run(small(), out)
    (tmp_path / "summary").write_text("mine")
    with pytest.raises(StudyFileError, match=r"summary is no folder; .*--resume"):
        lierb.run(small(), tmp_path)
    assert (tmp_path / "summary").read_text() == "mine"


@pytest.mark.parametrize("name", ["manifest.json", "study.toml", FIRST])
@pytest.mark.parametrize("kind", ["folder", "pipe"])
def test_a_file_that_is_none_ends_in_a_sentence(name, kind, copy):
    (copy / name).unlink()
    if kind == "folder":
        (copy / name / "inner").mkdir(parents=True)
    elif hasattr(os, "mkfifo"):
        os.mkfifo(copy / name)
    if name == FIRST and kind == "pipe":
        lierb.run(small(), copy, resume=True)  # in its stead
    else:
        with pytest.raises(StudyError):
            lierb.run(small(), copy, resume=True)


@pytest.mark.slow
@pytest.mark.skipif(
    os.name == "nt" or os.geteuid() != 0, reason="only root can become another user"
)
def test_permissions_are_told(copy):
    code = (
        "import os, sys\n"
        "from lierb.studies.storage.store import Store\n"
        "os.setuid(65534)\n"
        "with Store(sys.argv[1]).locked(): pass"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, copy], capture_output=True, text=True, timeout=120, check=False
    )
    assert f"StudyFileError: {copy} cannot be made: Permission denied; choose an" in done.stderr


@pytest.mark.parametrize(
    "error",
    [PermissionError(errno.EACCES, "Permission denied"), OSError(errno.ENOLCK, "No locks"),
     OSError(errno.EOPNOTSUPP, "Operation not supported"), NotImplementedError("no flock here")],
)  # fmt: skip
def test_a_lock_that_cannot_be_had_is_told(error, tmp_path, monkeypatch):
    def refuse(*_args, **_options):
        raise error

    monkeypatch.setattr(filelock.FileLock, "_acquire", refuse)
    with pytest.raises(StudyFileError, match=r"\.lock cannot be locked: .*or choose a folder"):
        lierb.run(small(), tmp_path)
    assert not (tmp_path / "manifest.json").exists()


# ---- names of folders and files ----------------------------------------------------------------


@pytest.mark.parametrize(
    "out", ["s3://bucket/top", "gs://bucket/top", "http://host/top", "file:///tmp/top", "s3:/b/top"]
)
def test_a_url_is_no_folder(out, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "top.toml").write_text(TEXT)
    assert f"{out} is no folder of this machine" in refused("run", "top.toml", "--out", out)
    for given in (out, Path(out)):
        with pytest.raises(StudyError, match="local one, which can be copied there"):
            lierb.run(small(), given)
    assert [path.name for path in tmp_path.iterdir()] == ["top.toml"]


@pytest.mark.parametrize("out", ["", "a\0b", "~nobody-of-that-name/out"])
def test_a_name_of_no_folder_is_told(out, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(StudyError):
        lierb.run(small(), out)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", [None, 5, ["out"]])
def test_what_names_nothing_is_told(out):
    with pytest.raises(ArgumentError, match="expected the path of a folder"):
        lierb.run(small(), out)


def test_home_is_meant(tmp_path, monkeypatch, whole):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert folder_of("~/out") == folder_of(Path("~/out")) == tmp_path / "out"
    (tmp_path / "top.toml").write_text(small().to_toml())
    done = invoke("run", "~/top.toml", "--out=~/out")
    assert done.exit_code == 0, done.output
    lierb.run("~/top.toml", "~/python")
    assert hashes(tmp_path / "out") == hashes(tmp_path / "python")
    assert invoke("show", "~/out").exit_code == 0


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes there")
def test_names_that_are_no_text(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file, out = (os.fsdecode(name) for name in (b"\xff.toml", b"out\xff"))
    Path(file).write_text(small().to_toml())
    for study_file in (file, Path(file)):
        with pytest.raises(StudyError, match=r"b'out\\xff' is not UTF-8"):
            lierb.run(study_file, out)
    done = invoke("run", file, "--out", "out")
    assert done.exit_code == 0, done.output
    assert json.loads(Path("out/manifest.json").read_text())["study"]["name"] == "study"
    assert "is not UTF-8" in refused("run", file, "--out", out)
    Path(out).mkdir()
    assert "is not UTF-8" in refused("show", out)


@pytest.mark.slow
@pytest.mark.parametrize("way", long_but(["-", "/dev/stdin", "pipe"], "-"))
@pytest.mark.skipif(os.name == "nt", reason="no such names there")
def test_a_study_from_a_pipe(way, whole, tmp_path):
    """`lierb run -`, `lierb run <(lierb example heavy_top)`: there is one chance to read it."""
    read, write = os.pipe()
    os.write(write, small().to_toml().encode())
    os.close(write)
    name = f"/dev/fd/{read}" if way == "pipe" else way
    done = subprocess.run(
        [sys.executable, "-m", "lierb", "run", name], cwd=tmp_path, stdin=read, pass_fds=(read,),
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    os.close(read)
    assert done.returncode == 0, done.stderr
    assert hashes(tmp_path / "results" / "study") == hashes(whole)


def test_a_study_from_standard_input(whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke("run", "-", input=small().to_toml())
    assert done.exit_code == 0, done.output
    assert hashes(tmp_path / "results" / "study") == hashes(whole)


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="nothing without an end")  # noqa: PTH110
def test_a_study_without_an_end_is_refused(tmp_path):
    assert "larger than 4 MiB" in refused("run", "/dev/zero", "--out", tmp_path / "out")


@pytest.mark.skipif(os.name == "nt", reason="no such pipes there")
def test_a_study_from_a_pipe_is_read_once_from_python(whole, tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    writer = subprocess.Popen(["sh", "-c", f"cat > {tmp_path}/pipe.toml"], stdin=subprocess.PIPE)
    writer.stdin.write(small().to_toml().encode())
    writer.stdin.close()
    lierb.run(tmp_path / "pipe.toml", tmp_path / "out")
    writer.wait(10)
    assert hashes(tmp_path / "out") == hashes(whole)


def test_a_run_from_a_pipe_goes_on_with_the_folders_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def stopped(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("lierb.studies.execution.running.run", stopped)
    done = invoke("run", "-", "--n", 10, input=TEXT)
    assert done.exit_code == 130
    line = "go on with:  lierb run results/study/study.toml --out results/study --resume\n"
    assert done.stderr.endswith(line)


# ---- interrupts --------------------------------------------------------------------------------


@pytest.mark.parametrize("stride", [29, pytest.param(1, marks=pytest.mark.slow)])
def test_an_interrupt_at_any_call_leaves_a_folder_that_goes_on(
    stride, whole, tmp_path, monkeypatch
):
    """Interrupt before the first part, between parts, and during writes, renames and reads."""
    calls = {
        os: ["fsync", "scandir"], Path: ["replace", "mkdir", "open", "unlink", "stat"],
    }  # fmt: skip
    left = [0]

    def interrupting(call):
        def called(*args, **options):
            left[0] -= 1
            if left[0] == 0:
                raise KeyboardInterrupt
            return call(*args, **options)

        return called

    made = {part.name: part.tables(small(), small().design, 1) for part in Parts(small())}
    monkeypatch.setattr("lierb.studies.storage.parts.Part.tables", lambda part, *_: made[part.name])
    wanted = hashes(whole)
    for n in itertools.count(1, stride):
        out, left[0] = tmp_path / str(n), n
        with monkeypatch.context() as patched:
            for place, names in calls.items():
                for name in names:
                    patched.setattr(place, name, interrupting(getattr(place, name)))
            try:
                lierb.run(small(), out)
            except KeyboardInterrupt:
                pass
            else:
                break
        lierb.run(small(), out, resume=True)
        assert hashes(out) == wanted, n
        shutil.rmtree(out)
    assert n > 60


# ---- very many parts ---------------------------------------------------------------------------


@pytest.mark.slow
def test_parts_of_very_many_bodies_are_made_one_by_one(tmp_path):
    huge = small(sample={"n": 10**12})
    parts = Parts(huge)
    assert parts.total == 10**12 // 8
    assert parts.trajectories == 10**12
    assert parts.work() == 10**12 * 50
    seen = []

    def stop(done, total):
        seen.append((done, total))
        if done >= 8 * 50 * 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lierb.run(huge, tmp_path, progress=stop)
    assert seen[-1] == (8 * 50 * 2, 10**12 * 50)
    with pytest.raises(KeyboardInterrupt):
        lierb.run(huge, tmp_path, resume=True, progress=stop)
    reader = lierb.integrate_batches(huge)
    assert reader.read_next_batch().num_rows == 8


@pytest.mark.parametrize("n", [1, 8, 9, 10**10, 10**10 + 1, 10**12, 2**62])
def test_names_of_parts_sort_as_parts_do(n):
    given = small(sample={"n": n}, integrate={"cspace": ["SE3", "SO3xR3"], "dt": [1e-3, 1e-2]})
    parts = Parts(given)
    some = [0, 1, parts.total // 4 - 1, parts.total // 4, parts.total // 2 + 1, parts.total - 1]
    wanted = [
        divmod(k, parts.total // 4) for k in sorted({k for k in some if 0 <= k < parts.total})
    ]
    chosen = [parts._part(setting, 8 * number) for setting, number in wanted]
    names = [part.name for part in chosen]
    assert names == sorted(names)
    assert [parts.named(name) for name in names] == chosen
    assert sum(part.count for part in parts) == 4 * n if n < 10 else chosen[-1].first < n
    assert chosen[0].name == f"00-{0:0{10 if n <= 10**10 else len(str(n - 1))}d}"
    for name in ("00-0000000003", "99-0000000000", "00-0", "x", "0٣-0000000000", f"00-{10**20}"):
        assert parts.named(name) is None


def test_names_of_very_many_settings_sort_as_they_do():
    dts = [0.05 / k for k in range(1, 121)]
    names = [part.name for part in Parts(small(integrate={"dt": dts, "save_every": None}))]
    assert names == sorted(names)
    assert names[-1].startswith("119-")


def test_studies_of_results_are_named_by_their_folders(tmp_path, monkeypatch):
    """Two studies of the same file name do not meet in one folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "top.toml").write_text(small().to_toml())
    assert invoke("run", "top.toml", "--out", "elsewhere/spun").exit_code == 0
    again = invoke("run", "elsewhere/spun/study.toml")
    assert again.exit_code == 0, again.output
    assert Dataset("results/spun").study.name == "top"
    assert not (tmp_path / "results" / "study").exists()
    # In place it is refused, with what to do.
    refused = invoke("run", "results/spun/study.toml")
    assert "has results of this study already" in " ".join(refused.stderr.split())


def test_a_folder_without_results_is_refused_at_once(tmp_path):
    with pytest.raises(StudyError, match="holds no results"):
        Dataset(tmp_path / "none")
